"""Read a stored trial as arrays: lifts, angles, ground truth, frames, and other recorded data."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.markers.tracker import MarkerTracker
from calibration.poses import pose_matrix
from calibration.targets.aruco import Refusal
from drivers import arguments
from drivers.clock import NS_PER_S
from drivers.errors import plural, unknown_name
from drivers.realtime import compute_in_one_thread
from drivers.types import ArmState, Image
from drivers.values import short_repr
from protocols.observer import Phase
from rig.sessions import records
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import read_angles, recorded_arm_states, recorded_frames, recorded_gripper
from rig.sessions.recorder import GRIPPER_TOPIC
from rig.sessions.recording_file import recorded_messages
from rig.sessions.rows import read_usable_lifts
from rig.tactile.angles import Angles, Floats, data_frame
from rig.tactile.contact.background import mean_background

if TYPE_CHECKING:
    from pandas import DataFrame  # pyright: ignore[reportMissingImports, reportMissingModuleSource]

    from rig.frames.streaming import StreamingEstimator

CAMERA = "camera"
"""Name of the external camera, used instead of a serial."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmTrack:
    """Poses and joint angles of the arm.

    time_s: (N,) s from the start of the lift (phase B). base_T_tcp: (N, 4, 4) pose of the tool centre point
    in the arm's base frame, m. joints_rad: (N, 6).
    """

    time_s: Floats
    base_T_tcp: Floats  # noqa: N815 - frame names keep their case
    joints_rad: Floats

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False)
class WrenchTrack:
    """Force and torque at the tool centre point, in the axes of the arm's base frame.

    time_s: (N,) s from the start of the lift. force_n: (N, 3) N; torque_nm: (N, 3) N m; NaN for an arm
    without a force sensor.
    """

    time_s: Floats
    force_n: Floats
    torque_nm: Floats

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False)
class GripperTrack:
    """States of the gripper.

    time_s: (N,) s from the start of the lift. opening_m: (N,) distance between the fingertips, m; NaN in
    sessions of versions that recorded only counts. current_a: (N,) motor current, A; NaN if the gripper does
    not measure it. moving: (N,) bool.
    """

    time_s: Floats
    opening_m: Floats
    current_a: Floats
    moving: NDArray[np.bool_]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTrack:
    """The corners of the two markers in the external camera's frames, detected again.

    time_s: (N,) s from the start of the lift, of every camera frame. corners_px: (N, 2, 4, 2), by marker (in
    the order of the ids in the bench file), corner (clockwise from the marker's own top left), and x (to the
    right) and y (down). Pixel centres have integer coordinates. NaN if the marker was not found.
    """

    time_s: Floats
    corners_px: Floats

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False)
class SensorFrame:
    """A frame of a fingertip or of the camera.

    time_s: s from the start of the lift (phase B). image: (H, W, 3) uint8 RGB. mask: (H, W) uint8, 255 for
    contact, else 0; None if no masks were requested.
    """

    time_s: float
    image: Image
    mask: Image | None = None

    __repr__ = short_repr


def _stored_value(path: str, doc: str) -> Any:
    """Return a read-only property with a stored value, at a path of attributes."""
    return property(attrgetter(path), doc=doc)


class Lift:
    """One finished lift of a trial.

    Angles are in degrees, counter-clockwise positive in the external camera's image. Times are s from the
    start of phase B. The recording is read on first access to its data; a damaged recording raises
    `SessionError` then.
    """

    def __init__(self, folder: Path, manifest: TrialManifest, row: records.Lift) -> None:
        self._folder, self._manifest, self._row = folder, manifest, row

    def __repr__(self) -> str:
        return f"<Lift {self.number}: {self.object}/{self.lift} {self.name}, {self.outcome}>"

    number: int = _stored_value("_row.number", "Number of the lift in the session, from 1.")
    object: str = _stored_value("_row.object", "Id of the object.")
    name: str = _stored_value("_row.name", "Name of the object.")
    lift: int = _stored_value("_row.lift", "Number of the lift among those of this object, from 1.")
    outcome: str = _stored_value(
        "_row.outcome.value",
        'Outcome of the lift: "slipped", "held", "fallen", or after a reaction to slip "caught".',
    )
    simulated: bool = _stored_value("_row.simulated", "Whether the bench was a simulated one.")
    answered: float = _stored_value("_row.answered", "Share of the frames in phases B and C with an angle.")
    estimate: Angles = _stored_value("_read.estimate", "Fused angle of both fingertips.")
    truth: Angles = _stored_value(
        "_read.truth", "Ground truth from the markers, at the times of the camera frames."
    )

    @property
    def mean_error_deg(self) -> float:
        """Mean absolute error over phases B and C, as in tables; NaN if all frames were refused."""
        return float("nan") if self._row.re is None else self._row.re.mean_deg

    @property
    def serials(self) -> tuple[str, ...]:
        """Serials of the fingertips."""
        return tuple(self._manifest.signs)

    @property
    def phases_s(self) -> dict[str, float]:
        """Start of each phase by its name, s from the start of phase B."""
        return self._read.begins_s

    @property
    def error_deg(self) -> Floats:
        """(N,) estimate minus ground truth at the times of the estimate; NaN if either is missing."""
        return self._read.error_deg

    @cached_property
    def arm(self) -> ArmTrack:
        """Poses of the tool centre point, and joint angles."""
        states = list(recorded_arm_states(self._recording))
        poses = [pose_matrix(state.base_T_tcp) for state in states]
        joints = [state.joints_rad for state in states]
        return ArmTrack(self._times(states), _array(poses, 4, 4), _array(joints, 6))

    @cached_property
    def wrench(self) -> WrenchTrack:
        """Force and torque at the tool centre point, in the base's axes."""
        states = list(recorded_arm_states(self._recording))
        wrench = _array([state.wrench or (np.nan,) * 6 for state in states], 6)
        return WrenchTrack(self._times(states), wrench[:, :3], wrench[:, 3:])

    @cached_property
    def gripper(self) -> GripperTrack:
        """Opening, motor current, and whether the fingers move."""
        messages = [
            (time_ns / NS_PER_S - self._zero_s, recorded_gripper(data, self._recording))
            for _, time_ns, _, data in recorded_messages(self._recording, GRIPPER_TOPIC)
        ]
        return GripperTrack(
            _array([time_s for time_s, _ in messages]),
            _array([kept.opening_m for _, kept in messages]),
            _array([np.nan if kept.current_a is None else kept.current_a for _, kept in messages]),
            np.array([kept.moving for _, kept in messages], bool),
        )

    @cached_property
    def markers(self) -> MarkerTrack:
        """Corners of the markers in the camera frames, detected on first access; `truth` is their angle."""
        camera = self._manifest.config.require("camera")
        tracker = MarkerTracker(camera.marker_ids, camera.marker_dictionary)
        times_s, corners = [], []
        for frame in recorded_frames(self._recording, camera.serial):
            found = tracker.detect(np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), np.uint8))
            times_s.append(frame.time_ns / NS_PER_S - self._zero_s)
            corners.append(np.full((2, 4, 2), np.nan) if isinstance(found, Refusal) else found)
        return MarkerTrack(_array(times_s), _array(corners, 2, 4, 2))

    def tip(self, serial: str) -> Angles:
        """Return the angle of one fingertip. Raises `InputError` for an unknown serial."""
        self._require(serial)
        return self._read.tips[serial]

    def frames(self, serial: str, masks: str | None = None) -> Iterator[SensorFrame]:
        """Return an iterator over the frames of a fingertip, or for "camera" of the external camera.

        masks: method of the contact masks, "classical" (difference from the frame without contact), "ours",
        "pspnet" or an ONNX file; None for no masks. Raises `InputError`, `SessionError`.
        """
        serial = arguments.instance("frames: serial", serial, str, "a serial or 'camera'")
        if serial == CAMERA:
            serial = self._manifest.config.require("camera").serial
        else:
            self._require(serial)
        segmenter = None
        if masks is not None:
            # imported here, because onnxruntime takes longer to import than all the rest
            from rig.frames.masks import SegmentChoice, make_segmenter

            choice = SegmentChoice(str(arguments.path("frames: masks", masks)))
            segmenter = make_segmenter(choice, self.background(serial))

        def read() -> Iterator[SensorFrame]:
            for frame in recorded_frames(self._recording, serial):
                mask = None
                if segmenter is not None:
                    found = segmenter.segment(frame.image).contact.mask
                    mask = np.zeros(frame.image.shape[:2], np.uint8) if found is None else found
                yield SensorFrame(frame.time_ns / NS_PER_S - self._zero_s, frame.image, mask)

        return read()

    def background(self, serial: str) -> Image:
        """Return the frame of a fingertip without contact, (H, W, 3) uint8 RGB. Raises `InputError`."""
        self._require(serial)
        grasp_ns = round(self._row.phases_s[Phase.GRASP] * NS_PER_S)
        before = (f.image for f in recorded_frames(self._recording, serial) if f.time_ns < grasp_ns)
        return mean_background(list(before))

    def sign(self, serial: str) -> int:
        """Return the factor, +1 or -1, from a fingertip's image angle to the object angle."""
        self._require(serial)
        return self._manifest.signs[serial]

    def pixel_aspect(self, serial: str) -> float | None:
        """Return the width of a fingertip's pixel on the gel divided by its height; None if unknown."""
        self._require(serial)
        return self._manifest.config.pixel_aspects()[serial]

    def estimator(self, serial: str) -> "StreamingEstimator":
        """Make the estimator that ran on a fingertip: with its background, pixel aspect, sign and gel.

        On the fingertip's frames it gives the angles of `tip`, before their zero is subtracted. Raises
        `InputError` for an unknown serial, `EstimatorError` if it was not one of the rig's own.
        """
        # imported here, because a session can be read without the estimators' libraries
        from rig.frames.streaming import StreamingEstimator
        from rig.tactile.estimators import stored_choice

        self._require(serial)
        manifest, background = self._manifest, self.background(serial)
        choice = stored_choice(manifest.estimator, manifest.window, manifest.skip)
        choice = replace(choice, gel=manifest.config.calibrations.gel.get(serial))
        compute_in_one_thread()
        made = choice.make(background, self.pixel_aspect(serial), self.sign(serial))
        return StreamingEstimator(made, background.shape, self.sign(serial))

    def to_pandas(self) -> "DataFrame":
        """Return a pandas DataFrame, a row per frame: time_s, estimate_deg, sigma_deg, truth_deg, state."""
        estimate = self._read.estimate
        return data_frame(
            {
                "time_s": estimate.time_s,
                "estimate_deg": estimate.angle_deg,
                "sigma_deg": estimate.sigma_deg,
                "truth_deg": self._read.truth.at(estimate.time_s),
                "state": estimate.states,
            }
        )

    @cached_property
    def _read(self) -> records.Lift:
        return read_angles(self._folder, self._row, self._manifest.signs)

    def _times(self, states: list[ArmState]) -> Floats:
        return _array([state.time_ns / NS_PER_S - self._zero_s for state in states])

    @property
    def _recording(self) -> Path:
        return self._folder / self._row.recording

    @property
    def _zero_s(self) -> float:
        return self._row.phases_s[Phase.LIFT]

    def _require(self, serial: str) -> None:
        serial = arguments.instance("serial", serial, str, f"one of {', '.join(self.serials)}")
        if serial not in self._manifest.signs:
            raise unknown_name(f"fingertip of {self!r}", serial, self.serials)


class Session:
    """A stored trial. Reading never changes it, and never imports a class that it names.

    lifts: the finished lifts that can be read, in order. problems: messages about lifts that cannot be read.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = folder = arguments.path("open_session: folder", folder)
        self._manifest = read_manifest_of(folder, TrialManifest, "rig.open_session opens trials")
        usable = read_usable_lifts(folder)
        rows = sorted(usable.lifts, key=lambda row: row.number)
        self.lifts = tuple(Lift(folder, self._manifest, row) for row in rows)
        self.problems = usable.problems

    def __repr__(self) -> str:
        mark = "SIMULATED " if self.simulated else ""
        return (
            f"<{mark}Session {self._folder}: {plural(len(self.lifts), 'lift')}, estimator {self.estimator}>"
        )

    def __len__(self) -> int:
        return len(self.lifts)

    def __iter__(self) -> Iterator[Lift]:
        return iter(self.lifts)

    folder: Path = _stored_value("_folder", "Folder of the session.")
    bench: str = _stored_value("_manifest.bench", "Name of the bench.")
    simulated: bool = _stored_value("_manifest.simulated", "Whether the bench was a simulated one.")
    estimator: str = _stored_value("_manifest.estimator", "Name of the estimator that ran during the lifts.")
    started: str = _stored_value("_manifest.started", "Start of the session, UTC, to the second.")

    @property
    def complete(self) -> bool:
        """Whether all requested lifts are finished."""
        return self._manifest.status == "complete"

    def to_pandas(self) -> "DataFrame":
        """Return a pandas DataFrame with a row per lift."""
        keys = ("number", "object", "name", "lift", "outcome", "simulated", "mean_error_deg", "answered")
        return data_frame({key: [getattr(lift, key) for lift in self.lifts] for key in keys})


def open_session(folder: str | Path) -> Session:
    """Open a stored trial. Only its tables are read; recordings are read on access to their data.

    Raises `SessionError` if the folder is not a trial, or has no finished lift.
    """
    return Session(folder)


def _array(rows: list, *shape: int) -> Floats:
    """Return rows of the given shape as an array (N, *shape), also for N = 0."""
    return np.array(rows, np.float64).reshape(len(rows), *shape)
