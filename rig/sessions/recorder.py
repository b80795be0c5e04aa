"""Write one lift as an MCAP file, which standard viewers open.

Images and poses use Foxglove's well-known protobuf schemas; small values are JSON with schemas of this
module, so that viewers can plot them by field. Times are those of the bench's monotonic clock, ns, plus one
offset for the whole file, which makes them dates (`RecordingAbout`). The publish time of a message is its own
time, for a frame that of capture. Its log time is the same, but at least that of the previous message. So
received messages are in the order of log times, which is also the order that a replay needs. The angles are
written after the lift, again in the order of log times; readers that need a single order use the file's
index.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.errors import RecordingError
from drivers.types import ArmState, Frame, GripperState
from protocols.observer import LiftEvents
from rig.sessions.about import (
    CALIBRATION_TOPIC,
    CLOCK_OFFSET,
    CONTACT_PREFIX,
    TRANSFORMS_TOPIC,
    RecordingAbout,
    contact_outline,
)
from rig.tactile.angles import FUSED, MARKERS, Angles

ARM_TOPIC = "/arm/tcp"
JOINTS_TOPIC = "/arm/joints"
GRIPPER_TOPIC = "/gripper"
PHASE_TOPIC = "/phase"
REACTION_TOPIC = "/reaction"
IMAGE_PREFIX = "/image/"
ANGLE_PREFIX = "/angle/"
TRUTH_TOPIC = f"{ANGLE_PREFIX}truth"
FUSED_TOPIC = f"{ANGLE_PREFIX}estimate"
CHUNK_BYTES = 128 * 1024
"""A chunk is written when it exceeds this size: 4 to 8 frames, 1/25 s of a lift."""
_LARGEST_STEP_NS = NS_PER_S
"""Largest step of the log time between messages, so that one wrong time does not shift all later ones."""
RAW_COUNTS = ("position_counts", "current_counts")
"""Readings of a Robotiq gripper that are recorded in addition to the opening."""
_NUMBER = {"type": ["number", "null"]}
_SCHEMAS: dict[str, dict[str, object]] = {
    "rig.Phase": {"phase": {"type": "string"}},
    "rig.Reaction": {"step": {"type": "string"}, "position_steps": {"type": "integer"}},
    "rig.Joints": {
        "joints_rad": {"type": "array", "items": {"type": "number"}},
        "wrench": {"type": "array", "items": {"type": "number"}},
        "mode": {"type": "string"},
    },
    "rig.Gripper": {
        "opening_m": {"type": "number"},
        "current_a": {"type": "number"},
        "moving": {"type": "boolean"},
        "position_counts": {"type": "integer"},
        "current_counts": {"type": "integer"},
    },
    "rig.Angle": {
        "angle_deg": _NUMBER,
        "sigma_deg": _NUMBER,
        "state": {"type": "string"},
        "contact_area_px": _NUMBER,
    },
}


def image_topic(serial: str) -> str:
    return f"{IMAGE_PREFIX}{serial}"


def angle_topic(source: str) -> str:
    """Return the topic of the angles of a fingertip's serial, of `FUSED`, or of `MARKERS`."""
    return {FUSED: FUSED_TOPIC, MARKERS: TRUTH_TOPIC}.get(source, f"{ANGLE_PREFIX}{source}")


class LiftRecorder(LiftEvents):
    """Writes the messages of one lift to a binary stream as they arrive; `close` completes the file.

    stream: has `write` and `tell`, as `rig.sessions.unfinished.BackgroundFile`. about: the metadata of the
    file. jpeg: returns the JPEG of a frame; by default as received. Nothing is written before the first
    message. Every method raises `RecordingError` if the stream does.
    """

    def __init__(
        self,
        stream: Any,
        about: RecordingAbout | None = None,
        jpeg: Callable[[Frame], bytes | None] = attrgetter("jpeg"),
    ) -> None:
        self._jpeg = jpeg
        self._about = about or RecordingAbout()
        self._described = about is None
        # No compression, because images are JPEGs. A chunk is verified as a whole, so a damaged byte or a
        # killed program loses a whole chunk. The checksum of all data covers the bytes between chunks.
        self._writer = Writer(
            stream,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        self._begun = False
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._latest_ns: int | None = None
        self._results: list[tuple[int, int, bytes]] = []

    @property
    def begun(self) -> bool:
        return self._begun

    def frame(self, frame: Frame) -> None:
        jpeg = self._jpeg(frame)
        if jpeg is None:
            raise RecordingError(f"{frame.serial}: a frame without JPEG cannot be recorded")
        message = CompressedImage(frame_id=frame.serial, data=jpeg, format="jpeg")
        message.timestamp.FromNanoseconds(self._date(frame.time_ns))
        self._protobuf(image_topic(frame.serial), message, frame.time_ns, frame.sequence)

    def arm(self, state: ArmState) -> None:
        message = PoseInFrame(frame_id="base")
        message.timestamp.FromNanoseconds(self._date(state.time_ns))
        position, quaternion = message.pose.position, message.pose.orientation
        position.x, position.y, position.z = state.base_T_tcp.position_m
        quaternion.x, quaternion.y, quaternion.z, quaternion.w = state.base_T_tcp.quaternion_xyzw
        self._protobuf(ARM_TOPIC, message, state.time_ns, 0)
        felt = {} if state.wrench is None else {"wrench": state.wrench}
        joints = {"joints_rad": state.joints_rad, **felt, "mode": state.mode.value}
        self._json(JOINTS_TOPIC, "rig.Joints", state.time_ns, joints)

    def gripper(self, state: GripperState) -> None:
        """Record the gripper's state: opening, current if known, and the counts of a Robotiq."""
        counts = {name: state.raw[name] for name in RAW_COUNTS if name in state.raw}
        current = {} if state.current_a is None else {"current_a": state.current_a}
        value = {"opening_m": state.opening_m, "moving": state.moving, **current, **counts}
        self._json(GRIPPER_TOPIC, "rig.Gripper", state.time_ns, value)

    def phase(self, phase: str, time_ns: int) -> None:
        """Record the start of a phase; before the first one, the poses of camera and table."""
        if not self._described:
            self._described = True
            date = self._date(time_ns)
            self._protobuf(TRANSFORMS_TOPIC, self._about.transforms(date), time_ns, 0)
            if (calibration := self._about.calibration(date)) is not None:
                self._protobuf(CALIBRATION_TOPIC, calibration, time_ns, 0)
        self._json(PHASE_TOPIC, "rig.Phase", time_ns, {"phase": phase})

    def reaction(self, step: str, time_ns: int, position: int) -> None:
        self._json(REACTION_TOPIC, "rig.Reaction", time_ns, {"step": step, "position_steps": position})

    def angles(self, angles: Angles) -> None:
        """Record the angles of a fingertip, the fused ones, or the markers' ones."""
        topic = angle_topic(angles.source)
        columns = [angles.time_ns, angles.angle_deg, angles.sigma_deg]
        areas = angles.contact_area_px.tolist() or [None] * len(angles)
        for time_ns, angle, sigma, state, area in zip(
            *(column.tolist() for column in columns), angles.states, areas, strict=True
        ):
            value = {"angle_deg": _or_none(angle), "sigma_deg": _or_none(sigma), "state": state}
            size = {} if area is None else {"contact_area_px": area}
            date = self._date(time_ns)
            # angles arrive after the lift, one fingertip after the other
            channel = self._json_channel(topic, "rig.Angle")
            self._results.append((date, channel, _json_bytes({**value, **size})))

    def contact(self, serial: str, outline_px: Sequence[NDArray[np.floating]], time_ns: int) -> None:
        """Record the outline of a fingertip's contact, (N, 2) px each; empty without contact."""
        message = contact_outline(outline_px, self._date(time_ns))
        self._protobuf(f"{CONTACT_PREFIX}{serial}", message, time_ns, 0)

    def _date(self, time_ns: int) -> int:
        return time_ns + self._about.clock_offset_ns

    def close(self) -> None:
        """Write the angles in the order of their log times, and complete the file (index and summary)."""
        self._begin()
        for date, channel, data in sorted(self._results, key=itemgetter(0)):
            self._writer.add_message(channel, date, data, date, 0)
        self._writer.finish()

    def _begin(self) -> None:
        if self._begun:
            return
        self._begun = True
        self._writer.start()
        if self._about.values:
            self._writer.add_metadata("rig", dict(self._about.values))

    def _json(self, topic: str, schema: str, time_ns: int, value: Mapping[str, object]) -> None:
        self._keep(self._json_channel(topic, schema), time_ns, _json_bytes(value), 0)

    def _keep(self, channel: int, time_ns: int, data: bytes, sequence: int) -> None:
        self._begin()
        date = self._date(time_ns)
        latest = date if self._latest_ns is None else self._latest_ns
        self._latest_ns = max(latest, min(date, latest + _LARGEST_STEP_NS))
        self._writer.add_message(channel, self._latest_ns, data, date, sequence)

    def _json_channel(self, topic: str, name: str) -> int:
        def register() -> int:
            schema = {"type": "object", "title": name, "properties": _SCHEMAS[name]}
            return self._writer.register_schema(
                name=name, encoding=SchemaEncoding.JSONSchema, data=json.dumps(schema).encode()
            )

        return self._channel(topic, name, MessageEncoding.JSON, register)

    def _protobuf(self, topic: str, message: Message, time_ns: int, sequence: int) -> None:
        def register() -> int:
            return register_schema(self._writer, type(message))

        channel = self._channel(topic, type(message).__name__, MessageEncoding.Protobuf, register)
        self._keep(channel, time_ns, message.SerializeToString(deterministic=True), sequence)

    def _channel(self, topic: str, schema: str, encoding: str, register: Callable[[], int]) -> int:
        """Return a topic's channel; register it, and its schema with `register`, when first used.

        Each channel has the clock offset, because a file's summary repeats channels and has a checksum.
        """
        if topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = register()
            offset = self._about.clock_offset_ns
            self._channels[topic] = self._writer.register_channel(
                topic=topic,
                message_encoding=encoding,
                schema_id=self._schemas[schema],
                metadata={CLOCK_OFFSET: str(offset)} if offset else {},
            )
        return self._channels[topic]


def _json_bytes(value: Mapping[str, object]) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode()


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def seconds_text(time_ns: int) -> str:
    """Return a time in s with all its digits."""
    whole, part = divmod(abs(time_ns), NS_PER_S)
    return f"{'-' if time_ns < 0 else ''}{whole}.{part:09d}"
