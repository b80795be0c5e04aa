"""The recorded data of a lift as arrays over time: angles, arm, wrench, gripper and markers."""

from dataclasses import dataclass, field
from importlib import import_module
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
from drivers.errors import InputError
from drivers.formats import MAX_TIME_S
from drivers.types import ArmState
from drivers.values import short_repr
from rig.sessions.reading import recorded_arm_states, recorded_frames, recorded_gripper
from rig.sessions.recorder import GRIPPER_TOPIC
from rig.sessions.recording_file import recorded_messages

if TYPE_CHECKING:
    from pandas import DataFrame  # pyright: ignore[reportMissingImports, reportMissingModuleSource]

Floats = NDArray[np.float64]
MAX_DEG = 1e9
"""Largest angle that is accepted: thousands of turns; larger ones are no angles."""


@dataclass(frozen=True, eq=False)
class Angles:
    """An angle over time.

    time_s: (N,) s, not decreasing. angle_deg: (N,) degrees, NaN if refused. sigma_deg: (N,) standard
    deviation, NaN if unknown; by default all are unknown. states: (N,) states of the estimator, or empty.
    Lists and other types that numpy can convert are accepted. Raises `InputError` for other shapes.
    """

    time_s: Floats
    angle_deg: Floats
    sigma_deg: Floats = field(default_factory=lambda: np.empty(0))
    states: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        time_s = arguments.array("Angles: time_s", self.time_s, (None,), MAX_TIME_S)
        angle_deg = arguments.array("Angles: angle_deg", self.angle_deg, (None,), MAX_DEG, unknown=True)
        sigma_deg = arguments.array("Angles: sigma_deg", self.sigma_deg, (None,), np.inf, unknown=True)
        sigma_deg = sigma_deg if sigma_deg.size else np.full(time_s.shape, np.nan)
        if not isinstance(self.states, tuple | list) or not all(isinstance(s, str) for s in self.states):
            raise arguments.refused("Angles: states", self.states, "a tuple of texts")
        if not time_s.shape == angle_deg.shape == sigma_deg.shape or len(self.states) not in (0, len(time_s)):
            raise InputError(
                f"Angles: {len(time_s)} times and {len(angle_deg)} angles: give the same number of each"
            )
        if (np.diff(time_s) < 0).any():
            raise InputError("Angles: time_s must not decrease: sort the rows by time")
        if (sigma_deg < 0).any():
            raise InputError("Angles: sigma_deg is negative: give a standard deviation, or NaN if unknown")
        object.__setattr__(self, "states", tuple(self.states))
        for name, values in (("time_s", time_s), ("angle_deg", angle_deg), ("sigma_deg", sigma_deg)):
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.time_s)

    def to_pandas(self) -> "DataFrame":
        """Return a pandas DataFrame with the columns time_s, angle_deg, sigma_deg and, if known, state."""
        columns: dict[str, Any] = {
            "time_s": self.time_s, "angle_deg": self.angle_deg, "sigma_deg": self.sigma_deg,
        }  # fmt: skip
        return data_frame(columns | ({"state": self.states} if self.states else {}))


def data_frame(columns: Any) -> "DataFrame":
    """Return a pandas DataFrame. Raises `InputError` if pandas is not installed."""
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise InputError("a DataFrame needs pandas, which is not installed: pip install pandas") from error
    return pandas.DataFrame(columns)


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
