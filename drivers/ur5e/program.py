"""The program that drives the arm, as the system schedules it: at work, stopped, or without a core."""

from contextlib import suppress
from pathlib import Path


class Program:
    """A process, by its main thread. Where the system does not tell (no /proc), it counts as at work."""

    def __init__(self, pid: int) -> None:
        self._stat, self._times = Path(f"/proc/{pid}/stat"), Path(f"/proc/{pid}/schedstat")
        self._ran_ns: int | None = None

    def is_stopped(self) -> bool:
        """Whether it was stopped by a signal (SIGSTOP, Ctrl-Z, a debugger), or is dead."""
        return self._state() in ("T", "Z", "X")

    def waited_ns(self, during_ns: int) -> int:
        """How long it could have run and got no core, in the time since it was noted or asked last, ns."""
        before_ns = self._ran_ns
        self.note()
        if before_ns is None or self._ran_ns is None or self._state() != "R":
            return 0
        return max(0, during_ns - (self._ran_ns - before_ns))

    def note(self) -> None:
        """Note how long it has run so far: what was before does not count."""
        self._ran_ns = self._has_run_ns()

    def _state(self) -> str:
        """The letter of `man 5 proc_pid_stat`. What comes before it is the name, which may hold anything."""
        with suppress(OSError, IndexError):
            return self._stat.read_text(errors="replace").rpartition(")")[2].split()[0]
        return ""

    def _has_run_ns(self) -> int | None:
        with suppress(OSError, IndexError, ValueError):
            return int(self._times.read_text().split()[0])
        return None
