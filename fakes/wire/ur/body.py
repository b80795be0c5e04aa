"""The simulated arm itself: joints, flange and tool centre point, and what moves them."""

import math
from collections import deque
from collections.abc import Iterable
from typing import Protocol

from drivers.types import Vector6
from fakes.wire.ur.frames import (
    IDENTITY,
    Frame,
    compose,
    inverse,
    moved,
    rotation_between,
    to_pose,
)
from fakes.wire.ur.kinematics import forward, nearest_inverse, tracked_inverse
from fakes.world.motion import distance
from fakes.world.trapezoid import TrapezoidProfile

STILL: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
HISTORY_CYCLES = 500
MAX_JOINT_SPEED = math.pi
"""180 degrees per second, every joint of a UR5e (data sheet)."""
MAX_STEP_RAD = 4 * MAX_JOINT_SPEED * 0.002
"""A joint that would go further in one cycle is stopped: far beyond what the arm can."""
SERVO_ACCELERATION = 40.0
"""rad/s^2; servoj follows its target no faster (ours to define)."""
_LEAST = 1e-4
_NS = 1_000_000_000


class OutOfReachError(Exception):
    """A motion left what the joints can reach; the controller's own path check, never the user's input."""


class ArmMover(Protocol):
    """Something that moves the arm, cycle by cycle."""

    def step(self, body: "Body", dt_s: float) -> bool:
        """Move on by `dt_s`; return whether the motion has ended."""
        ...


class Body:
    """Where the arm is and how fast: `base_T_flange` by its joints, `flange_T_tcp` and payload as set."""

    def __init__(self, joints_rad: Vector6, flange_T_tcp: Frame = IDENTITY) -> None:  # noqa: N803
        self.q = joints_rad
        self.qd = STILL
        self.qdd = STILL
        self.twist = STILL
        self.acceleration = STILL
        self.payload_kg, self.payload_cog_m = 0.0, (0.0, 0.0, 0.0)
        self.flange = forward(joints_rad)
        self.tool = flange_T_tcp
        self.still_cycles = HISTORY_CYCLES
        self.history: deque[Vector6] = deque([joints_rad], maxlen=HISTORY_CYCLES)
        self.mover: ArmMover | None = None

    @property
    def tcp(self) -> Frame:
        """`base_T_tcp`."""
        return compose(self.flange, self.tool)

    @property
    def settled(self) -> bool:
        """Whether it has stood still long enough for speeds and accelerations to be zero."""
        return self.still_cycles > 2

    def reach(self, base_T_tcp: Frame, near: Vector6 | None = None) -> Vector6 | None:  # noqa: N803
        """Joint angles nearest to `near` (or to now) that bring the TCP there; None when out of reach."""
        return nearest_inverse(compose(base_T_tcp, inverse(self.tool)), near or self.q)

    def follow(self, base_T_tcp: Frame) -> None:  # noqa: N803
        """Take the TCP a small step on. Raises `OutOfReachError`."""
        flange = compose(base_T_tcp, inverse(self.tool))
        joints = tracked_inverse(flange, self.q)
        if joints is None or not self._can_step_to(joints):
            raise OutOfReachError
        self.q, self.flange = joints, flange

    def bend(self, joints_rad: Vector6) -> None:
        """Take the joints a small step on. Raises `OutOfReachError`."""
        if not self._can_step_to(joints_rad):
            raise OutOfReachError
        self.q, self.flange = joints_rad, forward(joints_rad)

    def _can_step_to(self, joints_rad: Vector6) -> bool:
        return all(abs(b - a) <= MAX_STEP_RAD for a, b in zip(self.q, joints_rad, strict=True))

    def step(self, dt_s: float, scale: float) -> bool:
        """One control cycle at a speed scale of 0 to 1; return whether the arm moved."""
        before, tcp = self.q, self.tcp
        try:
            if self.mover is not None and self.mover.step(self, dt_s * scale):
                self.mover = None
        finally:
            moved_now = self.q != before
            self._differentiate(before, tcp, dt_s, moved_now)
        return moved_now

    def _differentiate(self, before: Vector6, tcp: Frame, dt_s: float, moved_now: bool) -> None:
        self.history.append(self.q)
        self.still_cycles = 0 if moved_now else self.still_cycles + 1
        if self.settled:
            return
        qd = _six((a - b) / dt_s for a, b in zip(self.q, before, strict=True))
        self.qdd = _six((a - b) / dt_s for a, b in zip(qd, self.qd, strict=True))
        now = self.tcp
        turn = rotation_between(tcp, now)
        twist = _six(v / dt_s for v in (now[0] - tcp[0], now[1] - tcp[1], now[2] - tcp[2], *turn))
        self.acceleration = _six((a - b) / dt_s for a, b in zip(twist, self.twist, strict=True))
        self.twist, self.qd = twist, qd


class JointMove:
    """movej: all joints start and end together, the one with the longest way at full speed."""

    def __init__(self, start: Vector6, target: Vector6, speed: float, acceleration: float) -> None:
        self._start, self._way = start, _six(b - a for a, b in zip(start, target, strict=True))
        self._travel = _travel(max(abs(w) for w in self._way), speed, acceleration)
        self._elapsed_s = 0.0

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        self._elapsed_s += dt_s
        fraction = self._travel.fraction_at(round(self._elapsed_s * _NS))
        body.bend(_six(a + fraction * w for a, w in zip(self._start, self._way, strict=True)))
        return fraction >= 1.0


class LinearMove:
    """movel: the TCP runs straight and turns about one axis, as the in-process arm does."""

    def __init__(self, start: Frame, target: Frame, speed: float, acceleration: float) -> None:
        self._start, self._target = start, target
        self._turn = rotation_between(start, target)
        self._travel = _travel(distance(to_pose(start), to_pose(target)), speed, acceleration)
        self._elapsed_s = 0.0

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        self._elapsed_s += dt_s
        f = self._travel.fraction_at(round(self._elapsed_s * _NS))
        if f >= 1.0:
            body.follow(self._target)
            return True
        shift = tuple(f * (b - a) for a, b in zip(self._start[:3], self._target[:3], strict=True))
        body.follow(moved(self._start, shift, tuple(f * r for r in self._turn)))
        return False


class JointStop:
    """stopj: every joint brakes along its way; `deceleration` in rad/s^2 for the fastest."""

    def __init__(self, speeds: Vector6, deceleration: float) -> None:
        self._speeds = speeds
        self._left_s = self._brake_s = max(map(abs, speeds)) / max(deceleration, _LEAST)

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        self._left_s -= dt_s
        if self._left_s <= 0.0:
            return True
        k = dt_s * self._left_s / self._brake_s
        body.bend(_six(q + k * v for q, v in zip(body.q, self._speeds, strict=True)))
        return False


class LinearStop:
    """stopl: the TCP brakes along its way; `deceleration` in m/s^2 (rad/s^2 for a pure turn)."""

    def __init__(self, twist: Vector6, deceleration: float) -> None:
        self._twist = twist
        speed = math.hypot(*twist[:3]) or math.hypot(*twist[3:])
        self._left_s = self._brake_s = speed / max(deceleration, _LEAST)

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        self._left_s -= dt_s
        if self._left_s <= 0.0:
            return True
        k = dt_s * self._left_s / self._brake_s
        way = [k * v for v in self._twist]
        body.follow(moved(body.tcp, tuple(way[:3]), tuple(way[3:])))
        return False


class SpeedMove:
    """speedj and speedl: speeds up to a target velocity and keeps it until something else comes."""

    def __init__(self, velocity: Vector6, joint: bool) -> None:
        self._velocity, self.joint = velocity, joint
        self.target, self.acceleration = velocity, 0.5

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        gap = [b - a for a, b in zip(self._velocity, self.target, strict=True)]
        most = max(abs(g) for g in gap)
        share = min(1.0, self.acceleration * dt_s / most) if most > 0.0 else 1.0
        self._velocity = _six(a + share * g for a, g in zip(self._velocity, gap, strict=True))
        way = [v * dt_s for v in self._velocity]
        if self.joint:
            body.bend(_six(q + w for q, w in zip(body.q, way, strict=True)))
        elif any(way):
            body.follow(moved(body.tcp, tuple(way[:3]), tuple(way[3:])))
        return False


class ServoMove:
    """servoj: follows a target that is set anew as often as the client likes."""

    def __init__(self, speeds: Vector6, target: Vector6) -> None:
        self._speeds = list(speeds)
        self.target = target
        self.lookahead_s, self.gain = 0.1, 300.0

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`. A first-order follower whose lag is the look-ahead time."""
        if dt_s <= 0.0:
            return False
        pull = min(self.gain / 300.0 / max(self.lookahead_s, 0.03), 0.5 / dt_s)
        joints = []
        for i, (q, target) in enumerate(zip(body.q, self.target, strict=True)):
            off = target - q
            wanted = min(pull * abs(off), 0.9 * math.sqrt(2 * SERVO_ACCELERATION * abs(off)), MAX_JOINT_SPEED)
            change = math.copysign(wanted, off) - self._speeds[i]
            most = SERVO_ACCELERATION * dt_s
            self._speeds[i] += max(-most, min(most, change))
            joints.append(q + self._speeds[i] * dt_s if abs(off) > 1e-12 else target)
        body.bend(_six(joints))
        return False


def _travel(way: float, speed: float, acceleration: float) -> TrapezoidProfile:
    return TrapezoidProfile(0, way, max(speed, _LEAST), max(acceleration, _LEAST))


def _six(values: Iterable[float]) -> Vector6:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f
