"""Rigid transforms in plain floats: the controller turns five of them over every 2 ms.

A `Frame` is a tuple of twelve floats: position x y z in m, then the rotation matrix row by row.
numpy and scipy take some ten microseconds a call on arrays this small; these take two or three.
"""

import math

from drivers.types import Pose, Vector6

Frame = tuple[float, ...]
Quaternion = tuple[float, float, float, float]
IDENTITY: Frame = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


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
    """Build a frame from a position in m and a unit quaternion."""
    x, y, z, w = quaternion_xyzw
    return (
        *position[:3],
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def quaternion(a: Frame) -> Quaternion:
    """Orientation as a unit quaternion xyzw with w >= 0 (Shepperd 1978)."""
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
    """The controller's notation of a frame: x y z in m, rotation vector in rad (angle <= pi)."""
    x, y, z, w = quaternion(a)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 1e-9 else 2.0
    return a[0], a[1], a[2], x * scale, y * scale, z * scale


def from_pose(pose: Pose) -> Frame:
    """Build a frame from the rig's pose."""
    return from_quaternion(pose.position_m, pose.quaternion_xyzw)


def to_pose(a: Frame) -> Pose:
    """The rig's pose of a frame."""
    return Pose((a[0], a[1], a[2]), quaternion(a))


def rotation_between(start: Frame, end: Frame) -> tuple[float, float, float]:
    """Rotation vector, in base axes, that turns one orientation into another; rad."""
    turn = to_ur(compose((0.0, 0.0, 0.0, *end[3:]), inverse((0.0, 0.0, 0.0, *start[3:]))))
    return turn[3], turn[4], turn[5]


def moved(a: Frame, shift_m: tuple[float, ...], turn_rad: tuple[float, ...]) -> Frame:
    """A frame shifted and turned about its own origin, both given in base axes."""
    turned = compose(from_ur((0.0, 0.0, 0.0, *turn_rad)), (0.0, 0.0, 0.0, *a[3:]))
    return (a[0] + shift_m[0], a[1] + shift_m[1], a[2] + shift_m[2], *turned[3:])
