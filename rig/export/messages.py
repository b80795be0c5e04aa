"""The messages of a recorded lift, decoded, in order: every export of lifts reads them.

A quaternion and its negative are the same rotation. A tool that points down has w near 0, so noise changes
the sign from step to step. Exported quaternions are canonical (w >= 0) at the start of an episode; each later
one has the sign that is nearer to the quaternion before.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.types import Pose
from rig.sessions.reading import (
    RecordedAngle,
    RecordedGripper,
    RecordedJoints,
    recorded_angle,
    recorded_gripper,
    recorded_joints,
    recorded_pose,
)
from rig.sessions.recorder import (
    ANGLE_PREFIX,
    ARM_TOPIC,
    FUSED_TOPIC,
    GRIPPER_TOPIC,
    IMAGE_PREFIX,
    JOINTS_TOPIC,
    TRUTH_TOPIC,
)
from rig.sessions.recording_file import recorded_messages
from rig.tactile.angles import FUSED, MARKERS


@dataclass(frozen=True, slots=True)
class LiftMessage:
    """A message of a lift. source: serial of an image or an angle, `FUSED` or `MARKERS`; else the topic.

    value: bytes for an image, see `recorded_jpeg`; a pose is continuous. None for other topics.
    """

    source: str
    time_ns: int
    sequence: int
    value: bytes | Pose | RecordedJoints | RecordedGripper | RecordedAngle | None


def lift_messages(path: Path, dated: bool = False) -> Iterator[LiftMessage]:
    """Yield the messages of a recording. dated: in UTC. Raises `SessionError` if it is damaged."""
    poses = ContinuousPoses()
    for topic, time_ns, sequence, data in recorded_messages(path, dated=dated):
        source, value = topic, None
        if topic.startswith(IMAGE_PREFIX):
            source, value = topic.removeprefix(IMAGE_PREFIX), data
        elif topic == ARM_TOPIC:
            value = poses.next(recorded_pose(data, path))
        elif topic == JOINTS_TOPIC:
            value = recorded_joints(data, path)
        elif topic == GRIPPER_TOPIC:
            value = recorded_gripper(data, path)
        elif topic.startswith(ANGLE_PREFIX):
            named = {FUSED_TOPIC: FUSED, TRUTH_TOPIC: MARKERS}
            source, value = named.get(topic, topic.removeprefix(ANGLE_PREFIX)), recorded_angle(data, path)
        yield LiftMessage(source, time_ns, sequence, value)


class ContinuousPoses:
    """Gives the poses of one episode, in order, continuous quaternions."""

    def __init__(self) -> None:
        self._last: NDArray[np.float64] | None = None

    def next(self, pose: Pose) -> Pose:
        """Return the pose with the sign of its quaternion that continues the previous one."""
        found = np.array(pose.quaternion_xyzw)
        against = found[3] if self._last is None else found @ self._last
        self._last = found = -found if against < 0.0 else found
        x, y, z, w = found.tolist()
        return replace(pose, quaternion_xyzw=(x, y, z, w))
