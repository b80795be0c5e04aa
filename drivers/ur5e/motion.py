"""A motion of the arm, followed by operation number and state stream; the controller's status as errors.

The controller writes a pose as x y z in m and a rotation vector in rad; `to_ur` and `from_ur` convert.
Status values and bits: Universal Robots, "RTDE Guide", robot_mode, runtime_state, safety_status_bits.
"""

import math
from collections.abc import Callable

from scipy.spatial.transform import Rotation

from drivers.clock import Clock, to_ns
from drivers.errors import DeviceError, ProtectiveStopError
from drivers.motion import PolledMotion
from drivers.types import ArmMode, Pose, Vector6
from drivers.ur5e.control_process import Operation
from drivers.ur5e.shared_state import StateSample

PLAYING = 2
"""Runtime state of a running program (RTDE guide)."""
RUNNING_MODE = 7
"""Robot mode of an arm that is powered on with its brakes released (RTDE guide)."""
NORMAL, REDUCED, PROTECTIVE, RECOVERY, SAFEGUARD = (1 << bit for bit in range(5))
EMERGENCY = 1 << 5 | 1 << 6 | 1 << 7
VIOLATION, FAULT, STOPPED_FOR_SAFETY = 1 << 8, 1 << 9, 1 << 10
_ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes on",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}
_RUNTIME = {0: "stopping", 1: "stopped", 2: "playing", 3: "pausing", 4: "paused", 5: "resuming"}
_SAFETY = (
    (VIOLATION, "safety violation", "see the pendant"),
    (FAULT, "safety fault", "see the pendant; restart the safety system there"),
    (RECOVERY, "recovery mode", "move the arm back into its limits on the pendant"),
    (SAFEGUARD, "safeguard stop", "close the safeguard and reset it"),
    (STOPPED_FOR_SAFETY, "stopped for safety", "see the pendant"),
)


def arm_mode(sample: StateSample) -> ArmMode:
    """Return the safety state; if several bits are set, the most serious one."""
    if sample.safety_bits & EMERGENCY:
        return ArmMode.EMERGENCY_STOP
    if sample.safety_bits & PROTECTIVE:
        return ArmMode.PROTECTIVE_STOP
    if not sample.safety_bits & (NORMAL | REDUCED) or sample.robot_mode != RUNNING_MODE:
        return ArmMode.UNKNOWN
    return ArmMode.RUNNING


def stop_reason(sample: StateSample) -> DeviceError | None:
    """Return why the arm cannot move, as an error to raise; None if it can."""
    bits = sample.safety_bits
    if bits & EMERGENCY:
        return DeviceError(
            f"arm: emergency stop (safety bits {bits:#x}); clear the danger, turn the button out, "
            "switch the arm on and release its brakes on the pendant, then connect again"
        )
    if bits & PROTECTIVE:
        return ProtectiveStopError(
            f"arm: protective stop (safety bits {bits:#x}); inspect the arm, clear the cause, release it"
        )
    for bit, what, remedy in _SAFETY:
        if bits & bit:
            return DeviceError(f"arm: {what} (safety bits {bits:#x}); {remedy}")
    if sample.robot_mode != RUNNING_MODE:
        mode = _ROBOT_MODES.get(sample.robot_mode, f"mode {sample.robot_mode}")
        return DeviceError(
            f"arm: {mode}; switch it on and release its brakes on the pendant, then connect again"
        )
    if not bits & (NORMAL | REDUCED):
        return DeviceError(
            f"arm: its safety system is in neither normal nor reduced mode (bits {bits:#x}); see the pendant"
        )
    return None


def program_reason(sample: StateSample) -> DeviceError | None:
    """Return why commands are not executed: a `stop_reason`, or the control program does not run."""
    reason = stop_reason(sample)
    if reason is None and sample.runtime_state != PLAYING:
        state = _RUNTIME.get(sample.runtime_state, f"state {sample.runtime_state}")
        reason = DeviceError(
            f"arm: its control program is {state}; it was ended on the pendant, by an error shown there, "
            "or because the connection was too slow. Inspect the arm, then start again"
        )
    return reason


def refused(command: str) -> DeviceError:
    """Return the error for a command that the controller rejected although its program runs."""
    return DeviceError(f"arm: '{command}' was rejected although the program runs; see the log on the pendant")


_TURN = 2 * math.pi
JOINT_RANGE_RAD: tuple[Vector6, Vector6] = (
    (-_TURN, -_TURN, -_TURN, -_TURN, -_TURN, -_TURN),
    (_TURN, _TURN, _TURN, _TURN, _TURN, _TURN),
)
"""Working range of a UR5e's joints: +-360 degrees (data sheet)."""
BEGIN_LIMIT_S = 0.5
"""A motion that was accepted begins within this time, or never."""
ASK_S = 0.05
"""Interval at which the controller is asked about a motion while the state stream shows it moving."""
SETTLE_LIMIT_S = 0.3
"""Longest time from the end of the operation until the state stream shows the arm at rest."""
STILL_M_S, STILL_RAD_S = 0.002, 0.01
"""Speeds of the TCP below which the arm counts as standing."""
NEAR_M, NEAR_RAD = 0.001, 0.01
"""Largest distances from the target at which the arm counts as arrived."""


def to_ur(pose: Pose) -> Vector6:
    """Convert a pose to the controller's notation: x y z in m, rotation vector in rad."""
    x, y, z = pose.position_m
    rx, ry, rz = (float(v) for v in pose.rotation.as_rotvec())
    return x, y, z, rx, ry, rz


def from_ur(values: Vector6) -> Pose:
    return Pose.from_rotation((values[0], values[1], values[2]), Rotation.from_rotvec(values[3:]))


class ArmMotion(PolledMotion):
    """A straight motion to `target`. stopped: returns whether the arm was stopped since the motion began."""

    def __init__(
        self,
        sample: Callable[[], StateSample],
        operation: Callable[[], Operation],
        stop: Callable[[], None],
        target: Pose,
        before: int,
        start: Vector6,
        clock: Clock,
        stopped: Callable[[], bool],
    ) -> None:
        super().__init__("arm", clock, self._has_ended, stop)
        self._sample, self._operation = sample, operation
        self._target, self._before = target, before
        self._stopped = stopped
        self._began_ns = clock.now_ns()
        self._ended_ns: int | None = None
        self._asked_ns = self._began_ns
        self._way_m = max(_distance(start, target), 1e-9)
        self._done = False

    def progress(self) -> float:
        """Return the fraction of the path that is covered, 0 to 1."""
        if self._done:
            return 1.0
        left = _distance(self._sample().pose, self._target)
        return min(1.0, max(0.0, 1.0 - left / self._way_m))

    def _has_ended(self) -> bool:
        """Whether the arm has arrived, or stands still after a stop. Raises if the motion failed."""
        if not self._done:
            sample = self._sample()
            if self._over(sample):
                self._done = self._arrived(sample)
        return self._done

    def _over(self, sample: StateSample) -> bool:
        """Whether the controller has finished the operation."""
        if self._ended_ns is None:
            if self._on_its_way(sample):
                return False
            number, running, halted = self._operation()
            if halted:
                raise DeviceError(f"arm: stopped on its way: {halted}")
            if number == self._before:
                return self._never_began(sample)
            if running:
                return False
            self._ended_ns = self._clock.now_ns()
        return True

    def _on_its_way(self, sample: StateSample) -> bool:
        """Whether the state stream alone shows that the motion continues; asking costs a round trip."""
        now = self._clock.now_ns()
        if not is_still(sample) and now - self._asked_ns < to_ns(ASK_S):
            return True
        self._asked_ns = now
        return False

    def _never_began(self, sample: StateSample) -> bool:
        if self._clock.now_ns() - self._began_ns < to_ns(BEGIN_LIMIT_S):
            return False
        if not self._stopped() and not is_at(sample.pose, self._target):
            raise DeviceError(
                "arm: the controller accepted a motion and did not begin it; see the log on the pendant"
            )
        self._ended_ns = self._clock.now_ns()
        return True

    def _arrived(self, sample: StateSample) -> bool:
        """Whether the state stream also shows the end; it may be one cycle late."""
        settling = self._clock.now_ns() - (self._ended_ns or 0) < to_ns(SETTLE_LIMIT_S)
        there = self._stopped() or is_at(sample.pose, self._target)
        if is_still(sample) and there:
            return True
        if settling:
            return False
        if there:
            return True
        off_mm = 1000 * _distance(sample.pose, self._target)
        raise DeviceError(
            f"arm: the motion ended {off_mm:.1f} mm from its target; see the log on the pendant"
        )


def is_still(sample: StateSample) -> bool:
    return math.hypot(*sample.speed[:3]) < STILL_M_S and math.hypot(*sample.speed[3:]) < STILL_RAD_S


def is_at(pose: Vector6, target: Pose) -> bool:
    """Whether a pose of the controller is within NEAR_M and NEAR_RAD of the target."""
    turn = (Rotation.from_rotvec(pose[3:]).inv() * target.rotation).magnitude()
    return _distance(pose, target) < NEAR_M and turn < NEAR_RAD


def _distance(pose: Vector6, target: Pose) -> float:
    return math.dist(pose[:3], target.position_m)
