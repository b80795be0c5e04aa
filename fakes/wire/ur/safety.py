"""The safety system and power of the simulated controller: what it allows, and how it is released."""

from dataclasses import dataclass
from enum import IntEnum

from drivers.clock import NS_PER_S, to_ns

POWER_STEP_S = 1.0
"""How long switching on and releasing the brakes take each (a real arm: some seconds)."""


class RobotMode(IntEnum):
    """`robot_mode` of the RTDE guide."""

    POWER_OFF = 3
    POWER_ON = 4
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


@dataclass(slots=True)
class Safety:
    """State machine of stops and power. A protective stop can be released after `release_after_s`."""

    release_after_s: float = 5.0
    mode: SafetyMode = SafetyMode.NORMAL
    robot_mode: RobotMode = RobotMode.RUNNING
    remote_control: bool = True
    _since_ns: int = 0
    _wanted: RobotMode = RobotMode.RUNNING
    _next_ns: int = 0

    @property
    def may_move(self) -> bool:
        """Whether programs and motions may run."""
        return self.mode is SafetyMode.NORMAL and self.robot_mode is RobotMode.RUNNING

    @property
    def bits(self) -> int:
        """`safety_status_bits`."""
        return _BITS[self.mode]

    def protective_stop(self, time_ns: int) -> None:
        """Stop, with the power left on."""
        if self.mode is SafetyMode.NORMAL:
            self.mode, self._since_ns = SafetyMode.PROTECTIVE_STOP, time_ns

    def emergency_stop(self) -> None:
        """The button is pressed: the power goes off."""
        self.mode = SafetyMode.ROBOT_EMERGENCY_STOP
        self.robot_mode = self._wanted = RobotMode.POWER_OFF

    def release_button(self) -> None:
        """The emergency stop button is turned out again; the arm stays without power."""
        if self.mode is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.mode = SafetyMode.NORMAL

    def unlock(self, time_ns: int) -> bool:
        """Release a protective stop; False when it is too early, or there is none."""
        if self.mode is not SafetyMode.PROTECTIVE_STOP:
            return self.mode is SafetyMode.NORMAL
        if time_ns - self._since_ns < self.release_after_s * NS_PER_S:
            return False
        self.mode = SafetyMode.NORMAL
        return True

    def power(self, wanted: RobotMode, time_ns: int) -> bool:
        """Go to a power state step by step; False while an emergency stop is on."""
        if self.mode is SafetyMode.ROBOT_EMERGENCY_STOP and wanted is not RobotMode.POWER_OFF:
            return False
        if wanted is RobotMode.POWER_OFF:
            self.robot_mode = wanted
        self._wanted, self._next_ns = wanted, time_ns + to_ns(POWER_STEP_S)
        return True

    def step(self, time_ns: int) -> None:
        """Take the next step of switching on when its time has come."""
        if self.robot_mode < self._wanted and time_ns >= self._next_ns:
            steps = list(RobotMode)
            self.robot_mode = steps[steps.index(self.robot_mode) + 1]
            self._next_ns = time_ns + to_ns(POWER_STEP_S)
