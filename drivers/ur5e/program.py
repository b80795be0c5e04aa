"""The program that drives the arm, as the system schedules it: at work, stopped, or without a core."""

import time
from contextlib import suppress
from pathlib import Path

CPUCLOCK_SCHED = 2
"""Of all threads of a process, in ns: `man 3 clock_getcpuclockid`, which Python does not offer."""


class Program:
    """A process, with all its threads. Where the system does not tell (no /proc), it counts as at work."""

    def __init__(self, pid: int) -> None:
        self._stat, self._threads = Path(f"/proc/{pid}/stat"), Path(f"/proc/{pid}/task")
        self._clock = (~pid << 3) | CPUCLOCK_SCHED
        self._ran_ns: int | None = None

    def is_stopped(self) -> bool:
        """Whether it was stopped by a signal (SIGSTOP, Ctrl-Z, a debugger), or is dead."""
        return _state(self._stat) in ("T", "Z", "X")

    def waited_ns(self, during_ns: int) -> int:
        """How long it could have run and got no core, in the time since it was noted or asked last, ns.

        A thread without a core keeps the others waiting: they share one interpreter.
        """
        before_ns = self._ran_ns
        self.note()
        if before_ns is None or self._ran_ns is None or not self._wants_a_core():
            return 0
        return max(0, during_ns - (self._ran_ns - before_ns))

    def note(self) -> None:
        """Note how long it has run so far: what was before does not count."""
        self._ran_ns = self._has_run_ns()

    def _wants_a_core(self) -> bool:
        with suppress(OSError):
            return any(_state(thread / "stat") == "R" for thread in self._threads.iterdir())
        return False

    def _has_run_ns(self) -> int | None:
        with suppress(OSError):
            return time.clock_gettime_ns(self._clock)
        return None


def _state(stat: Path) -> str:
    """The letter of `man 5 proc_pid_stat`. What comes before it is the name, which may hold anything."""
    with suppress(OSError, IndexError):
        return stat.read_text(errors="replace").rpartition(")")[2].split()[0]
    return ""
