"""The simulated arm: joints, flange and tool centre point, and the motions of a program or a guiding hand."""

import math
from collections.abc import Callable, Generator
from typing import Protocol

from drivers.types import Vector6
from fakes.world.kinematics import (
    Frame,
    compose,
    forward,
    inverse,
    moved,
    nearest_inverse,
    rotation_between,
    six,
    to_pose,
    tracked_inverse,
)
from fakes.world.motion import TrapezoidProfile, distance

STILL: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
Thread = Generator[None, None, None]
"""A thread of a program: it yields once per control cycle."""
LONG_STILL_CYCLES = 500
MAX_JOINT_SPEED = math.pi
"""180 degrees per second, every joint of a UR5e (data sheet)."""
MAX_STEP_RAD = 4 * MAX_JOINT_SPEED * 0.002
"""A larger step in one cycle stops the arm: it is far beyond what the joints can do."""
SERVO_ACCELERATION = 40.0
"""Highest joint acceleration of servoj, rad/s^2 (our choice; the controller's is not documented)."""
SERVO_GAIN = 300.0
"""Default gain of servoj (script manual)."""
_LEAST = 1e-4
_NS = 1_000_000_000


class OutOfReachError(Exception):
    """A motion left the reach of the joints; the controller's path check, never the user's input."""


class ArmMover(Protocol):
    """A motion of the arm."""

    def step(self, body: "Body", dt_s: float) -> bool:
        """Advance the motion by `dt_s`; return whether it has ended."""
        ...


class Body:
    """Position and speed of the arm: joints, `base_T_flange`, and `flange_T_tcp` as it was set."""

    def __init__(self, joints_rad: Vector6, flange_T_tcp: Frame) -> None:  # noqa: N803
        self.q = joints_rad
        self.qd = self.twist = STILL
        self.flange = forward(joints_rad)
        self.tool, self.still_cycles = flange_T_tcp, LONG_STILL_CYCLES
        self.mover: ArmMover | None = None

    @property
    def tcp(self) -> Frame:
        """`base_T_tcp`."""
        return compose(self.flange, self.tool)

    @property
    def settled(self) -> bool:
        """Whether the arm has been still for long enough to have no speed."""
        return self.still_cycles > 2

    def reach(self, base_T_tcp: Frame, near: Vector6 | None = None) -> Vector6 | None:  # noqa: N803
        """Return the joint angles nearest to `near` (or to now) that reach a pose, None if there are none."""
        return nearest_inverse(compose(base_T_tcp, inverse(self.tool)), near or self.q)

    def follow(self, base_T_tcp: Frame) -> None:  # noqa: N803
        """Move the TCP by a small step. Raises `OutOfReachError`."""
        flange = compose(base_T_tcp, inverse(self.tool))
        joints = tracked_inverse(flange, self.q)
        if joints is None or not self._can_step_to(joints):
            raise OutOfReachError
        self.q, self.flange = joints, flange

    def bend(self, joints_rad: Vector6) -> None:
        """Move the joints by a small step. Raises `OutOfReachError`."""
        if not self._can_step_to(joints_rad):
            raise OutOfReachError
        self.q, self.flange = joints_rad, forward(joints_rad)

    def shift(self, way: Vector6, joint: bool) -> None:
        """Move by a small step of the joints (rad), or of the TCP in base axes (m and rad)."""
        if joint:
            self.bend(six(q + w for q, w in zip(self.q, way, strict=True)))
        else:
            self.follow(moved(self.tcp, way[:3], way[3:]))

    def _can_step_to(self, joints_rad: Vector6) -> bool:
        return all(abs(b - a) <= MAX_STEP_RAD for a, b in zip(self.q, joints_rad, strict=True))

    def step(self, dt_s: float, scale: float) -> bool:
        """Run one control cycle at a speed scale of 0 to 1; return whether the arm moved."""
        before, tcp = self.q, self.tcp
        try:
            if self.mover is not None and self.mover.step(self, dt_s * scale):
                self.mover = None
        finally:
            self.still_cycles = 0 if self.q != before else self.still_cycles + 1
            if not self.settled:
                self.qd = six((a - b) / dt_s for a, b in zip(self.q, before, strict=True))
                now = self.tcp
                turn = rotation_between(tcp, now)
                self.twist = six(v / dt_s for v in (now[0] - tcp[0], now[1] - tcp[1], now[2] - tcp[2], *turn))
        return self.still_cycles == 0


class PathMove:
    """A motion with a trapezoidal speed profile over a distance in m or rad.

    go: moves the body to a fraction of the path, 0 to 1.
    """

    def __init__(
        self, way: float, speed: float, acceleration: float, go: Callable[[Body, float], None]
    ) -> None:
        self._travel = TrapezoidProfile(0, way, max(speed, _LEAST), max(acceleration, _LEAST))
        self._go, self._elapsed_s = go, 0.0

    def step(self, body: Body, dt_s: float) -> bool:
        self._elapsed_s += dt_s
        fraction = self._travel.fraction_at(round(self._elapsed_s * _NS))
        self._go(body, fraction)
        return fraction >= 1.0


def linear_move(start: Frame, target: Frame, speed: float, acceleration: float) -> PathMove:
    """movel: the TCP moves straight and turns about one axis, as the in-process arm does."""
    turn = rotation_between(start, target)

    def go(body: Body, f: float) -> None:
        shift = tuple(f * (b - a) for a, b in zip(start[:3], target[:3], strict=True))
        body.follow(target if f >= 1.0 else moved(start, shift, tuple(f * r for r in turn)))

    return PathMove(distance(to_pose(start), to_pose(target)), speed, acceleration, go)


def joint_move(start: Vector6, target: Vector6, speed: float, acceleration: float) -> PathMove:
    """movej: all joints start and end together; the joint with the longest way reaches the speed, rad/s."""
    way = six(b - a for a, b in zip(start, target, strict=True))

    def go(body: Body, f: float) -> None:
        body.bend(six(a + f * w for a, w in zip(start, way, strict=True)))

    return PathMove(max(map(abs, way)), speed, acceleration, go)


class SpeedMove:
    """speedj and speedl: accelerate to a velocity and keep it until another motion replaces this one.

    velocity: at the start, of the joints (`joint`, rad/s) or of the TCP (m/s and rad/s, base axes).
    """

    def __init__(self, velocity: Vector6, joint: bool) -> None:
        self._velocity, self.joint = velocity, joint
        self.target, self.acceleration = velocity, 0.0

    def step(self, body: Body, dt_s: float) -> bool:
        gaps = [b - a for a, b in zip(self._velocity, self.target, strict=True)]
        share = min(1.0, max(self.acceleration, _LEAST) * dt_s / (max(map(abs, gaps)) or 1.0))
        self._velocity = six(a + share * gap for a, gap in zip(self._velocity, gaps, strict=True))
        way = six(v * dt_s for v in self._velocity)
        if self.joint or any(way):
            body.shift(way, self.joint)
        return False


class ServoMove:
    """servoj: follow target joints that are replaced as often as the client likes, with a first-order lag.

    As in the control program, a new target is read only when the time of the last one has passed.
    """

    def __init__(self, speeds: Vector6) -> None:
        self._speeds = speeds
        self._newest: tuple[Vector6, float, float] | None = None
        self._target: Vector6 | None = None
        self._pull = self._left_s = 0.0

    def aim(self, joints_rad: Vector6, time_s: float, lookahead_s: float, gain: float) -> None:
        """Set the newest target. time_s: how long it is kept. lookahead_s: lag at the default gain."""
        self._newest = joints_rad, time_s, gain / SERVO_GAIN / max(lookahead_s, 0.03)

    def step(self, body: Body, dt_s: float) -> bool:
        self._left_s -= dt_s
        if self._left_s <= 0.0 and self._newest is not None:
            self._target, self._left_s, self._pull = self._newest
        if self._target is None or dt_s <= 0.0:
            return False
        gaps = [b - a for a, b in zip(body.q, self._target, strict=True)]
        self._speeds = six(self._speed(v, gap, dt_s) for v, gap in zip(self._speeds, gaps, strict=True))
        body.shift(six(v * dt_s for v in self._speeds), joint=True)
        return False

    def _speed(self, speed: float, gap: float, dt_s: float) -> float:
        """Return a joint's next speed, from which it can still brake before its target."""
        pull = min(self._pull, 0.5 / dt_s)
        wanted = min(pull * abs(gap), 0.9 * math.sqrt(2.0 * SERVO_ACCELERATION * abs(gap)), MAX_JOINT_SPEED)
        most = SERVO_ACCELERATION * dt_s
        return speed + max(-most, min(most, math.copysign(wanted, gap) - speed))


class Brake:
    """stopj and stopl: brake along the path from a velocity as of `SpeedMove`.

    deceleration: of the fastest joint (`joint`, rad/s^2), or of the TCP in m/s^2 (rad/s^2 for a pure
    rotation).
    """

    def __init__(self, velocity: Vector6, deceleration: float, joint: bool) -> None:
        self._velocity, self.joint = velocity, joint
        speed = max(map(abs, velocity))
        if not joint:
            speed = math.hypot(*velocity[:3]) or math.hypot(*velocity[3:])
        self._left_s = self._brake_s = speed / max(deceleration, _LEAST)

    def step(self, body: Body, dt_s: float) -> bool:
        self._left_s -= dt_s
        if self._left_s <= 0.0:
            return True
        body.shift(six(dt_s * self._left_s / self._brake_s * v for v in self._velocity), self.joint)
        return False


class GuidingHand:
    """A simulated hand of a person: it pushes along a straight path for a time, also against a locked arm."""

    def __init__(self) -> None:
        self._way: Vector6 = STILL
        self._total_s = self._elapsed_s = 1.0
        self._share = 0.0

    def lead(self, way: Vector6, total_s: float) -> None:
        """Start to push. way: the total displacement, x y z in m and rotation vector in rad, base axes."""
        self._way, self._total_s, self._elapsed_s, self._share = way, total_s, 0.0, 0.0

    def pass_time(self, dt_s: float) -> None:
        """Push for one more cycle, slowly at the start and at the end."""
        before, self._elapsed_s = self._elapsed_s, min(self._elapsed_s + dt_s, self._total_s)
        start, end = (0.5 - 0.5 * math.cos(math.pi * t / self._total_s) for t in (before, self._elapsed_s))
        self._share = end - start

    def step(self) -> Vector6:
        return six(self._share * value for value in self._way)


class Guided:
    """teach_mode: the arm follows the hand, and stands still when the hand does."""

    def __init__(self, hand: GuidingHand) -> None:
        self._hand = hand

    def step(self, body: Body, dt_s: float) -> bool:
        way = self._hand.step()
        if any(way):
            body.shift(way, joint=False)
        return False


def move_until_done(body: Body, mover: ArmMover) -> Thread:
    """Run a motion until it has ended or another one has replaced it."""
    body.mover = mover
    while body.mover is mover:
        yield


def ended(thread: Thread) -> bool:
    """Run a thread for one cycle; return whether it has ended."""
    try:
        next(thread)
    except StopIteration:
        return True
    return False
