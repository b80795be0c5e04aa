"""The program that the controller runs, the one that it is still reading, and the watchdog."""

from typing import Protocol

from drivers.clock import NS_PER_S

READING_NS = 1_000
"""How long the controller takes to read a character of a program (ours): ur-rtde's takes 0.04 s."""


class ProgramError(Exception):
    """A run-time error, which ends the program."""


class Program(Protocol):
    """A program, run one control cycle at a time."""

    def step(self) -> bool:
        """Run one cycle; return whether the program goes on. Raises `ProgramError`."""
        ...


class Runtime:
    """Runs at most one program. last_error: why the last one ended."""

    def __init__(self) -> None:
        self.paused = False
        self.last_error = ""
        self._program: Program | None = None
        self._read: tuple[Program, int] | None = None
        self._written_ns: dict[str, int] = {}
        self._watch: tuple[str, int] | None = None

    @property
    def running(self) -> bool:
        """Whether a program runs."""
        return self._program is not None

    def load(self, program: Program, time_ns: int, characters: int = 0) -> None:
        """Start to read a program of `characters` characters; once read, it replaces the running one."""
        self._read = program, time_ns + characters * READING_NS

    def end(self, reason: str) -> None:
        """End the running program."""
        if self._program is not None:
            self._program, self._watch, self.last_error = None, None, reason

    def clear(self, reason: str) -> None:
        """End the running program and discard the one that is being read."""
        self._read = None
        self.end(reason)

    def watch(self, register: str, least_hz: float, time_ns: int) -> None:
        """End the program if a register is written less often than `least_hz` (rtde_set_watchdog)."""
        self._watch = (register, round(NS_PER_S / least_hz)) if least_hz > 0.0 else None
        self._written_ns[register] = time_ns

    def note_written(self, register: str, time_ns: int) -> None:
        """Record that a client wrote a register."""
        self._written_ns[register] = time_ns

    def take_over(self, time_ns: int) -> bool:
        """Check the watchdog, start a program that has been read; return whether another one ended."""
        before = self._program
        self._keep_watch(time_ns)
        self.start_read(time_ns)
        return before is not None and self._program is not before

    def step(self) -> bool:
        """Run one cycle of the program; return whether it ended."""
        if self._program is None or self.paused:
            return False
        try:
            if self._program.step():
                return False
            self.end("ended")
        except ProgramError as error:
            self.end(str(error))
        return True

    def start_read(self, time_ns: int) -> None:
        """Start the program that has been read, if there is one."""
        if self._read is not None and time_ns >= self._read[1]:
            program, self._read = self._read[0], None
            self.end("replaced")
            self._program, self.paused = program, False

    def _keep_watch(self, time_ns: int) -> None:
        if self._watch is not None and time_ns - self._written_ns[self._watch[0]] > self._watch[1]:
            self.end("watchdog: no communication")
