"""Reading the lifts of a session back."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeVar

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from mcap.exceptions import McapError
from mcap.reader import make_reader
from pydantic import ConfigDict

from drivers.errors import SessionError
from drivers.types import ArmMode, ArmState, Frame, Pose, Vector6
from protocols.observer import LiftObserver, Phase
from rig.sessions.codec import STRICT, Codec
from rig.sessions.images import decoded
from rig.sessions.recorder import ARM_TOPIC, JOINTS_TOPIC, PHASE_TOPIC, RecordedAngle, image_topic

Value = TypeVar("Value")


@dataclass(frozen=True)
class _Phase:
    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    phase: Phase


@dataclass(frozen=True)
class _Joints:
    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    joints_rad: Vector6
    wrench: Vector6
    mode: ArmMode


@dataclass(frozen=True)
class _Angle:
    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    angle_deg: float | None
    sigma_deg: float | None
    state: str
    contact_area_px: float | None = None


_PHASE: Codec[_Phase] = Codec(_Phase)
_JOINTS: Codec[_Joints] = Codec(_Joints)
_ANGLE: Codec[_Angle] = Codec(_Angle)


def show_again(path: Path, observer: LiftObserver) -> None:
    """Give a recorded lift to an observer exactly as it was given when it happened.

    Raises `SessionError` when the recording is missing or damaged.
    """
    pose = b""
    for topic, time_ns, sequence, data in recorded_messages(path):
        if topic == PHASE_TOPIC:
            observer.phase(_parsed(_PHASE, data, path).phase, time_ns)
        elif topic == ARM_TOPIC:
            pose = data
        elif topic == JOINTS_TOPIC:
            observer.arm(_arm_state(pose, _parsed(_JOINTS, data, path), time_ns))
        elif topic.startswith(image_topic("")):
            observer.frame(_frame(data, time_ns, sequence))


def recorded_frames(path: Path, serial: str) -> Iterator[Frame]:
    """Yield one source's frames in order. Raises `SessionError`."""
    for _, time_ns, sequence, data in recorded_messages(path, image_topic(serial)):
        yield _frame(data, time_ns, sequence)


def recorded_arm_states(path: Path) -> Iterator[ArmState]:
    """Yield the arm's states in order. Raises `SessionError`."""
    pose = b""
    for topic, time_ns, _, data in recorded_messages(path, ARM_TOPIC, JOINTS_TOPIC):
        if topic == ARM_TOPIC:
            pose = data
        else:
            yield _arm_state(pose, _parsed(_JOINTS, data, path), time_ns)


def phase_times(path: Path) -> dict[Phase, int]:
    """Return when each phase of a recorded lift began, ns. Raises `SessionError`."""
    begun = recorded_messages(path, PHASE_TOPIC)
    return {_parsed(_PHASE, data, path).phase: time_ns for _, time_ns, _, data in begun}


def recorded_angles(path: Path, topic: str) -> list[RecordedAngle]:
    """Return the angles of a topic in the order they were written. Raises `SessionError`."""
    found = []
    for _, time_ns, _, data in recorded_messages(path, topic):
        angle = _parsed(_ANGLE, data, path)
        found.append(RecordedAngle(time_ns, angle.angle_deg, angle.sigma_deg, angle.state))
    return found


def recorded_messages(path: Path, *topics: str) -> Iterator[tuple[str, int, int, bytes]]:
    """Yield (topic, time_ns, sequence, data) in the order they were written, of all or some topics."""
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            for _, channel, message in reader.iter_messages(topics or None, log_time_order=False):
                yield channel.topic, message.log_time, message.sequence, message.data
    except FileNotFoundError as error:
        raise SessionError(f"{path}: the recording is missing") from error
    except (McapError, EOFError, OSError, ValueError) as error:
        raise SessionError(f"{path}: the recording is damaged ({error})") from error


def recorded_pose(data: bytes) -> Pose:
    """Return `base_T_tcp` of a message of the arm's topic."""
    pose = PoseInFrame.FromString(data).pose
    position, quaternion = pose.position, pose.orientation
    return Pose(
        (position.x, position.y, position.z),
        (quaternion.x, quaternion.y, quaternion.z, quaternion.w),
    )


def recorded_jpeg(data: bytes) -> bytes:
    """Return the stored bytes of a message of an image topic."""
    return CompressedImage.FromString(data).data


def _parsed(codec: Codec[Value], data: bytes, path: Path) -> Value:
    try:
        return codec.parsed(data)
    except ValueError as error:
        raise SessionError(f"{path}: the recording is damaged ({error})") from error


def _frame(data: bytes, time_ns: int, sequence: int) -> Frame:
    message = CompressedImage.FromString(data)
    return Frame(decoded(message.data), time_ns, sequence, message.frame_id, message.data)


def _arm_state(data: bytes, joints: _Joints, time_ns: int) -> ArmState:
    """Put together what the recorder keeps as a pose and as joints."""
    return ArmState(
        time_ns=time_ns,
        base_T_tcp=recorded_pose(data),
        joints_rad=joints.joints_rad,
        wrench=joints.wrench,
        mode=joints.mode,
    )
