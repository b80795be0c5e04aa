"""Driver of a Universal Robots UR5e over ur-rtde: straight motions, state, stops and recovery from stops.

The client library runs in two separate processes (`drivers.ur5e.link`), because it blocks the interpreter
while it connects, and crashes if its connection is lost. Only `move_linear` moves the arm; `connect` uploads
the control program. If the controller has the same TCP and payload as the bench file, they are set at
`connect`; if they differ, `recover` asks before it overwrites them.
"""

import contextlib
import math
from collections.abc import Callable

from drivers.clock import NS_PER_S, Clock, SystemClock, require_full_speed, slowness_of
from drivers.errors import DeviceError, InputError, NotConnectedError
from drivers.interfaces import Arm
from drivers.motion import check_joints, check_motion, check_way
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector3, Vector6
from drivers.ur5e import setup
from drivers.ur5e.control_process import ControlCommands, Operation
from drivers.ur5e.controller import (
    Dashboard,
    Version,
    probe_controller,
    read_speed_fraction,
    refuse_local_control,
    serial_number,
)
from drivers.ur5e.link import ArmLink
from drivers.ur5e.motion import (
    JOINT_RANGE_RAD,
    ArmMotion,
    arm_mode,
    from_ur,
    is_still,
    program_reason,
    stop_reason,
    to_ur,
)
from drivers.ur5e.setup import Tool, ToolSetting
from drivers.ur5e.shared_state import StateSample

STOP_DECELERATION_M_S2 = 10.0
"""Deceleration of a commanded stop."""
PROBE_S = 1.5
"""Time limit of the first exchange with the controller."""
STOP_LIMIT_S = 0.6
"""Time in which the arm must stand after a stop command, before the next way to stop it is tried."""
USED_TOO_EARLY = "arm: used before connect; connect the bench first"
REMOTE_SINCE: Version = (5, 6, 0, 0)
"""First controller software whose dashboard reports remote control and the serial number."""


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
        self._host, self._limits = host, limits
        tool = Tool(to_ur(flange_T_tcp), payload_kg, payload_cog_m)
        self._joint_limits = joint_limits_rad or JOINT_RANGE_RAD
        self._clock: Clock = clock or SystemClock()
        require_full_speed(self._clock, "arm", host)
        self._host_clock = SystemClock(slowness_of(self._clock))
        self._tool = ToolSetting(tool, self._clock)
        self._rate_hz = frequency_hz
        self._link: ArmLink | None = None
        self._dashboard: Dashboard | None = None
        self._identity: dict[str, str] = {}
        self._reports_remote = True
        self._clock_ahead_ns = self._stops = self._connections = 0
        if not 0.0 <= payload_kg <= limits.max_payload_kg:
            raise InputError(
                f"arm: payload {payload_kg} kg is outside 0 to {limits.max_payload_kg} kg; see the bench file"
            )
        if not all(map(math.isfinite, (*tool.flange_tcp, *payload_cog_m, frequency_hz))):
            raise InputError("arm: TCP, payload and rate have to be numbers; see the bench file")

    @property
    def limits(self) -> ArmLimits:
        return self._limits

    def connect(self) -> None:
        """Connect to the arm without moving it.

        Succeeds in a protective stop, and if the controller has another TCP or payload, so that `recover`
        can follow. Raises `DeviceTimeoutError` if the controller does not answer, `DeviceError` if remote
        control is off, the arm is not powered, or another program is moving it.
        """
        self.disconnect()
        self._clock_ahead_ns = self._clock.now_ns() - self._host_clock.now_ns()
        version = probe_controller(self._host, PROBE_S, self._clock)
        try:
            self._dashboard = Dashboard(self._host, clock=self._clock)
            self._reports_remote = version >= REMOTE_SINCE
            self._require_remote_control()
            serial = serial_number(self._dashboard.ask("get serial number")) if self._reports_remote else ""
            known = {"firmware": ".".join(map(str, version)), "model": "UR5e", "serial": serial}
            self._identity = {what: text for what, text in known.items() if text}
            self._link = ArmLink(self._host, self._rate_hz, version, self._host_clock)
            self._connections += 1
            self._take_over(self._link)
        except DeviceError:
            self._close()
            raise

    def disconnect(self) -> None:
        if self._link is not None:
            if not self._known_to_stand(self._link):
                self.stop()
            with contextlib.suppress(DeviceError):
                self._link.control.ask(ControlCommands.end_program)
        self._close()

    def state(self) -> ArmState:
        """Return the newest state. Raises `DeviceTimeoutError` if stale, `DeviceError` if disconnected."""
        sample = setup.guided_sample(self._require_link())
        return ArmState(
            time_ns=sample.sampled_ns + self._clock_ahead_ns,
            base_T_tcp=from_ur(sample.pose),
            joints_rad=sample.joints_rad,
            wrench=sample.wrench,
            mode=arm_mode(sample),
            speed_fraction=sample.speed_fraction,
        )

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> ArmMotion:  # noqa: N803
        """Start a straight motion and return immediately.

        Raises `OutOfLimitsError` before anything is sent, `ProtectiveStopError` if the arm is stopped,
        `DeviceError` if the control program is not running or the controller rejects the motion.
        """
        link, stops = self._require_link(), self._stops
        check_motion(self._limits, base_T_tcp, speed_m_s, acceleration_m_s2)
        sample = self.moving_sample()
        check_way(self._limits, (from_ur(sample.pose), base_T_tcp))
        self._ready(link)
        pose = to_ur(base_T_tcp)
        joints = link.control.ask(ControlCommands.joints_for, pose, sample.joints_rad)
        if not joints and (reason := setup.ended(link, self._clock)):
            raise reason
        check_joints(joints, self._joint_limits, base_T_tcp)

        def not_stopped() -> None:
            if self._stops != stops:
                raise DeviceError("arm: stopped while a motion was being prepared; it was not sent")

        started, before = link.control.move_linear(pose, speed_m_s, acceleration_m_s2, not_stopped)
        if not started:
            raise setup.refusal(link, "moveL", self._clock)
        return ArmMotion(
            self.moving_sample, self.operation, self.stop, base_T_tcp, before, sample.pose, self._clock,
            lambda: self._stops != stops,
        )  # fmt: skip

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand; it carries the tool and payload of the bench file."""
        self.moving_sample()
        setup.begin_guiding(self._ready(self._require_link()), self._clock)

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands; if it does not stand, stop it."""
        if self._link is not None:
            setup.end_guiding(self._link, self._clock, self.stop)

    def stop(self) -> None:
        """Stop as fast as the arm can. Callable from any thread at any time; raises no error.

        The control program is asked first. If the arm is not seen to stand after that, the program is ended
        over the dashboard, which also stops the arm. Returns when the arm stands, after 1.5 s at the latest.
        """
        self._stops += 1
        link = self._link
        if link is not None and not self._stop_motion(link):
            link.end_control()
            with contextlib.suppress(DeviceError):
                self._require_dashboard().ask("stop")
                setup.wait_for_arm(lambda: self._stands(link), STOP_LIMIT_S, "stop", self._clock)

    def _stop_motion(self, link: ArmLink) -> bool:
        try:
            link.control.ask(ControlCommands.stop_linear, STOP_DECELERATION_M_S2)
            setup.wait_for_arm(lambda: self._stands(link), STOP_LIMIT_S, "stop", self._clock)
        except DeviceError:
            return False
        return True

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
            setup.release(link, self._require_dashboard(), self._clock)
        elif program_reason(sample) is None and link.has_control:
            return self._tool.agree(link, confirm)
        elif stop_reason(sample) is None:
            confirm("The arm's control program was ended. Shall it be started again? Nothing will move.")
        self._take_over(link)
        self._tool.agree(link, confirm)

    def speed_fraction(self) -> float:
        """Return the position of the speed slider on the pendant, 0 to 1; also before `connect`."""
        return read_speed_fraction(self._host, PROBE_S, self._clock)

    def zero_force_sensor(self) -> None:
        """Set the present force as zero. Call it only without contact, and only while the arm stands still.

        Raises `DeviceError` if the arm moves, or still reads more than 3 N afterwards.
        """
        self.moving_sample()
        setup.zero_force_sensor(self._require_link(), self._clock)

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

    def operation(self) -> Operation:
        return self._require_link().control.operation()

    def _ready(self, link: ArmLink) -> ArmLink:
        """Make sure that this driver controls the arm and its tool is set. Raises `DeviceError`."""
        self._require_remote_control()
        if not link.has_control:
            self._take_over(link)
        self._tool.require()
        return link

    def _require_link(self) -> ArmLink:
        if self._link is None:
            raise NotConnectedError(USED_TOO_EARLY)
        return self._link

    def _require_dashboard(self) -> Dashboard:
        if self._dashboard is None:
            raise NotConnectedError(USED_TOO_EARLY)
        return self._dashboard

    def _take_over(self, link: ArmLink) -> None:
        """Start the control program; set the tool, unless a person has to be asked first."""
        if arm_mode(link.sample()) is ArmMode.PROTECTIVE_STOP:
            return
        for tries_left in (1, 0):
            setup.take_over(link, self._require_dashboard(), self._clock)
            try:
                return self._tool.compare(link)
            except DeviceError:  # on a loaded host the watchdog may end the program; nothing moves yet
                if not tries_left or setup.ended(link, self._clock) is None:
                    raise

    def _close(self) -> None:
        link, dashboard, self._link, self._dashboard = self._link, self._dashboard, None, None
        if link is not None:
            link.close()
        if dashboard is not None:
            dashboard.close()

    def _require_remote_control(self) -> None:
        """Raise `DeviceError` in local control: a person at the pendant then has control of the arm."""
        if self._reports_remote:
            refuse_local_control(self._require_dashboard().ask("is in remote control"))

    def _known_to_stand(self, link: ArmLink) -> bool:
        try:
            return is_still(link.sample())
        except DeviceError:
            return False

    def _stands(self, link: ArmLink) -> bool:
        """Whether the arm stands and its stop operation has ended, so that a new motion may start."""
        sample = link.sample()
        if not is_still(sample):
            return False
        return bool(program_reason(sample)) or not link.has_control or not link.control.operation().running
