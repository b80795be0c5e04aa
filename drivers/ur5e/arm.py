"""A Universal Robots UR5e over ur-rtde: straight motions, state, stops and recovery from them.

The client library runs in two processes of its own (`drivers.ur5e.link`), because it blocks the
interpreter while it connects and crashes when its connection is lost. Nothing here moves the arm
but `move_linear`; `connect` uploads the control program. TCP and payload are set there where the
controller has the same; a difference is asked about by `recover` before it is overwritten.
"""

import contextlib
import math
from collections.abc import Callable

from drivers.clock import NS_PER_S, Clock, SystemClock
from drivers.errors import DeviceError, InputError, NotConnectedError
from drivers.interfaces import Arm
from drivers.motion import check_motion, check_way
from drivers.types import ArmLimits, ArmMode, ArmState, Pose, Vector3, Vector6
from drivers.ur5e import setup
from drivers.ur5e.control_commands import ControlCommands, Operation
from drivers.ur5e.dashboard import Dashboard, refuse_local_control, serial_number
from drivers.ur5e.link import ArmLink
from drivers.ur5e.motion import JOINT_RANGE_RAD, ArmMotion, check_joints, from_ur, is_still, to_ur
from drivers.ur5e.probe import Version, probe_controller, read_speed_fraction
from drivers.ur5e.setup import Tool, ToolSetting
from drivers.ur5e.shared_state import StateSample
from drivers.ur5e.status import arm_mode, program_reason, stop_reason

STOP_DECELERATION_M_S2 = 10.0
PROBE_S = 1.5
STOP_LIMIT_S = 0.6
USED_TOO_EARLY = "arm: used before connect; connect the bench first"
REMOTE_SINCE: Version = (5, 6, 0, 0)


class UR5e(Arm):
    """One arm, reached at `host`.

    flange_T_tcp: the tool; payload: mass and centre of gravity of the tool in the flange's frame,
    checked after they are set. joint_limits_rad: lowest and highest joint angles a motion may end
    at. Motions are checked against all limits before anything is sent.
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
        """Raises `InputError` for a payload beyond the limit, or values that are not numbers."""
        self._host, self._limits = host, limits
        tool = Tool(to_ur(flange_T_tcp), payload_kg, payload_cog_m)
        self._joint_limits = joint_limits_rad or JOINT_RANGE_RAD
        self._clock: Clock = clock or SystemClock()
        self._tool = ToolSetting(tool, self._clock)
        self._rate_hz = frequency_hz
        self._link: ArmLink | None = None
        self._dashboard: Dashboard | None = None
        self._identity: dict[str, str] = {}
        self._tells_remote = True
        self._clock_ahead_ns = 0
        self._stops = self._connections = 0
        if not 0.0 <= payload_kg <= limits.max_payload_kg:
            raise InputError(
                f"arm: payload {payload_kg} kg is outside 0 to {limits.max_payload_kg} kg; see the bench file"
            )
        if not all(map(math.isfinite, (*tool.flange_tcp, *payload_cog_m, frequency_hz))):
            raise InputError("arm: TCP, payload and rate have to be numbers; see the bench file")

    @property
    def limits(self) -> ArmLimits:
        """What this arm refuses to exceed."""
        return self._limits

    def connect(self) -> None:
        """Reach the arm without moving it.

        Succeeds in a protective stop, and where the controller has another TCP or payload, so that
        `recover` can follow. Raises `DeviceTimeoutError` when nobody answers, `DeviceError` when remote
        control is off, the arm is not powered, or another program is moving it.
        """
        self.disconnect()
        self._clock_ahead_ns = self._clock.now_ns() - SystemClock().now_ns()
        version = probe_controller(self._host, PROBE_S)
        try:
            self._dashboard = Dashboard(self._host)
            self._identify(self._dashboard, version)
            self._link = ArmLink(self._host, self._rate_hz, version)
            self._connections += 1
            self._take_over(self._link)
        except DeviceError:
            self._let_go()
            raise

    def disconnect(self) -> None:
        """Stop any motion and let go. Safe to call twice."""
        if self._link is not None:
            if not self._known_to_stand(self._link):
                self.stop()
            with contextlib.suppress(DeviceError):
                self._link.control.ask(ControlCommands.end_program)
        self._let_go()

    def state(self) -> ArmState:
        """Newest state. Raises `DeviceTimeoutError` when it is stale, `DeviceError` when the arm is gone."""
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
        """Start a straight motion and return at once.

        Raises `OutOfLimitsError` before anything is sent, `ProtectiveStopError` when stopped,
        `DeviceError` when the control program does not run or the controller refuses.
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
        return ArmMotion(self, base_T_tcp, before, sample.pose, self._clock, lambda: self._stops != stops)

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand: it carries the bench file's tool and payload by itself then."""
        self.moving_sample()
        setup.begin_guiding(self._ready(self._require_link()), self._clock)

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands; where it does not, it is stopped."""
        if self._link is not None:
            setup.end_guiding(self._link, self._clock, self.stop)

    def stop(self) -> None:
        """Stop as fast as the arm can, from any thread, at any time, without an error.

        Through the control program; unless the arm is then seen to stand, the program is ended
        over the dashboard, which stops the arm too. Returns when it stands, after 1.5 s at the latest.
        """
        self._stops += 1
        link = self._link
        if link is not None and not self._stop_motion(link):
            link.end_control()
            self._end_program(link)

    def _stop_motion(self, link: ArmLink) -> bool:
        try:
            link.control.ask(ControlCommands.stop_linear, STOP_DECELERATION_M_S2)
            setup.wait_for_arm(lambda: self._stands(link), STOP_LIMIT_S, "stop", self._clock)
        except DeviceError:
            return False
        return True

    def _end_program(self, link: ArmLink) -> None:
        with contextlib.suppress(DeviceError):
            self._require_dashboard().ask("stop")
            setup.wait_for_arm(lambda: self._stands(link), STOP_LIMIT_S, "stop", self._clock)

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop, start the ended control program again, set the tool; nothing moves.

        confirm: puts a question to a person who has looked at the arm, and raises unless they
        agree. TCP and payload are compared, set and checked anew. The force sensor keeps its zero: the hand
        may hold something. Raises `DeviceError` when the arm cannot be made to run.
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
        """Where the speed slider on the pendant stands, 0 to 1; also before `connect`."""
        return read_speed_fraction(self._host, PROBE_S)

    def zero_force_sensor(self) -> None:
        """Take the present force as zero; only out of contact, and only when the arm stands still.

        Raises `DeviceError` when it moves, or still reads more than 3 N afterwards.
        """
        self.moving_sample()
        setup.zero_force_sensor(self._require_link(), self._clock)

    def identity(self) -> dict[str, str]:
        """Serial number, firmware and model, as far as the controller gave them at `connect`."""
        return dict(self._identity)

    def counters(self) -> dict[str, int]:
        """State samples received and missed since `connect`, and how often it was connected."""
        sample = self._require_link().sample()
        return {"samples": sample.samples, "gaps": sample.gaps, "reconnects": max(0, self._connections - 1)}

    def clock_offset_s(self) -> float:
        """The controller's time minus this computer's monotonic time, s."""
        sample = self._require_link().sample()
        return sample.timestamp_s - sample.sampled_ns / NS_PER_S

    def moving_sample(self) -> StateSample:
        """Newest sample of an arm that can move. Raises what keeps it from moving."""
        sample = self._require_link().sample()
        if reason := program_reason(sample):
            raise reason
        return sample

    def operation(self) -> Operation:
        """The newest operation on the controller."""
        return self._require_link().control.operation()

    def _ready(self, link: ArmLink) -> ArmLink:
        """See that the arm is ours to move, with its tool set. Raises `DeviceError`."""
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
        """Start the control program; set the tool unless somebody has to be asked first."""
        if arm_mode(link.sample()) is ArmMode.PROTECTIVE_STOP:
            return
        for tries_left in (1, 0):
            setup.take_over(link, self._require_dashboard(), self._clock)
            try:
                return self._tool.compare(link)
            except DeviceError:  # on a busy computer the watchdog may end the program; nothing moves yet
                if not tries_left or setup.ended(link, self._clock) is None:
                    raise

    def _let_go(self) -> None:
        link, dashboard, self._link, self._dashboard = self._link, self._dashboard, None, None
        if link is not None:
            link.close()
        if dashboard is not None:
            dashboard.close()

    def _require_remote_control(self) -> None:
        """Whoever switched the pendant to local wants the arm for themselves."""
        if self._tells_remote:
            refuse_local_control(self._require_dashboard().ask("is in remote control"))

    def _identify(self, dashboard: Dashboard, version: Version) -> None:
        self._tells_remote = version >= REMOTE_SINCE
        self._require_remote_control()
        serial = serial_number(dashboard.ask("get serial number")) if self._tells_remote else ""
        known = {"firmware": ".".join(map(str, version)), "model": "UR5e", "serial": serial}
        self._identity = {what: text for what, text in known.items() if text}

    def _known_to_stand(self, link: ArmLink) -> bool:
        try:
            return is_still(link.sample())
        except DeviceError:
            return False

    def _stands(self, link: ArmLink) -> bool:
        """Whether the arm stands and the stop's own operation has ended, so that a motion may follow."""
        sample = link.sample()
        if not is_still(sample):
            return False
        return bool(program_reason(sample)) or not link.has_control or not link.control.operation().running
