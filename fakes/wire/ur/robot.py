"""The state of the simulated controller: arm, safety, program and registers, one control cycle at a time."""

import logging
import math
from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass
from enum import IntEnum

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.types import Vector6
from fakes.wire.ur.rtde import INPUTS, OutputBank, Value, Version, zero
from fakes.world.force_torque import FlangeSensor
from fakes.world.kinematics import (
    ELBOW_UP,
    PHYSICAL_TOOL,
    Encoders,
    Frame,
    compose,
    forward,
    from_pose,
    from_ur,
    inverse,
    move_frame,
    nearest_inverse,
    rotation_between,
    six,
    to_pose,
    to_ur,
    tracked_inverse,
)
from fakes.world.motion import ToolPath, TrapezoidProfile, distance
from fakes.world.world import World

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


class OutOfReachError(Exception):
    """A motion left the reach of the joints; the controller's path check, never the user's input."""


class Body:
    """Position and speed of the arm: joints, `base_T_flange`, and `flange_T_tcp` as it was set.

    Its motions raise `OutOfReachError` for a step that is out of reach or beyond what the joints can do.
    """

    def __init__(self, joints_rad: Vector6, flange_T_tcp: Frame) -> None:  # noqa: N803
        self.q = joints_rad
        self.qd = self.twist = STILL
        self.flange = forward(joints_rad)
        self.tool, self.still_cycles = flange_T_tcp, LONG_STILL_CYCLES
        self.mover: Mover | None = None

    @property
    def tcp(self) -> Frame:
        """`base_T_tcp`."""
        return compose(self.flange, self.tool)

    @property
    def settled(self) -> bool:
        """Whether the arm has been still for long enough to have no speed."""
        return self.still_cycles > 2

    def follow(self, base_T_tcp: Frame) -> None:  # noqa: N803
        """Move the TCP by a small step."""
        flange = compose(base_T_tcp, inverse(self.tool))
        self.bend(tracked_inverse(flange, self.q), flange)

    def bend(self, joints_rad: Vector6 | None, flange: Frame | None = None) -> None:
        """Move the joints by a small step. flange: the pose that they reach, if it is known."""
        if joints_rad is None or not all(
            abs(b - a) <= MAX_STEP_RAD for a, b in zip(self.q, joints_rad, strict=True)
        ):
            raise OutOfReachError
        self.q, self.flange = joints_rad, flange or forward(joints_rad)

    def shift(self, way: Vector6, joint: bool) -> None:
        """Move by a small step of the joints (rad), or of the TCP in base axes (m and rad)."""
        if joint:
            self.bend(six(q + w for q, w in zip(self.q, way, strict=True)))
        else:
            self.follow(move_frame(self.tcp, way[:3], way[3:]))

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
    """A motion with a trapezoidal speed profile from `start` to `target`, frames of the TCP or joint angles.

    movel: the TCP moves straight and turns about one axis, as the in-process arm does. movej (`joint`): all
    joints start and end together; the joint with the longest way reaches the speed, rad/s.
    """

    def __init__(self, start: Frame, target: Frame, speed: float, acceleration: float, joint: bool) -> None:
        self._start, self._target, self.joint, self._elapsed_s = start, target, joint, 0.0
        count = 6 if joint else 3
        self._way = tuple(b - a for a, b in zip(start[:count], target[:count], strict=True))
        self._turn = (0.0, 0.0, 0.0) if joint else rotation_between(start, target)
        length = max(map(abs, self._way)) if joint else distance(to_pose(start), to_pose(target))
        self._travel = TrapezoidProfile(0, length, max(speed, _LEAST), max(acceleration, _LEAST))

    def step(self, body: Body, dt_s: float) -> bool:
        self._elapsed_s += dt_s
        f = self._travel.fraction_at(round(self._elapsed_s * NS_PER_S))
        shift = tuple(f * way for way in self._way)
        if self.joint:
            body.bend(six(a + s for a, s in zip(self._start, shift, strict=True)))
        else:
            turn = tuple(f * angle for angle in self._turn)
            body.follow(self._target if f >= 1.0 else move_frame(self._start, shift, turn))
        return f >= 1.0


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
    """A simulated hand of a person: it pushes along a straight path for a time, also against a locked arm.

    As a motion it is teach_mode: the arm follows the hand, and stands still when the hand does.
    """

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

    def step(self, body: Body, dt_s: float) -> bool:
        way = six(self._share * value for value in self._way)
        if any(way):
            body.shift(way, joint=False)
        return False


Mover = PathMove | SpeedMove | ServoMove | Brake | GuidingHand
"""A motion: `step` advances it by `dt_s` and returns whether it has ended."""


def move_until_done(body: Body, mover: Mover) -> Thread:
    """Run a motion until it has ended or another one has replaced it."""
    body.mover = mover
    while body.mover is mover:
        yield


def run_cycle(thread: Thread) -> bool:
    """Run a thread for one cycle; return whether it has ended."""
    try:
        next(thread)
    except StopIteration:
        return True
    return False


READING_NS = 1_000
"""Time to read a character of a program (our assumption): the program of ur-rtde takes 0.04 s."""


class ProgramError(Exception):
    """A run-time error, which ends the program."""


class Runtime:
    """Runs at most one program. last_error: why the last one ended."""

    def __init__(self) -> None:
        self.last_error = ""
        self._program: Thread | None = None
        self._read: tuple[Thread, int] | None = None
        self.written_ns: dict[str, int] = {}
        """Time at which each register was last written."""
        self._watch: tuple[str, int] | None = None

    @property
    def running(self) -> bool:
        return self._program is not None

    def load(self, program: Thread, time_ns: int, characters: int) -> None:
        """Start to read a program of `characters` characters; once read, it replaces the running one."""
        self._read = program, time_ns + characters * READING_NS

    def clear(self, reason: str) -> None:
        """End the running program and discard the one that is being read."""
        self._read = None
        self._end(reason)

    def watch(self, register: str, least_hz: float, time_ns: int) -> None:
        """End the program if a register is written less often than `least_hz` (rtde_set_watchdog)."""
        self._watch = (register, round(NS_PER_S / least_hz)) if least_hz > 0.0 else None
        self.written_ns[register] = time_ns

    def stood_still(self, missed_ns: int, time_ns: int) -> None:
        """Do not count a time in which the simulated controller had no core as silence of its client.

        A real controller does not stop with the computer of its client.
        """
        for register, written_ns in self.written_ns.items():
            self.written_ns[register] = max(written_ns, min(written_ns + missed_ns, time_ns))

    def take_over(self, time_ns: int) -> bool:
        """Check the watchdog, start a program that has been read; return whether another one ended."""
        before = self._program
        if self._watch is not None and time_ns - self.written_ns[self._watch[0]] > self._watch[1]:
            self._end("watchdog: no communication")
        if self._read is not None and time_ns >= self._read[1]:
            program, self._read = self._read[0], None
            self._end("replaced")
            self._program = program
        return before is not None and self._program is not before

    def step(self) -> bool:
        """Run one cycle of the program; return whether it ended."""
        try:
            if self._program is None or not run_cycle(self._program):
                return False
            self._end("ended")
        except (ProgramError, ValueError, ArithmeticError) as error:
            _log.warning("simulated controller: its program ends: %s", error)
            self._end(str(error))
        return True

    def _end(self, reason: str) -> None:
        if self._program is not None:
            self._program, self._watch, self.last_error = None, None, reason


class RobotMode(IntEnum):
    """`robot_mode` of the RTDE guide."""

    POWER_OFF = 3
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """`safety_mode` of the RTDE guide."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
}
"""`safety_status_bits`."""


@dataclass(slots=True)
class Safety:
    """Stops and power. A protective stop can be released after `release_after_s`."""

    release_after_s: float
    mode: SafetyMode = SafetyMode.NORMAL
    robot_mode: RobotMode = RobotMode.RUNNING
    remote_control: bool = True
    _since_ns: int = 0

    @property
    def may_move(self) -> bool:
        return self.mode is SafetyMode.NORMAL and self.robot_mode is RobotMode.RUNNING

    def protective_stop(self, time_ns: int) -> None:
        """Stop the arm and leave the power on."""
        if self.mode is SafetyMode.NORMAL:
            self.mode, self._since_ns = SafetyMode.PROTECTIVE_STOP, time_ns

    def emergency_stop(self) -> None:
        """Press the emergency stop button: the power goes off."""
        self.mode, self.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF

    def release_button(self) -> None:
        """Turn the emergency stop button out again; the arm stays without power."""
        if self.mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.mode = SafetyMode.NORMAL

    def unlock(self, time_ns: int) -> bool:
        """Release a protective stop; return False if it is too early."""
        if self.mode is not SafetyMode.PROTECTIVE_STOP:
            return self.mode is SafetyMode.NORMAL
        if time_ns - self._since_ns < self.release_after_s * NS_PER_S:
            return False
        self.mode = SafetyMode.NORMAL
        return True

    def power(self, mode: RobotMode) -> bool:
        """Switch on or release the brakes, at once; return False during an emergency stop."""
        if self.mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            return False
        self.robot_mode = max(self.robot_mode, mode)
        return True


CYCLE_NS = 2_000_000
CYCLE_S = CYCLE_NS / NS_PER_S
JOINT_LIMIT_RAD = 2 * math.pi
SAFETY_BRAKE, PROGRAM_BRAKE = 20.0, 10.0
"""Deceleration at a safety stop, and when a program ends during a motion, rad/s^2."""
STEADY_CYCLES = 250
"""An arm counts as steady after half a second at rest."""
STOPPED, PLAYING = 1, 2
FARTHEST_TCP_M = 10.0
INSTALLED_KG, INSTALLED_COG_M = 2.5, (0.0, 0.0, 0.08)
"""Payload in the controller's installation: that of the hand."""
_LOAD_EVERY = 4
"""The load changes slowly: it is computed every fourth cycle."""
_log = logging.getLogger(__name__)


class Robot:
    """Everything behind the sockets.

    It moves the world's tool. The TCP that a client sets changes poses, not the hand, which stays
    `PHYSICAL_TOOL`: the TCP with which the controller starts.
    """

    def __init__(self, world: World, version: Version, release_after_s: float = 5.0) -> None:
        home = compose(from_pose(world.layout.home), inverse(PHYSICAL_TOOL))
        joints = nearest_inverse(home, ELBOW_UP)
        if joints is None:
            raise InputError(f"bench layout: the arm cannot reach its home {world.layout.home}")
        self.version = version
        self.body = Body(joints, PHYSICAL_TOOL)
        self.safety = Safety(release_after_s)
        self.bank = OutputBank()
        self.inputs: dict[str, Value] = {name: zero(kind) for name, kind in INPUTS.items()}
        self.commands: Counter[int] = Counter()
        """How often each command of ur-rtde was executed."""
        self.time_ns = self.heard_ns = 0
        """Time of the newest cycle, and of the newest client data, which is later if cycles are late."""
        self.force = FlangeSensor(world, _LOAD_EVERY)
        self.hand = GuidingHand()
        self._world, self._encoders = world, Encoders(world.seed)
        self._ignored: set[str] = set()
        self._wrench: Vector6 = STILL
        self.runtime = Runtime()
        self._set_slider(1.0)
        self.load(INSTALLED_KG, *INSTALLED_COG_M)
        self._publish_pose()
        self._publish()

    # Functions of the control program

    def solution(self, base_T_tcp: Frame, near: Vector6 | None = None) -> Vector6 | None:  # noqa: N803
        """Return the inverse kinematics within the joints' range, None for a pose out of reach."""
        joints = nearest_inverse(compose(base_T_tcp, inverse(self.body.tool)), near or self.body.q)
        return joints if joints is not None and _in_range(joints) else None

    def solve(self, base_T_tcp: Frame, near: Vector6 | None = None) -> Vector6:  # noqa: N803
        """Return the inverse kinematics. Raises `ProgramError` for a pose out of reach."""
        joints = self.solution(base_T_tcp, near)
        if joints is None:
            raise ProgramError("no inverse kinematics solution")
        return joints

    def in_range(self, joints_rad: Vector6) -> Vector6:
        """Return joint angles. Raises `ProgramError` if one is beyond the joints' range."""
        if not _in_range(joints_rad):
            raise ProgramError(f"joints {joints_rad} rad: the range is +-{JOINT_LIMIT_RAD:.2f} rad")
        return joints_rad

    def move(self, kind: str, pose: str, target: Vector6, speed: float, acceleration: float) -> PathMove:
        """Return a motion from here. kind: "j" for movej, "l" for movel. Raises `ProgramError`.

        pose: "p" if the target is a pose in the controller's notation, "" if it is joint angles in rad.
        """
        if kind == "j":
            joints = self.solve(from_ur(target)) if pose else self.in_range(target)
            return PathMove(self.body.q, joints, speed, acceleration, joint=True)
        end = from_ur(target) if pose else compose(forward(target), self.body.tool)
        self.solve(end)
        return PathMove(self.body.tcp, end, speed, acceleration, joint=False)

    def zero_force_sensor(self) -> None:
        self.force.zero(self._wrench)

    def load(self, mass_kg: float, *cog_m: float) -> None:
        """Set the payload and, unless it is zero, its centre of gravity x, y, z."""
        self.bank.set("payload", mass_kg)
        if any(cog_m):
            self.bank.set("payload_cog", cog_m)

    def set_tool(self, flange_T_tcp: Frame) -> None:  # noqa: N803
        """Set the TCP. Raises `ProgramError` if it is further away than any tool."""
        if not all(abs(v) <= FARTHEST_TCP_M for v in flange_T_tcp[:3]):
            raise ProgramError(f"TCP at {flange_T_tcp[:3]} m")
        self.body.tool = flange_T_tcp
        self._publish_pose()

    # Events

    def write_inputs(self, values: dict[str, Value]) -> None:
        self.inputs.update(values)
        for name, value in values.items():
            self.runtime.written_ns[name] = max(self.time_ns, self.heard_ns)
            if "_register" in name:
                self.bank.set(name, value)
            elif value and not name.startswith("speed_slider") and name not in self._ignored:
                self._ignored.add(name)
                _log.warning("simulated controller: input '%s' is not simulated and has no effect", name)
        if values.get("speed_slider_mask"):
            self._set_slider(float(self.inputs["speed_slider_fraction"]))  # type: ignore[arg-type]

    def run(self, program: Thread, characters: int = 0) -> bool:
        """Replace the running program; return False if no program may run.

        The new program starts in the cycle after its text of `characters` characters has been read. Until
        then the other one continues.
        """
        if self.safety.may_move:
            self.runtime.load(program, self.time_ns, characters)
        return self.safety.may_move

    def end_program(self, reason: str) -> None:
        """End the program, also one that is still being read. The arm brakes."""
        self.runtime.clear(reason)
        self._brake(PROGRAM_BRAKE)

    @property
    def speed_scale(self) -> float:
        """Fraction of its speed at which a motion runs: that of the slider while a program runs."""
        return self._slider if self.runtime.running else 1.0

    def cycle(self, time_ns: int) -> None:
        """Run one control cycle at its nominal time."""
        before, before_ns = self.body.flange, self.time_ns
        self.time_ns = time_ns
        self.hand.pass_time(CYCLE_S)
        if not self.safety.may_move:
            self._brake(SAFETY_BRAKE)
            self.runtime.clear("safety stop")
        if self.runtime.take_over(time_ns):
            self._brake(PROGRAM_BRAKE)
        if self.runtime.step():
            self._brake(PROGRAM_BRAKE)
        if self._move_body():
            start, end = compose(before, PHYSICAL_TOOL), compose(self.body.flange, PHYSICAL_TOOL)
            travel = TrapezoidProfile(before_ns, 1.0, NS_PER_S / max(self.time_ns - before_ns, 1), 1e9)
            tilts = math.atan2(start[9], start[3]), math.atan2(end[9], end[3])
            self._world.tool = ToolPath(to_pose(start), to_pose(end), travel, tilts)
            self._publish_pose()
        self._publish()

    def _set_slider(self, fraction: float) -> None:
        self._slider = max(0.0, min(1.0, fraction))
        self.bank.set("target_speed_fraction", self._slider)

    def _brake(self, deceleration: float) -> None:
        mover = self.body.mover
        if mover is not None and not (isinstance(mover, Brake) and mover.joint):
            self.body.mover = Brake(self.body.qd, deceleration, joint=True)

    def _move_body(self) -> bool:
        was_moving = not self.body.settled
        try:
            return self.body.step(CYCLE_S, self.speed_scale) or was_moving
        except (OutOfReachError, ArithmeticError, ValueError):  # the motion is beyond the arm
            self.safety.protective_stop(self.time_ns)
            self.body.mover = None
            return True

    def _publish_pose(self) -> None:
        body, put = self.body, self.bank.set
        put("target_q", body.q)
        put("target_TCP_pose", to_ur(body.tcp))
        for kind in ("actual", "target"):
            put(f"{kind}_qd", body.qd)
            put(f"{kind}_TCP_speed", body.twist)

    def _publish(self) -> None:
        put = self.bank.set
        joints = self._encoders.measure(self.body.q, self.time_ns)
        put("actual_q", joints)
        put("actual_TCP_pose", to_ur(compose(forward(joints), self.body.tool)))
        self._wrench = self.force.sense(self.time_ns, self.body.tcp[2])
        put("timestamp", self.time_ns / NS_PER_S)
        put("actual_TCP_force", self._wrench)
        put("tcp_force_scalar", math.hypot(*self._wrench[:3]))
        put("robot_mode", int(self.safety.robot_mode))
        for name in ("safety_mode", "safety_status"):
            put(name, int(self.safety.mode))
        put("safety_status_bits", _BITS[self.safety.mode])
        put("robot_status_bits", (self.safety.robot_mode >= RobotMode.IDLE) | self.runtime.running << 1)
        put("speed_scaling", self.speed_scale)
        put("runtime_state", PLAYING if self.runtime.running else STOPPED)


def _in_range(joints_rad: Vector6) -> bool:
    return all(abs(q) <= JOINT_LIMIT_RAD for q in joints_rad)
