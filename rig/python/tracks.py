"""The recorded data of a lift as arrays over time: arm, wrench, gripper and markers."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.markers.tracker import MarkerTracker
from calibration.poses import pose_matrix
from calibration.targets.aruco import Refusal
from drivers.clock import NS_PER_S
from drivers.types import ArmState
from drivers.values import short_repr
from rig.sessions.reading import recorded_arm_states, recorded_frames, recorded_gripper
from rig.sessions.recorder import GRIPPER_TOPIC
from rig.sessions.recording_file import recorded_messages
from rig.tactile.angles import Floats


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


def read_arm(recording: Path, zero_s: float) -> ArmTrack:
    """Read the arm's states. zero_s: bench time that becomes time 0. Raises `SessionError`."""
    states = list(recorded_arm_states(recording))
    poses = [pose_matrix(state.base_T_tcp) for state in states]
    joints = [state.joints_rad for state in states]
    return ArmTrack(_times(states, zero_s), _array(poses, 4, 4), _array(joints, 6))


def read_wrench(recording: Path, zero_s: float) -> WrenchTrack:
    """Read the wrench; arguments and errors as for `read_arm`."""
    states = list(recorded_arm_states(recording))
    wrench = _array([state.wrench or (np.nan,) * 6 for state in states], 6)
    return WrenchTrack(_times(states, zero_s), wrench[:, :3], wrench[:, 3:])


def read_gripper(recording: Path, zero_s: float) -> GripperTrack:
    """Read the gripper's states; arguments and errors as for `read_arm`."""
    messages = [
        (time_ns / NS_PER_S - zero_s, recorded_gripper(data, recording))
        for _, time_ns, _, data in recorded_messages(recording, GRIPPER_TOPIC)
    ]
    return GripperTrack(
        _array([time_s for time_s, _ in messages]),
        _array([kept.opening_m for _, kept in messages]),
        _array([np.nan if kept.current_a is None else kept.current_a for _, kept in messages]),
        np.array([kept.moving for _, kept in messages], bool),
    )


def read_markers(recording: Path, zero_s: float, serial: str, tracker: MarkerTracker) -> MarkerTrack:
    """Detect the markers in the frames of the camera `serial`; the rest as for `read_arm`."""
    times, corners = [], []
    for frame in recorded_frames(recording, serial):
        found = tracker.detect(np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), np.uint8))
        times.append(frame.time_ns / NS_PER_S - zero_s)
        corners.append(np.full((2, 4, 2), np.nan) if isinstance(found, Refusal) else found)
    return MarkerTrack(_array(times), _array(corners, 2, 4, 2))


def _times(states: list[ArmState], zero_s: float) -> Floats:
    return _array([state.time_ns / NS_PER_S - zero_s for state in states])


def _array(rows: list, *shape: int) -> Floats:
    """Return rows of the given shape as an array (N, *shape), also for N = 0."""
    return np.array(rows, np.float64).reshape(len(rows), *shape)
