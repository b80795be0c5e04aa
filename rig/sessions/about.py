"""Metadata of a recording, so that it can be understood without its session; remarks on a session.

Remarks of a person (name, note, tags, operator) do not affect measurements.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from drivers.errors import InputError
from drivers.types import Pose
from rig.sessions.codec import strict

LONGEST_NAME, LONGEST_NOTE, LONGEST_TAG, MOST_TAGS = 80, 2000, 40, 20
"""Limits of the metadata: characters of a name, a note and a tag; number of tags."""
_TAG = re.compile(r"\w[\w.+-]*")


@strict
@dataclass(frozen=True)
class Remarks:
    """Name, note, tags and operator of a session; empty if not given."""

    name: str = ""
    note: str = ""
    tags: tuple[str, ...] = ()
    operator: str = ""

    def merge(self, later: "Remarks") -> "Remarks":
        """Return these with later remarks: tags are added, other texts are replaced."""
        words = {key: getattr(later, key) or getattr(self, key) for key in ("name", "note", "operator")}
        return replace(self, **words, tags=tuple(dict.fromkeys((*self.tags, *later.tags))))

    def lines(self) -> list[str]:
        texts = {"tags": ", ".join(self.tags), "operator": self.operator, "note": self.note}
        return [f"{what}: {text}" for what, text in texts.items() if text]


NO_REMARKS = Remarks()


def remarks_of(name: str | None, note: str | None, tags: list[str] | None, operator: str | None) -> Remarks:
    """Return the remarks typed by the user. Raises `InputError` for text that does not fit on one line."""
    for what, text, longest in (
        ("name", name, LONGEST_NAME), ("note", note, LONGEST_NOTE), ("operator", operator, LONGEST_NAME)
    ):  # fmt: skip
        if text is not None and not (text.strip() and text.isprintable() and len(text) <= longest):
            raise InputError(f"--{what}: give one line of at most {longest} characters")
    kept = tuple(dict.fromkeys(tags or ()))
    for tag in kept:
        if len(tag) > LONGEST_TAG or not _TAG.fullmatch(tag):
            raise InputError(
                f"--tag {tag!r}: a tag is one word, as gel-7, of at most {LONGEST_TAG} characters"
            )
    if len(kept) > MOST_TAGS:
        raise InputError(f"--tag: {len(kept)} tags are more than {MOST_TAGS}")
    return Remarks((name or "").strip(), (note or "").strip(), kept, (operator or "").strip())


CALIBRATION_TOPIC = "/camera/calibration"
TRANSFORMS_TOPIC = "/tf"
CONTACT_PREFIX = "/contact/"
CLOCK_OFFSET = "clock_offset_ns"
"""Key in the metadata of each channel: offset added to the bench's clock, so that times are dates."""
SIMULATED_EPOCH_NS = 946_684_800_000_000_000
"""2000-01-01 UTC, the start of every simulated lift, so that equal seeds give equal bytes on one computer."""
_OUTLINE_RGBA = (0.0, 0.62, 0.45, 1.0)
"""Colour of a contact's outline: red, green, blue, opacity, 0 to 1."""


@dataclass(frozen=True, slots=True)
class RecordingAbout:
    """Metadata of a recording.

    values: by name, for people and programs, such as "object" and "seed". clock_offset_ns: from the bench's
    monotonic clock to the time of day, constant in a file. camera_serial, camera: the external camera.
    frames: poses in the base frame, by the name of the child frame.
    """

    values: Mapping[str, str] = field(default_factory=dict)
    clock_offset_ns: int = 0
    camera_serial: str = ""
    camera: CameraModel | None = None
    frames: Mapping[str, Pose] = field(default_factory=dict)

    def calibration(self, time_ns: int) -> CameraCalibration | None:
        """Return the camera in Foxglove's schema: row by row, distortion in OpenCV's order."""
        model = self.camera
        if model is None:
            return None
        width, height = model.size
        rational = np.asarray(model.distortion).size > 5
        message = CameraCalibration(
            frame_id=self.camera_serial,
            width=width,
            height=height,
            distortion_model="rational_polynomial" if rational else "plumb_bob",
            D=np.asarray(model.distortion, float).ravel().tolist(),
            K=np.asarray(model.matrix, float).ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack([model.matrix, np.zeros(3)]).ravel().tolist(),
        )
        message.timestamp.FromNanoseconds(time_ns)
        return message

    def transforms(self, time_ns: int) -> FrameTransforms:
        """Return the poses of camera and table in the arm's base frame."""
        message = FrameTransforms()
        for name, pose in self.frames.items():
            transform = message.transforms.add(parent_frame_id="base", child_frame_id=name)
            transform.timestamp.FromNanoseconds(time_ns)
            place, turn = transform.translation, transform.rotation
            place.x, place.y, place.z = pose.position_m
            turn.x, turn.y, turn.z, turn.w = pose.quaternion_xyzw
        return message


def contact_outline(outline_px: Sequence[NDArray[np.floating]], time_ns: int) -> ImageAnnotations:
    """Return closed lines over a fingertip's image. outline_px: (N, 2) each; pixel centres are integers.

    Without a line the annotation is empty, and removes the previous one.
    """
    message = ImageAnnotations()
    for line in outline_px:
        drawn = message.points.add(type=PointsAnnotation.LINE_LOOP, thickness=1.0)
        drawn.timestamp.FromNanoseconds(time_ns)
        colour = drawn.outline_color
        colour.r, colour.g, colour.b, colour.a = _OUTLINE_RGBA
        for x, y in line:
            drawn.points.add(x=float(x) + 0.5, y=float(y) + 0.5)
    return message
