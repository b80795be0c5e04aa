"""UR5e kinematics in closed form: fast enough to be asked every 2 ms.

Nominal Denavit-Hartenberg parameters (Universal Robots, DH page); a real arm differs by its
calibration. The inverse follows from the geometry: joints 2, 3 and 4 are parallel, so the wrist
gives joints 1, 5 and 6, and a planar two-link arm the rest (up to eight solutions; Hawkins 2013).
"""

import math
from itertools import product

from drivers.types import Vector6
from fakes.wire.ur.frames import Frame, compose, from_quaternion, inverse

A2_M, A3_M = -0.425, -0.3922
D1_M, D4_M, D5_M, D6_M = 0.1625, 0.1333, 0.0997, 0.0996
_TWO_PI = 2.0 * math.pi
_ON_AXIS = 1e-9


def forward(joints_rad: Vector6) -> Frame:
    """Return `base_T_flange` of six joint angles."""
    q1, q2, q3, q4, q5, q6 = joints_rad
    s1, c1, s5, c5, s6, c6 = (f(q) for q in (q1, q5, q6) for f in (math.sin, math.cos))
    s23, c23 = math.sin(q2 + q3), math.cos(q2 + q3)
    s234, c234 = math.sin(q2 + q3 + q4), math.cos(q2 + q3 + q4)
    # Reach and height of frame 4 in the arm's plane, and its axes; then the two wrist joints.
    reach = A2_M * math.cos(q2) + A3_M * c23
    wrist_1 = (
        *(c1 * reach + D4_M * s1, s1 * reach - D4_M * c1, D1_M + A2_M * math.sin(q2) + A3_M * s23),
        *(c1 * c234, s1, c1 * s234, s1 * c234, -c1, s1 * s234, s234, 0.0, -c234),
    )
    return compose(wrist_1, _wrist(s5, c5, s6, c6))


def nearest_inverse(base_T_flange: Frame, near_rad: Vector6) -> Vector6 | None:  # noqa: N803
    """Return the solution nearest to `near_rad`, or None when the pose is out of reach."""
    branches = product((1, -1), repeat=3)
    solutions = [s for b in branches if (s := _solve(base_T_flange, near_rad, *b)) is not None]
    return min(solutions, key=lambda q: _distance(q, near_rad), default=None)


def tracked_inverse(base_T_flange: Frame, near_rad: Vector6) -> Vector6 | None:  # noqa: N803
    """Return the solution on the branch that `near_rad` is on: for small steps along a path."""
    wrist = _wrist_centre(base_T_flange)
    shoulder = 1 if _off(_shoulder(wrist, 1), near_rad[0]) <= _off(_shoulder(wrist, -1), near_rad[0]) else -1
    return _solve(
        base_T_flange, near_rad, shoulder, 1 if near_rad[4] >= 0 else -1, 1 if near_rad[2] >= 0 else -1
    )


def _wrist(s5: float, c5: float, s6: float, c6: float) -> Frame:
    """Frame 4 to flange."""
    return (
        *(-s5 * D6_M, c5 * D6_M, D5_M),
        *(c5 * c6, -c5 * s6, -s5, s5 * c6, -s5 * s6, c5, -s6, -c6, 0.0),
    )


def _wrist_centre(flange: Frame) -> tuple[float, float]:
    return flange[0] - D6_M * flange[5], flange[1] - D6_M * flange[8]


def _shoulder(wrist: tuple[float, float], side: int) -> float:
    """Joint 1; nan where the wrist is nearer to the base axis than the arm's offset."""
    radius = math.hypot(*wrist)
    if radius <= D4_M:
        return math.nan
    return math.atan2(wrist[1], wrist[0]) + side * math.acos(D4_M / radius) + math.pi / 2


def _solve(flange: Frame, near: Vector6, shoulder: int, wrist: int, elbow: int) -> Vector6 | None:
    q1 = _shoulder(_wrist_centre(flange), shoulder)
    if math.isnan(q1):
        return None
    s1, c1 = math.sin(q1), math.cos(q1)
    cos5 = (flange[0] * s1 - flange[1] * c1 - D4_M) / D6_M
    if abs(cos5) > 1.0 + _ON_AXIS:
        return None
    q5 = wrist * math.acos(max(-1.0, min(1.0, cos5)))
    s5 = math.sin(q5)
    q6 = near[5]  # free where the axes of joints 4 and 6 coincide
    if abs(s5) > 1e-6:
        q6 = math.atan2((flange[7] * c1 - flange[4] * s1) / s5, (flange[3] * s1 - flange[6] * c1) / s5)
    arm = _planar(flange, s1, c1, _wrist(s5, math.cos(q5), math.sin(q6), math.cos(q6)), elbow)
    if arm is None:
        return None
    return _unwrapped((q1, *arm, q5, q6), near)


def _planar(
    flange: Frame, s1: float, c1: float, wrist: Frame, elbow: int
) -> tuple[float, float, float] | None:
    """Joints 2, 3 and 4: a two-link arm in the plane of the upper arm."""
    shoulder = (0.0, 0.0, D1_M, c1, 0.0, s1, s1, 0.0, -c1, 0.0, 1.0, 0.0)
    frame = compose(inverse(shoulder), compose(flange, inverse(wrist)))
    x, y = frame[0], frame[1]
    cos3 = (x * x + y * y - A2_M * A2_M - A3_M * A3_M) / (2 * A2_M * A3_M)
    if abs(cos3) > 1.0 + _ON_AXIS:
        return None
    q3 = elbow * math.acos(max(-1.0, min(1.0, cos3)))
    q2 = math.atan2(y, x) - math.atan2(A3_M * math.sin(q3), A2_M + A3_M * math.cos(q3))
    return q2, q3, math.atan2(frame[6], frame[3]) - q2 - q3


def _unwrapped(joints: Vector6, near: Vector6) -> Vector6:
    """The same angles, each within half a turn of where the joint is."""
    q = [a - _TWO_PI * round((a - n) / _TWO_PI) for a, n in zip(joints, near, strict=True)]
    return q[0], q[1], q[2], q[3], q[4], q[5]


def _off(angle: float, near: float) -> float:
    return math.inf if math.isnan(angle) else abs((angle - near + math.pi) % _TWO_PI - math.pi)


def _distance(a: Vector6, b: Vector6) -> float:
    return sum((x - y) ** 2 for x, y in zip(a, b, strict=True))


def tool(length_m: float) -> Frame:
    """A straight tool along the flange's z axis."""
    return from_quaternion((0.0, 0.0, length_m), (0.0, 0.0, 0.0, 1.0))
