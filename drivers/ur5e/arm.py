"""Driver of a Universal Robots UR5e over ur-rtde: straight motions, state, stops and recovery from stops.

The client library runs in two separate processes (`drivers.ur5e.link`), because it blocks the interpreter
while it connects, and crashes if its connection is lost. Only `move_linear` moves the arm; `connect` uploads
the control program. If the controller has the same TCP and payload as the bench file, they are set at
`connect`; if they differ, `recover` asks before it overwrites them.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from drivers.clock import NS_PER_S, Clock, SystemClock, require_full_speed, slowness_of, to_ns, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError
from drivers.interfaces import Arm
from drivers.motion import Motion, check_joints, check_motion
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector3, Vector6
from drivers.ur5e.controller import RELEASED, Dashboard, Version, probe_controller, read_speed_fraction
from drivers.ur5e.heartbeat import BRAKE_M_S2
from drivers.ur5e.link import ArmLink
from drivers.ur5e.processes import ControlCommands
from drivers.ur5e.shared_state import StateSample
from drivers.ur5e.status import (
    JOINT_RANGE_RAD,
    PLAYING,
    arm_mode,
    from_ur,
    is_still,
    program_reason,
    stop_reason,
    to_ur,
)

PROBE_S = 1.5
"""Time limit of the first exchange with the controller."""
STOP_LIMIT_S, STAND_LIMIT_S = 0.6, 1.0
"""Time in which the arm must stand after a stop command, before the next way to stop it is tried, and after
guiding by hand."""
RELEASE_LIMIT_S, RELEASE_PAUSE_S = 8.0, 0.5
"""Time limit for releasing a protective stop, possible 5 s after it began (dashboard manual); pause between
attempts."""
NORMAL_LIMIT_S, END_LIMIT_S, PAYLOAD_LIMIT_S = 3.0, 1.0, 0.5
"""Time limits for leaving a released stop, ending a program on the controller, and taking over a payload."""
ZERO_LIMIT_S, ZEROED_N = 0.4, 3.0
"""Time limit for zeroing the force sensor, and the largest force that then counts as zero."""
REASON_LIMIT_S = 0.1
"""Longest delay between the answer to a command and the state sample that contains the reason."""
_POLL_S = 0.004
"""Interval at which the arm's state is polled."""
SAME_TCP, SAME_KG, SAME_COG_M = 1e-4, 1e-3, 1e-3
"""Tolerances for equal settings: TCP in m and rad, mass in kg, centre of gravity in m."""
REMOTE_SINCE: Version = (5, 6, 0, 0)
"""First controller software whose dashboard reports remote control and the serial number."""
BEGIN_LIMIT_S = 0.5
"""A motion that was accepted begins within this time, or never."""
ASK_S = 0.05
"""Interval at which the controller is asked about a motion while the state stream shows it moving."""
SETTLE_LIMIT_S = 0.3
"""Longest time from the end of the operation until the state stream shows the arm at rest."""
NEAR_M, NEAR_RAD = 0.001, 0.01
"""Largest distances from the target at which the arm counts as arrived."""


class UR5e(Arm):
    """One arm with the controller at `host`.

    flange_T_tcp: pose of the TCP in the flange frame. payload_kg, payload_cog_m: mass and centre of gravity
    of the tool, in the flange frame; both are read back after they are set. joint_limits_rad: lowest and
    highest joint angles at the end of a motion. Motions are checked against all limits before they are sent.
    """

    def __init__(
        self,
        host: str,
        limits: ArmLimits,
        flange_T_tcp: Pose,  # noqa: N803
        payload_kg: float,
        payload_cog_m: Vector3,
        joint_limits_rad: tuple[Vector6, Vector6] | None = None,
        clock: Clock | None = None,
        frequency_hz: float = 500.0,
    ) -> None:
        """Raises `InputError` for a payload beyond the limit, NaN, and a slowed clock for a real arm."""
        self._host, self.limits, self._rate_hz = host, limits, frequency_hz
        self._joint_limits = joint_limits_rad or JOINT_RANGE_RAD
        self.clock: Clock = clock or SystemClock()
        require_full_speed(self.clock, "arm", host)
        self._host_clock = SystemClock(slowness_of(self.clock))
        self._tool = ToolSetting(to_ur(flange_T_tcp), payload_kg, payload_cog_m)
        self._link: ArmLink | None = None
        self._identity: dict[str, str] = {}
        self._reports_remote = True
        self.stops = 0
        """Number of stops that were commanded."""
        self._clock_ahead_ns = self._connections = 0
        if not 0.0 <= payload_kg <= limits.max_payload_kg:
            raise InputError(
                f"arm: payload {payload_kg} kg is outside 0 to {limits.max_payload_kg} kg; see the bench file"
            )
        if not all(map(math.isfinite, (*self._tool.flange_tcp, *payload_cog_m, frequency_hz))):
            raise InputError("arm: TCP, payload and rate have to be numbers; see the bench file")

    def connect(self) -> None:
        """Connect to the arm without moving it.

        Succeeds in a protective stop, and if the controller has another TCP or payload, so that `recover`
        can follow. Raises `DeviceTimeoutError` if the controller does not answer, `DeviceError` if remote
        control is off, the arm is not powered, or another program is moving it.
        """
        self.disconnect()
        self._clock_ahead_ns = self.clock.now_ns() - self._host_clock.now_ns()
        version = probe_controller(self._host, PROBE_S, self.clock)
        dashboard = Dashboard(self._host, clock=self.clock)
        try:
            self._reports_remote = version >= REMOTE_SINCE
            self._require_remote_control(dashboard)
            self._identity = {"firmware": ".".join(map(str, version)), "model": "UR5e"}
            if self._reports_remote and (serial := dashboard.ask("get serial number")).isdecimal():
                self._identity["serial"] = serial
            self._link = ArmLink(self._host, self._rate_hz, version, dashboard, self._host_clock)
            self._connections += 1
            self._take_over(self._link)
        except DeviceError:
            dashboard.close()
            self._close()
            raise

    def disconnect(self) -> None:
        if self._link is not None:
            known_to_stand = False
            with contextlib.suppress(DeviceError):
                known_to_stand = is_still(self._link.sample())
            if not known_to_stand:
                self.stop()
            with contextlib.suppress(DeviceError):
                self._link.control.ask(ControlCommands.end_program)
        self._close()

    def state(self) -> ArmState:
        """Return the newest state. Raises `DeviceTimeoutError` if stale, `DeviceError` if disconnected.

        Raises `DeviceError` also if guiding by hand was ended by the heartbeat: a program that had been
        suspended would otherwise wait for a person who can no longer lead the arm.
        """
        link = self._require_link()
        sample = link.sample()
        if link.state.guiding_lost():
            raise DeviceError(
                f"arm: guiding by hand had ended: {link.control.ask(ControlCommands.halt_reason)}"
            )
        return ArmState(
            time_ns=sample.sampled_ns + self._clock_ahead_ns,
            base_T_tcp=from_ur(sample.pose),
            joints_rad=sample.joints_rad,
            wrench=sample.wrench,
            mode=arm_mode(sample),
            speed_fraction=sample.speed_fraction,
        )

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> "ArmMotion":  # noqa: N803
        """Start a straight motion and return immediately.

        Raises `OutOfLimitsError` before anything is sent, `ProtectiveStopError` if the arm is stopped,
        `DeviceError` if the control program is not running or the controller rejects the motion.
        """
        link, stops = self._require_link(), self.stops
        sample = self.moving_sample()
        start = from_ur(sample.pose)
        check_motion(self.limits, start, base_T_tcp, speed_m_s, acceleration_m_s2)
        self._ready(link)
        pose = to_ur(base_T_tcp)
        joints = link.control.ask(ControlCommands.joints_for, pose, sample.joints_rad)
        if not joints and (reason := self._program_error(link)):
            raise reason
        check_joints(joints, self._joint_limits, base_T_tcp)

        def not_stopped() -> None:
            if self.stops != stops:
                raise DeviceError("arm: stopped while a motion was being prepared; it was not sent")

        command = ControlCommands.move_linear
        started, before = link.control.ask(command, pose, speed_m_s, acceleration_m_s2, check=not_stopped)
        if not started:
            raise self._refusal(link, "moveL")
        return ArmMotion(self, base_T_tcp, before, start, stops)

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand; it carries the tool and payload of the bench file."""
        self.moving_sample()
        link = self._require_link()
        self._ready(link)
        if not link.control.ask(ControlCommands.begin_guiding):
            raise self._refusal(link, "teachMode")

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands; if it does not stand, stop it.

        Raises `DeviceError` if it does not stand, and, with the reason, if guiding had ended earlier.
        """
        link = self._link
        if link is None:
            return
        try:
            halted = link.control.ask(ControlCommands.halt_reason)
            link.control.ask(ControlCommands.end_guiding)
            self._wait(lambda: is_still(link.sample()), STAND_LIMIT_S, "stand")
        except BaseException:
            self.stop()
            raise
        if halted:
            raise DeviceError(f"arm: guiding by hand had ended: {halted}")

    def stop(self) -> None:
        """Stop as fast as the arm can. Callable from any thread at any time; raises no error.

        The control program is asked first. If the arm is not seen to stand after that, the program is ended
        over the dashboard, which also stops the arm. Returns when the arm stands, after 1.5 s at the latest.
        """
        self.stops += 1
        link = self._link
        if link is None:
            return
        try:
            link.control.ask(ControlCommands.stop_linear, BRAKE_M_S2)
            self._wait(lambda: self._stands(link), STOP_LIMIT_S, "stop")
        except DeviceError:
            link.end_control()
            with contextlib.suppress(DeviceError):
                link.dashboard.ask("stop")
                self._wait(lambda: self._stands(link), STOP_LIMIT_S, "stop")

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop, restart an ended control program, set the tool; nothing moves.

        confirm: asks a question of a person who has inspected the arm, and raises unless they agree. TCP and
        payload are compared, set and read back again. The force sensor keeps its zero, because the hand may
        hold something. Raises `DeviceError` if the arm cannot be set running.
        """
        link = self._require_link()
        sample = link.sample()
        if arm_mode(sample) is ArmMode.PROTECTIVE_STOP:
            confirm("The arm is in protective stop. Is it free to move, and shall the stop be released?")
            link.end_control()
            self._release(link)
        elif program_reason(sample) is None and link.has_control:
            return self._agree_on_tool(link, confirm)
        elif stop_reason(sample) is None:
            confirm("The arm's control program was ended. Shall it be started again? Nothing will move.")
        self._take_over(link)
        self._agree_on_tool(link, confirm)

    def speed_fraction(self) -> float:
        """Return the position of the speed slider on the pendant, 0 to 1; also before `connect`."""
        return read_speed_fraction(self._host, PROBE_S, self.clock)

    def zero_force_sensor(self) -> None:
        """Set the present force as zero. Call it only without contact, and only while the arm stands still.

        Raises `DeviceError` if the arm moves, or still reads more than 3 N afterwards.
        """
        self.moving_sample()
        link = self._require_link()
        if not link.control.ask(ControlCommands.is_steady):
            raise DeviceError("arm: not at rest; zero the force sensor half a second after a motion")
        if not link.control.ask(ControlCommands.zero_force_sensor):
            raise self._refusal(link, "zeroFtSensor")
        answered_ns = self._host_clock.now_ns()

        def is_zeroed() -> bool:
            sample = link.sample()  # a sample from before the answer still shows the old force
            return sample.sampled_ns > answered_ns and math.hypot(*sample.wrench[:3]) < ZEROED_N

        self._wait(is_zeroed, ZERO_LIMIT_S, "zero its force sensor")

    def identity(self) -> dict[str, str]:
        """Return serial number, firmware and model, as far as the controller reported them at `connect`."""
        return dict(self._identity)

    def counters(self) -> dict[str, int]:
        """Return the state samples received and missed since `connect`, and the number of reconnects."""
        sample = self._require_link().sample()
        return {"samples": sample.samples, "gaps": sample.gaps, "reconnects": max(0, self._connections - 1)}

    def clock_offset_s(self) -> float:
        """Return the controller's time minus this computer's monotonic time, s."""
        sample = self._require_link().sample()
        return sample.timestamp_s - sample.sampled_ns / NS_PER_S

    def moving_sample(self) -> StateSample:
        """Return the newest sample of an arm that can move. Raises the reason if the arm cannot move."""
        sample = self._require_link().sample()
        if reason := program_reason(sample):
            raise reason
        return sample

    def operation(self) -> tuple[int, bool, str]:
        """Return `ControlCommands.operation`."""
        return self._require_link().control.ask(ControlCommands.operation)

    def _ready(self, link: ArmLink) -> None:
        """Make sure that this driver controls the arm and its tool is set. Raises `DeviceError`."""
        self._require_remote_control(link.dashboard)
        if not link.has_control:
            self._take_over(link)
        if self._tool.other is not None:
            raise DeviceError(
                f"arm: the controller has {self._tool.other} in the bench file, and overwriting it was not "
                "confirmed; enter the same values in both"
            )

    def _require_link(self) -> ArmLink:
        if self._link is None:
            raise NotConnectedError("arm: used before connect; connect the bench first")
        return self._link

    def _take_over(self, link: ArmLink) -> None:
        """Start the control program; set the tool, unless a person has to be asked first."""
        if arm_mode(link.sample()) is ArmMode.PROTECTIVE_STOP:
            return
        for tries_left in (1, 0):
            self._start_program(link)
            try:
                if self._tool.compare(link):
                    self._set_tool(link)
                return
            except DeviceError:  # on a loaded host the watchdog may end the program; nothing moves yet
                if not tries_left or self._program_error(link) is None:
                    raise

    def _start_program(self, link: ArmLink) -> None:
        """Start the control program and its watchdog; the controller keeps its tool.

        If a program runs while the arm stands still, it is ended first, because the control interface would
        only wait for its end. Raises `DeviceError` if the arm is not ready, or another program moves it.
        """
        sample = link.sample()
        if reason := stop_reason(sample):
            raise reason
        if sample.runtime_state == PLAYING:
            if not is_still(sample):
                raise DeviceError(
                    "arm: a program moves it; end that program on the pendant, then connect again"
                )
            link.dashboard.ask("stop")
            self._wait(lambda: link.sample().runtime_state != PLAYING, END_LIMIT_S, "end its program")
        link.start_control()
        if not link.control.ask(ControlCommands.start_watchdog):
            raise self._refusal(link, "setWatchdog")

    def _release(self, link: ArmLink) -> None:
        """Release a protective stop. The controller rejects an early release, so it is retried for a while.

        Raises `DeviceError` with the controller's answer if the stop cannot be released.
        """
        replies = [""]

        def try_release() -> bool:
            link.dashboard.ask("close safety popup")
            replies.append(link.dashboard.ask("unlock protective stop"))
            return replies[-1] == RELEASED

        try:
            self._wait(try_release, RELEASE_LIMIT_S, "release the stop", RELEASE_PAUSE_S)
        except DeviceTimeoutError as error:
            raise DeviceError(f"arm: the protective stop cannot be released: '{replies[-1]}'") from error
        self._wait(lambda: stop_reason(link.sample()) is None, NORMAL_LIMIT_S, "leave the stop")

    def _agree_on_tool(self, link: ArmLink, confirm: Callable[[str], None]) -> None:
        """Ask before the controller's tool is overwritten; `confirm` raises unless a person agrees."""
        if (other := self._tool.other) is not None:
            confirm(
                f"The arm's controller has {other} in the bench file. Is the bench file right, and "
                "should the rig set it? (To avoid this question, set the same on the pendant.)"
            )
            self._tool.agreed.add(other)
            self._set_tool(link)

    def _set_tool(self, link: ArmLink) -> None:
        """Set TCP and payload, and verify that the controller has them. Raises `DeviceError`."""
        tool = self._tool
        taken, there = link.control.ask(ControlCommands.set_tcp, tool.flange_tcp)
        if not taken:
            raise self._refusal(link, "setTcp")
        if _apart(there, tool.flange_tcp) > SAME_TCP:
            raise DeviceError(f"arm: the controller's TCP is {there} although {tool.flange_tcp} was set")
        if not link.control.ask(ControlCommands.set_payload, tool.payload_kg, tool.payload_cog_m):
            raise self._refusal(link, "setPayload")
        if not math.isnan(link.sample().payload_kg):

            def has_payload() -> bool:
                return abs(link.sample().payload_kg - tool.payload_kg) <= SAME_KG

            self._wait(has_payload, PAYLOAD_LIMIT_S, f"take the payload of {tool.payload_kg} kg")
        tool.other = None

    def _refusal(self, link: ArmLink, command: str) -> DeviceError:
        return self._program_error(link) or DeviceError(
            f"arm: '{command}' was rejected although the program runs; see the log on the pendant"
        )

    def _program_error(self, link: ArmLink) -> DeviceError | None:
        """Return why the control program does not run; None if it keeps running."""
        wait_until(self.clock, lambda: program_reason(link.sample()) is not None, REASON_LIMIT_S, _POLL_S)
        return program_reason(link.sample())

    def _wait(self, met: Callable[[], bool], limit_s: float, what: str, pause_s: float = _POLL_S) -> None:
        """Poll `met` until the arm does `what`. Raises `DeviceTimeoutError` after `limit_s`."""
        if not wait_until(self.clock, met, limit_s, pause_s):
            raise DeviceTimeoutError(f"arm: did not {what} within {limit_s:g} s; see the pendant")

    def _close(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _require_remote_control(self, dashboard: Dashboard) -> None:
        """Raise `DeviceError` in local control: a person at the pendant then has control of the arm."""
        if not self._reports_remote:
            return
        reply = dashboard.ask("is in remote control")
        if "true" not in reply.lower():
            raise DeviceError(
                f"arm: remote control is off (the dashboard answers '{reply}'); "
                "switch the pendant to Remote Control, top right, then connect again"
            )

    def _stands(self, link: ArmLink) -> bool:
        """Whether the arm stands and its stop operation has ended, so that a new motion may start."""
        sample = link.sample()
        if not is_still(sample):
            return False
        if program_reason(sample) or not link.has_control:
            return True
        _, running, _ = link.control.ask(ControlCommands.operation)
        return not running


@dataclass(slots=True)
class ToolSetting:
    """The tool of the bench file, and whether the controller has the same.

    flange_tcp: x y z in m, rotation vector in rad. When a program starts, the controller resets its tool to
    that of its installation, so they are compared each time. other: how the controller's tool differs, None
    if it does not. agreed: differences that a person agreed to overwrite; they are not asked again.
    """

    flange_tcp: Vector6
    payload_kg: float
    payload_cog_m: Vector3
    other: str | None = None
    agreed: set[str] = field(default_factory=set)

    def compare(self, link: ArmLink) -> bool:
        """Whether to set the tool: all values that the controller reports agree, or a person agreed."""
        there, sample = link.control.ask(ControlCommands.tcp), link.sample()
        differs = []
        if _apart(there, self.flange_tcp) > SAME_TCP:
            differs.append(f"TCP {_numbers(there)} instead of {_numbers(self.flange_tcp)} (m, rad)")
        if abs(sample.payload_kg - self.payload_kg) > SAME_KG:  # False for NaN: it is not reported
            differs.append(f"payload {sample.payload_kg:.3f} kg instead of {self.payload_kg:.3f} kg")
        if _apart(sample.payload_cog_m, self.payload_cog_m) > SAME_COG_M:
            there_cog, wanted = _numbers(sample.payload_cog_m), _numbers(self.payload_cog_m)
            differs.append(f"centre of gravity {there_cog} m instead of {wanted} m")
        self.other = ", ".join(differs) or None
        return self.other is None or self.other in self.agreed


def _apart(there: Sequence[float], here: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(there, here, strict=True))


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"


class ArmMotion(Motion):
    """A straight motion, followed by its operation number and the state stream.

    before: number of the operation before it. stops: number of stops of the arm when it was prepared.
    """

    def __init__(self, arm: UR5e, target: Pose, before: int, start: Pose, stops: int) -> None:
        super().__init__("arm", arm.clock, self._has_ended, arm.stop)
        self._arm, self._target, self._before, self._stops = arm, target, before, stops
        self._began_ns = self._asked_ns = arm.clock.now_ns()
        self._ended_ns: int | None = None
        self._way_m = max(start.apart(target)[0], 1e-9)
        self._done = False

    def progress(self) -> float:
        """Return the fraction of the path that is covered, 0 to 1."""
        if self._done:
            return 1.0
        left_m, _ = from_ur(self._arm.moving_sample().pose).apart(self._target)
        return min(1.0, max(0.0, 1.0 - left_m / self._way_m))

    def _has_ended(self) -> bool:
        """Whether the arm has arrived, or stands still after a stop. Raises if the motion failed."""
        if not self._done:
            sample = self._arm.moving_sample()
            self._done = self._over(sample) and self._has_arrived(sample)
        return self._done

    def _over(self, sample: StateSample) -> bool:
        """Whether the controller has finished the operation.

        While the state stream shows that the arm moves, the controller is asked every `ASK_S` only, because
        asking costs a round trip.
        """
        now_ns = self._arm.clock.now_ns()
        if self._ended_ns is not None:
            return True
        if not is_still(sample) and now_ns - self._asked_ns < to_ns(ASK_S):
            return False
        self._asked_ns = now_ns
        number, running, halted = self._arm.operation()
        if halted:
            raise DeviceError(f"arm: stopped on its way: {halted}")
        if number == self._before:
            if now_ns - self._began_ns < to_ns(BEGIN_LIMIT_S):
                return False
            if not self._there(sample):
                raise DeviceError(
                    "arm: the controller accepted a motion and did not begin it; see the log on the pendant"
                )
        elif running:
            return False
        self._ended_ns = self._arm.clock.now_ns()
        return True

    def _there(self, sample: StateSample) -> bool:
        """Whether the arm is at the target, or was stopped since the motion began."""
        there = from_ur(sample.pose).is_near(self._target, NEAR_M, NEAR_RAD)
        return there or self._arm.stops != self._stops

    def _has_arrived(self, sample: StateSample) -> bool:
        """Whether the state stream also shows the end; it may be one cycle late."""
        settling = self._arm.clock.now_ns() - (self._ended_ns or 0) < to_ns(SETTLE_LIMIT_S)
        if self._there(sample):
            return is_still(sample) or not settling
        if settling:
            return False
        off_m, _ = from_ur(sample.pose).apart(self._target)
        raise DeviceError(
            f"arm: the motion ended {1000 * off_m:.1f} mm from its target; see the log on the pendant"
        )
