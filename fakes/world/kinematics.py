"""Rigid transforms and UR5e kinematics in plain floats: a simulated arm computes several of them every 2 ms.

A `Frame` is a tuple of twelve floats: position x y z in m, then the rotation matrix row by row. numpy and
scipy take about ten microseconds a call on arrays this small; these functions take two or three.

Kinematics: nominal Denavit-Hartenberg parameters (Universal Robots, DH page); a real arm differs by its
calibration. The inverse is in closed form: joints 2, 3 and 4 are parallel, so the wrist gives joints 1, 5 and
6, and a planar two-link arm the others (up to eight solutions; Hawkins 2013).
"""

import math
from collections.abc import Iterable
from itertools import product

import numpy as np

from drivers.types import Pose, Vector6

Frame = tuple[float, ...]
Quaternion = tuple[float, float, float, float]
A2_M, A3_M = -0.425, -0.3922
D1_M, D4_M, D5_M, D6_M = 0.1625, 0.1333, 0.0997, 0.0996
ELBOW_UP: Vector6 = (0.0, -1.75, -1.9, -1.05, 1.57, 0.0)
ENCODER_RAD = 3e-5
"""Standard deviation of the joint angles that a UR5e at rest reports (measured on a real arm)."""
_CYCLE_NS, _NOISE_CYCLES = 2_000_000, 9973
_TWO_PI = 2.0 * math.pi
_ON_AXIS = 1e-9


class Encoders:
    """Adds the noise of the encoders to joint angles; a new reading every 2 ms. seed: of the noise."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng((seed, 47))
        self._noise = rng.normal(0.0, ENCODER_RAD, (_NOISE_CYCLES, 6)).tolist()

    def measure(self, joints_rad: Vector6, time_ns: int) -> Vector6:
        noise = self._noise[time_ns // _CYCLE_NS % _NOISE_CYCLES]
        return six(q + n for q, n in zip(joints_rad, noise, strict=True))


def six(values: Iterable[float]) -> Vector6:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f


def compose(a: Frame, b: Frame) -> Frame:
    """Return `a_T_c` of `a_T_b` and `b_T_c`."""
    ax, ay, az, a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    bx, by, bz, b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        ax + a0 * bx + a1 * by + a2 * bz,
        ay + a3 * bx + a4 * by + a5 * bz,
        az + a6 * bx + a7 * by + a8 * bz,
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def inverse(a: Frame) -> Frame:
    """Return `b_T_a` of `a_T_b`."""
    x, y, z, r0, r1, r2, r3, r4, r5, r6, r7, r8 = a
    return (
        -(r0 * x + r3 * y + r6 * z),
        -(r1 * x + r4 * y + r7 * z),
        -(r2 * x + r5 * y + r8 * z),
        *(r0, r3, r6, r1, r4, r7, r2, r5, r8),
    )


def from_quaternion(position: tuple[float, ...], quaternion_xyzw: Quaternion) -> Frame:
    x, y, z, w = quaternion_xyzw
    return (
        *position[:3],
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def quaternion(a: Frame) -> Quaternion:
    """Return the orientation as a unit quaternion xyzw with w >= 0 (Shepperd 1978)."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = a[3:]
    trace = r0 + r4 + r8
    if trace >= max(r0, r4, r8):
        q = (r7 - r5, r2 - r6, r3 - r1, 1.0 + trace)
    elif r0 >= max(r4, r8):
        q = (1.0 + r0 - r4 - r8, r1 + r3, r2 + r6, r7 - r5)
    elif r4 >= r8:
        q = (r1 + r3, 1.0 - r0 + r4 - r8, r5 + r7, r2 - r6)
    else:
        q = (r2 + r6, r5 + r7, 1.0 - r0 - r4 + r8, r3 - r1)
    norm = math.copysign(math.sqrt(sum(v * v for v in q)), q[3])
    return q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm


def from_ur(pose: tuple[float, ...]) -> Frame:
    """Build a frame from the controller's notation: x y z in m, rotation vector in rad."""
    rx, ry, rz = pose[3:6]
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    scale = math.sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
    return from_quaternion(pose, (rx * scale, ry * scale, rz * scale, math.cos(0.5 * angle)))


def to_ur(a: Frame) -> Vector6:
    """Return a frame in the controller's notation: x y z in m, rotation vector in rad (angle <= pi)."""
    x, y, z, w = quaternion(a)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-9 else 2.0
    return a[0], a[1], a[2], x * scale, y * scale, z * scale


def from_pose(pose: Pose) -> Frame:
    return from_quaternion(pose.position_m, pose.quaternion_xyzw)


TOOL_LENGTH_M = 0.28
"""Flange to fingertips: 3-Finger gripper with DIGITs, nominal."""
PHYSICAL_TOOL = from_quaternion((0.0, 0.0, TOOL_LENGTH_M), (0.0, 0.0, 0.0, 1.0))


def to_pose(a: Frame) -> Pose:
    return Pose((a[0], a[1], a[2]), quaternion(a))


def rotation_between(start: Frame, end: Frame) -> tuple[float, float, float]:
    """Return the rotation vector, in base axes, from one orientation to another, rad."""
    turn = to_ur(compose((0.0, 0.0, 0.0, *end[3:]), inverse((0.0, 0.0, 0.0, *start[3:]))))
    return turn[3], turn[4], turn[5]


def move_frame(a: Frame, shift_m: tuple[float, ...], turn_rad: tuple[float, ...]) -> Frame:
    """Return a frame shifted by `shift_m` and turned about its own origin, both in base axes."""
    turned = compose(from_ur((0.0, 0.0, 0.0, *turn_rad)), (0.0, 0.0, 0.0, *a[3:]))
    return (a[0] + shift_m[0], a[1] + shift_m[1], a[2] + shift_m[2], *turned[3:])


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
    """Return the joint angles nearest to `near_rad` that reach a pose, None if it is out of reach."""
    branches = product((1, -1), repeat=3)
    solutions = [s for b in branches if (s := _solve(base_T_flange, near_rad, *b)) is not None]
    return min(
        solutions, key=lambda q: sum((x - y) ** 2 for x, y in zip(q, near_rad, strict=True)), default=None
    )


def tracked_inverse(base_T_flange: Frame, near_rad: Vector6) -> Vector6 | None:  # noqa: N803
    """Return the solution on the same branch as `near_rad`, for small steps along a path."""
    wrist = _wrist_centre(base_T_flange)
    shoulder = 1 if _off(_shoulder(wrist, 1), near_rad[0]) <= _off(_shoulder(wrist, -1), near_rad[0]) else -1
    return _solve(
        base_T_flange, near_rad, shoulder, 1 if near_rad[4] >= 0 else -1, 1 if near_rad[2] >= 0 else -1
    )


def _wrist(s5: float, c5: float, s6: float, c6: float) -> Frame:
    """Return the transform from frame 4 to the flange."""
    return (*(-s5 * D6_M, c5 * D6_M, D5_M), *(c5 * c6, -c5 * s6, -s5, s5 * c6, -s5 * s6, c5, -s6, -c6, 0.0))


def _wrist_centre(flange: Frame) -> tuple[float, float]:
    return flange[0] - D6_M * flange[5], flange[1] - D6_M * flange[8]


def _shoulder(wrist: tuple[float, float], side: int) -> float:
    """Return joint 1; NaN if the wrist is closer to the base axis than the offset of the arm."""
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
    return six(a - _TWO_PI * round((a - n) / _TWO_PI) for a, n in zip((q1, *arm, q5, q6), near, strict=True))


def _planar(
    flange: Frame, s1: float, c1: float, wrist: Frame, elbow: int
) -> tuple[float, float, float] | None:
    """Return joints 2, 3 and 4: a two-link arm in the plane of the upper arm."""
    shoulder = (0.0, 0.0, D1_M, c1, 0.0, s1, s1, 0.0, -c1, 0.0, 1.0, 0.0)
    frame = compose(inverse(shoulder), compose(flange, inverse(wrist)))
    x, y = frame[0], frame[1]
    cos3 = (x * x + y * y - A2_M * A2_M - A3_M * A3_M) / (2 * A2_M * A3_M)
    if abs(cos3) > 1.0 + _ON_AXIS:
        return None
    q3 = elbow * math.acos(max(-1.0, min(1.0, cos3)))
    q2 = math.atan2(y, x) - math.atan2(A3_M * math.sin(q3), A2_M + A3_M * math.cos(q3))
    return q2, q3, math.atan2(frame[6], frame[3]) - q2 - q3


def _off(angle: float, near: float) -> float:
    return math.inf if math.isnan(angle) else abs((angle - near + math.pi) % _TWO_PI - math.pi)
