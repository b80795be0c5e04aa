"""What the arm's weight asks of its joints, and where its elbow is.

Masses and centres of gravity are UR's for the UR5e ("DH parameters for calculations of kinematics and
dynamics"). Gravity alone is modelled: neither friction nor acceleration.
"""

import math

from drivers.types import Vector3, Vector6
from fakes.wire.ur.frames import Frame
from fakes.wire.ur.kinematics import A2_M, A3_M, D1_M, D5_M

GRAVITY_M_S2 = 9.82
"""As URScript's set_gravity takes it unless told otherwise."""
UPPER_ARM_KG, FOREARM_KG, WRIST_1_KG, WRIST_2_KG, FLANGE_KG = 8.058, 2.846, 1.37, 1.3, 0.365
UPPER_ARM_FROM_ELBOW_M, FOREARM_FROM_WRIST_M = 0.2125, 0.15
HAND_KG = WRIST_1_KG + WRIST_2_KG + FLANGE_KG
NM_PER_A: Vector6 = (9.82, 9.82, 9.82, 7.1, 7.1, 7.1)
"""Torque of a joint per ampere of its motor: what currents in a state of UR's own simulator come to."""


def joint_torques(joints_rad: Vector6, flange: Frame, payload_kg: float, payload_cog_m: Vector3) -> Vector6:
    """Torques (N m) that hold the arm and its payload against gravity.

    Joint 1 turns about the vertical and carries nothing; the flange's lever about joints 5 and 6 is
    left out.
    """
    q1, q2, q3, q4 = joints_rad[:4]
    elbow_m = A2_M * math.cos(q2)
    wrist_m = elbow_m + A3_M * math.cos(q2 + q3)
    x, y = _carried_at(flange, payload_cog_m)
    masses = (  # each with how far it is from joint 1's axis in the direction in which the arm reaches
        (UPPER_ARM_KG, elbow_m + UPPER_ARM_FROM_ELBOW_M * math.cos(q2)),
        (FOREARM_KG, wrist_m + FOREARM_FROM_WRIST_M * math.cos(q2 + q3)),
        (WRIST_1_KG, wrist_m),
        (WRIST_2_KG, wrist_m + D5_M * math.sin(q2 + q3 + q4)),
        (FLANGE_KG + payload_kg, x * math.cos(q1) + y * math.sin(q1)),
    )
    about = (0.0, elbow_m, wrist_m)
    shoulder, elbow, wrist = (
        GRAVITY_M_S2 * sum(kg * (at - origin) for kg, at in masses[first:])
        for first, origin in enumerate(about)
    )
    return 0.0, shoulder, elbow, wrist, 0.0, 0.0


def joint_currents(torques_nm: Vector6) -> Vector6:
    """Currents (A) of the motors that make these torques."""
    a, b, c, d, e, f = (t / k for t, k in zip(torques_nm, NM_PER_A, strict=True))
    return a, b, c, d, e, f


def elbow_position(joints_rad: Vector6) -> Vector3:
    """Where the upper arm ends, base axes, m."""
    q1, q2 = joints_rad[:2]
    reach = A2_M * math.cos(q2)
    return reach * math.cos(q1), reach * math.sin(q1), D1_M + A2_M * math.sin(q2)


def elbow_velocity(joints_rad: Vector6, speeds_rad_s: Vector6) -> Vector3:
    """How fast the end of the upper arm moves, base axes, m/s."""
    q1, q2 = joints_rad[:2]
    v1, v2 = speeds_rad_s[:2]
    reach, shortening = A2_M * math.cos(q2), -A2_M * math.sin(q2) * v2
    return (
        shortening * math.cos(q1) - reach * math.sin(q1) * v1,
        shortening * math.sin(q1) + reach * math.cos(q1) * v1,
        A2_M * math.cos(q2) * v2,
    )


def tool_acceleration(flange: Frame) -> Vector3:
    """What an accelerometer in the flange reads at rest, m/s^2, flange axes."""
    return GRAVITY_M_S2 * flange[9], GRAVITY_M_S2 * flange[10], GRAVITY_M_S2 * flange[11]


def in_flange_axes(flange: Frame, wrench: Vector6) -> Vector6:
    """A wrench in base axes as the flange's axes have it."""
    r = flange[3:]
    fx, fy, fz, tx, ty, tz = wrench
    a, b, c = (r[k] * fx + r[k + 3] * fy + r[k + 6] * fz for k in range(3))
    d, e, f = (r[k] * tx + r[k + 3] * ty + r[k + 6] * tz for k in range(3))
    return a, b, c, d, e, f


def weight(flange: Frame, payload_kg: float, payload_cog_m: Vector3) -> Vector6:
    """Force (N) and torque (N m) of a payload's weight about the flange, base axes."""
    x, y = _carried_at(flange, payload_cog_m)
    pull = -payload_kg * GRAVITY_M_S2
    return 0.0, 0.0, pull, (y - flange[1]) * pull, -(x - flange[0]) * pull, 0.0


def _carried_at(flange: Frame, cog_m: Vector3) -> tuple[float, float]:
    """Where the payload's centre of gravity is, x and y in base."""
    x, y, z = cog_m
    return (
        flange[0] + flange[3] * x + flange[4] * y + flange[5] * z,
        flange[1] + flange[6] * x + flange[7] * y + flange[8] * z,
    )
