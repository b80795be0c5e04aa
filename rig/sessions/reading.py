"""Read the lifts of a session."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, TypeVar

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError
from pydantic import Field

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RecordingError, SessionError
from drivers.images import decode_stored
from drivers.types import ArmMode, ArmState, Frame, GripperState, Pose, Vector6
from protocols.observer import LiftEvents, Phase, ReactionStep
from rig.sessions.codec import Codec, strict
from rig.sessions.recorder import (
    ARM_TOPIC,
    GRIPPER_TOPIC,
    JOINTS_TOPIC,
    PHASE_TOPIC,
    REACTION_TOPIC,
    angle_topic,
    image_topic,
)
from rig.sessions.recording_file import Gaps, PhaseTimes, recorded_messages
from rig.sessions.records import Lift
from rig.tactile.angles import FUSED, MARKERS, Angles

Value = TypeVar("Value")
Message = TypeVar("Message", CompressedImage, PoseInFrame)
_NOT_A_TURN = 0.01
"""Largest deviation of a quaternion's norm from 1."""


@strict
@dataclass(frozen=True)
class _Phase:
    phase: Phase


@strict
@dataclass(frozen=True)
class RecordedReaction:
    """A step of a reaction to slip. position_steps: commanded, in the gripper's steps from open."""

    step: ReactionStep
    position_steps: int


@strict
@dataclass(frozen=True)
class RecordedJoints:
    """State of the arm in a recording, without its pose: rad; N and N m in the base axes.

    wrench: None if the arm has no force sensor.
    """

    joints_rad: Vector6
    mode: ArmMode
    wrench: Vector6 | None = None


@strict
@dataclass(frozen=True)
class RecordedGripper:
    """State of the gripper in a recording.

    opening_m: at least 0; the nominal opening of fingertips that press on a thin object is below it.
    current_a, position_counts, current_counts: None for a gripper without them.
    """

    moving: bool
    opening_m: float
    current_a: float | None = None
    position_counts: Annotated[int, Field(ge=0)] | None = None
    current_counts: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "opening_m", max(self.opening_m, 0.0))


@strict
@dataclass(frozen=True)
class RecordedAngle:
    """A message of an angle topic, deg, None if refused. contact_area_px: only for a fingertip's angle."""

    angle_deg: float | None
    sigma_deg: float | None
    state: str
    contact_area_px: float | None = None


def _decoder(kind: type[Value]) -> Callable[[bytes, Path], Value]:
    """Return a function that decodes a JSON message; it raises `SessionError` for a damaged one."""
    codec: Codec[Value] = Codec(kind)

    def decode(data: bytes, path: Path) -> Value:
        try:
            return codec.parse(data)
        except ValueError as error:
            raise SessionError(f"{path}: the recording is damaged ({error})") from error

    return decode


_recorded_phase = _decoder(_Phase)
recorded_reaction = _decoder(RecordedReaction)
recorded_joints = _decoder(RecordedJoints)
recorded_gripper = _decoder(RecordedGripper)
recorded_angle = _decoder(RecordedAngle)


def show_again(
    path: Path,
    observer: LiftEvents,
    known_phases: Mapping[str, int] = MappingProxyType({}),
    gaps: Gaps | None = None,
) -> None:
    """Replay the events of a recorded lift to an observer, exactly as they happened.

    An unfinished recording is replayed up to its end. known_phases: start times in ns of phases whose message
    is in a gap. gaps: list to which damaged parts are added, see `recorded_messages`. Raises `SessionError`
    if the recording is missing, not of a complete lift, or, without `gaps`, damaged.
    """
    phases, pose, gaps_before = PhaseTimes(path, gaps), None, 0
    hidden: dict[str, int] = {}
    if gaps is not None:  # phases whose messages cannot be read
        messages = recorded_messages(path, PHASE_TOPIC, gaps=[])
        read = {_recorded_phase(data, path).phase for _, _, _, data in messages}
        lost = {name: time_ns for name, time_ns in known_phases.items() if name not in read}
        hidden = dict(sorted(lost.items(), key=itemgetter(1)))

    def begin(name: str, time_ns: int) -> None:
        phases.add(name, time_ns)
        observer.phase(Phase(name), time_ns)

    for topic, time_ns, sequence, data in recorded_messages(path, gaps=gaps):
        for name in [name for name, begins_ns in hidden.items() if begins_ns <= time_ns]:
            begin(name, hidden.pop(name))
        if gaps and len(gaps) != gaps_before:
            pose, gaps_before = None, len(gaps)
        if topic == PHASE_TOPIC:
            begin(_recorded_phase(data, path).phase, time_ns)
        elif topic == REACTION_TOPIC:
            done = recorded_reaction(data, path)
            observer.reaction(done.step, time_ns, done.position_steps)
        elif topic == ARM_TOPIC:
            pose = recorded_pose(data, path)
        elif topic == JOINTS_TOPIC and (pose is not None or not gaps):
            observer.arm(_arm_state(pose, data, path, time_ns))
        elif topic == GRIPPER_TOPIC:
            kept = recorded_gripper(data, path)
            observer.gripper(GripperState(time_ns, True, kept.moving, kept.opening_m))
        elif topic.startswith(image_topic("")):
            observer.frame(_frame(data, path, time_ns, sequence))
    for name, begins_ns in hidden.items():
        begin(name, begins_ns)
    phases.complete()


def recorded_frames(path: Path, serial: str, gaps: Gaps | None = None) -> Iterator[Frame]:
    """Yield one source's frames in order. gaps: see `recorded_messages`. Raises `SessionError`."""
    for _, time_ns, sequence, data in recorded_messages(path, image_topic(serial), gaps=gaps):
        yield _frame(data, path, time_ns, sequence)


def recorded_arm_states(path: Path) -> Iterator[ArmState]:
    """Yield the arm's states in order. Raises `SessionError`."""
    pose: Pose | None = None
    for topic, time_ns, _, data in recorded_messages(path, ARM_TOPIC, JOINTS_TOPIC):
        if topic == ARM_TOPIC:
            pose = recorded_pose(data, path)
        else:
            yield _arm_state(pose, data, path, time_ns)


def recorded_reactions(path: Path) -> list[tuple[ReactionStep, int]]:
    """Return the steps of reactions to slip, each with its time in ns. Raises `SessionError`."""
    messages = recorded_messages(path, REACTION_TOPIC)
    return [(recorded_reaction(data, path).step, time_ns) for _, time_ns, _, data in messages]


def phase_times(path: Path) -> dict[str, int]:
    """Return the start of each phase of a recorded lift in ns, by name; of an unfinished one up to its end.

    Raises `SessionError` if a required phase is missing or out of order.
    """
    phases = PhaseTimes(path)
    for _, time_ns, _, data in recorded_messages(path, PHASE_TOPIC):
        phases.add(_recorded_phase(data, path).phase, time_ns)
    return phases.complete()


def recorded_angles(
    path: Path, *sources: str, zero_s: float = 0.0, gaps: Gaps | None = None
) -> dict[str, Angles]:
    """Return the angles of some sources, see `Angles`, in order of time.

    zero_s: time 0, by the bench's clock. gaps: see `recorded_messages`. Raises `SessionError`.
    """
    found: dict[str, list[tuple[int, RecordedAngle]]] = {angle_topic(source): [] for source in sources}
    for topic, time_ns, _, data in recorded_messages(path, *found, gaps=gaps):
        found[topic].append((time_ns, recorded_angle(data, path)))
    try:
        return {source: _series(source, found[angle_topic(source)], zero_s) for source in sources}
    except InputError as error:
        raise SessionError(f"{path}: the recording is damaged ({error})") from error


def _series(source: str, messages: list[tuple[int, RecordedAngle]], zero_s: float) -> Angles:
    ordered = sorted(messages, key=itemgetter(0))
    angles = [angle for _, angle in ordered]
    return Angles(
        np.array([time_ns / NS_PER_S - zero_s for time_ns, _ in ordered], float),
        np.array([angle.angle_deg for angle in angles], float),  # None becomes NaN
        np.array([angle.sigma_deg for angle in angles], float),
        tuple(angle.state for angle in angles),
        np.array([angle.contact_area_px for angle in angles], float),
        source,
        round(zero_s * NS_PER_S),
    )


def read_angles(folder: Path, lift: Lift, serials: Iterable[str], gaps: Gaps | None = None) -> Lift:
    """Return a lift with the angles of its recording.

    folder: the session. serials: of the fingertips. gaps: see `recorded_messages`. Raises `SessionError`, and
    other errors for a damaged recording.
    """
    path, zero_s = folder / lift.recording, lift.phases_s[Phase.LIFT]
    angles = recorded_angles(path, FUSED, MARKERS, *serials, zero_s=zero_s, gaps=gaps)
    if not len(angles[FUSED]) or not len(angles[MARKERS]):
        raise SessionError(f"{path}: the recording is damaged: it holds no angles")
    return replace(lift, angles=angles)


def recorded_pose(data: bytes, path: Path) -> Pose:
    """Decode `base_T_tcp` from a message of the arm topic. Raises `SessionError`."""
    pose = _message(PoseInFrame, data, path).pose
    position, quaternion = pose.position, pose.orientation
    placed = Pose(
        (position.x, position.y, position.z),
        (quaternion.x, quaternion.y, quaternion.z, quaternion.w),
    )
    length = math.hypot(*placed.quaternion_xyzw)
    if not math.isfinite(sum(placed.position_m)) or not abs(length - 1.0) < _NOT_A_TURN:
        raise SessionError(f"{path}: the recording is damaged (invalid arm pose)")
    return placed


def recorded_jpeg(data: bytes, path: Path) -> bytes:
    """Return the JPEG bytes in a message of an image topic. Raises `SessionError`."""
    return _message(CompressedImage, data, path).data


def _message(kind: type[Message], data: bytes, path: Path) -> Message:
    try:
        return kind.FromString(data)
    except DecodeError as error:
        raise SessionError(f"{path}: the recording is damaged ({error})") from error


def _frame(data: bytes, path: Path, time_ns: int, sequence: int) -> Frame:
    message = _message(CompressedImage, data, path)
    try:
        return Frame(decode_stored(message.data), time_ns, sequence, message.frame_id, message.data)
    except RecordingError as error:
        raise SessionError(f"{path}: {error}") from error


def _arm_state(pose: Pose | None, data: bytes, path: Path, time_ns: int) -> ArmState:
    """Combine the pose and the joints, which are recorded in separate messages."""
    joints = recorded_joints(data, path)
    if pose is None:
        raise SessionError(f"{path}: the recording is damaged (the arm's joints without its pose)")
    return ArmState(
        time_ns=time_ns,
        base_T_tcp=pose,
        joints_rad=joints.joints_rad,
        wrench=joints.wrench,
        mode=joints.mode,
    )
