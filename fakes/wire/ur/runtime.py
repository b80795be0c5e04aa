"""Conditions for motion of the simulated arm: running program and watchdog, safety system, and power."""

import logging
from dataclasses import dataclass
from enum import IntEnum

from drivers.clock import NS_PER_S
from fakes.wire.ur.body import Thread, ended

READING_NS = 1_000
"""Time to read a character of a program (our assumption): the program of ur-rtde takes 0.04 s."""
_log = logging.getLogger(__name__)


class ProgramError(Exception):
    """A run-time error, which ends the program."""


class Runtime:
    """Runs at most one program. last_error: why the last one ended."""

    def __init__(self) -> None:
        self.last_error = ""
        self._program: Thread | None = None
        self._read: tuple[Thread, int] | None = None
        self._written_ns: dict[str, int] = {}
        self._watch: tuple[str, int] | None = None

    @property
    def running(self) -> bool:
        """Whether a program runs."""
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
        self._written_ns[register] = time_ns

    def note_written(self, register: str, time_ns: int) -> None:
        """Record that a client wrote a register."""
        self._written_ns[register] = time_ns

    def stood_still(self, missed_ns: int, time_ns: int) -> None:
        """Do not count a time in which the simulated controller had no core as silence of its client.

        A real controller does not stop with the computer of its client.
        """
        for register, written_ns in self._written_ns.items():
            self._written_ns[register] = max(written_ns, min(written_ns + missed_ns, time_ns))

    def take_over(self, time_ns: int) -> bool:
        """Check the watchdog, start a program that has been read; return whether another one ended."""
        before = self._program
        if self._watch is not None and time_ns - self._written_ns[self._watch[0]] > self._watch[1]:
            self._end("watchdog: no communication")
        if self._read is not None and time_ns >= self._read[1]:
            program, self._read = self._read[0], None
            self._end("replaced")
            self._program = program
        return before is not None and self._program is not before

    def step(self) -> bool:
        """Run one cycle of the program; return whether it ended."""
        if self._program is None:
            return False
        try:
            if not ended(self._program):
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
        """Whether programs and motions may run."""
        return self.mode is SafetyMode.NORMAL and self.robot_mode is RobotMode.RUNNING

    @property
    def bits(self) -> int:
        """`safety_status_bits`."""
        return _BITS[self.mode]

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
