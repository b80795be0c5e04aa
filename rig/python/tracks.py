"""The recorded data of a lift as arrays over time: arm, wrench, gripper and markers."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.values import short_repr
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
