"""A motion goes on only as long as the program that began it polls the arm; so does an arm led by hand.

A program that is stopped (SIGSTOP, Ctrl-Z), hangs or swaps would otherwise leave a motion to run to its
end: the process that commands lives on and keeps the controller's watchdog quiet. Each poll of the arm's
state in the program's own loop is a beat; no thread beats beside it.

A late beat is not a missing one. If the program is stopped, the motion ends at once. If it had the time to
poll and did not, the arm stands within `MOST_WAY_M`. Two times do not count: the time in which it waits for
the answer to a command, because a slow controller is not its fault, and the controller's own watchdog counts
then; and the time in which it wanted to poll and got no core, because a loaded host does that for a moment
now and then. But without a core no motion goes on unwatched for longer than `LONGEST_S`.
"""

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S, Clock, SystemClock, to_ns
from drivers.ur5e.shared_state import SharedState

CPUCLOCK_SCHED = 2
"""Of all threads of a process, in ns: `man 3 clock_getcpuclockid`, which Python does not offer."""
MOST_WAY_M = 0.020
"""How far the arm may go on after the last beat of a program that hangs."""
BRAKE_M_S2 = 10.0
REACTION_S = 0.010
"""From the decision to stop to the first slower cycle, and from a beat to its look (ours, rounded up)."""
LEAST_S, LONGEST_S = 0.03, 0.35
"""Less than this a computer cannot keep; more than this no motion goes on unwatched, however slow."""
GUIDED_S = 1.0
"""The same for an arm that a person holds in their hands and leads: it goes nowhere by itself."""
LATE_NS = to_ns(0.015)
"""From here on the program is looked at: one that works looks each 8 ms, or each frame."""


class Program:
    """A process, with all its threads. Without /proc it counts as running."""

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


def silence_limit_s(speed_m_s: float) -> float:
    """How long a program may have the time to look and not do it, so that the arm stands in its way, s."""
    left_m = MOST_WAY_M - speed_m_s**2 / (2 * BRAKE_M_S2)
    return min(LONGEST_S, max(LEAST_S, left_m / speed_m_s - REACTION_S))


class Heartbeat:
    """Stops a motion of ur-rtde's `control` when the program does not look at it any more."""

    def __init__(
        self, control: Any, state: SharedState, program: Program, clock: Clock | None = None
    ) -> None:
        self._control, self._state, self._program = control, state, program
        self._clock: Clock = clock or SystemClock()
        self._limit_ns: int | None = None
        self._guided, self._longest_ns = False, to_ns(LONGEST_S)
        self._began_ns = self._checked_ns = self._waited_ns = 0
        self._looked_ns = self._asking_ns = 0
        self.halted = ""
        """Why the newest motion was stopped, where this stopped it."""

    def begin(self, speed_m_s: float) -> None:
        """Watch a motion that begins now."""
        self._watch(silence_limit_s(speed_m_s), LONGEST_S, guided=False)

    def begin_guiding(self) -> None:
        """Watch an arm that is led by hand from now on."""
        self._watch(GUIDED_S, GUIDED_S, guided=True)

    def _watch(self, limit_s: float, longest_s: float, guided: bool) -> None:
        self._limit_ns, self._longest_ns, self._guided = to_ns(limit_s), to_ns(longest_s), guided
        self.halted = ""
        self._state.note_guiding_lost(False)
        self._began_ns = self._checked_ns = self._clock.now_ns()
        self._waited_ns = 0
        self._program.note()

    def answered(self, asked_ns: int) -> None:
        """The program has the answer to what it asked for at a time: meanwhile it could not look."""
        self._note_looks()
        self._checked_ns = self._clock.now_ns()
        self._asking_ns += self._checked_ns - max(asked_ns, self._began_ns)
        self._program.note()

    def end(self) -> None:
        """The motion or the guiding is over, or told to stop."""
        self._limit_ns = None
        self._state.note_guiding_lost(False)

    def check(self) -> None:
        """Stop the motion where nobody looks any more."""
        if self._limit_ns is None:
            return
        now_ns = self._clock.now_ns()
        self._note_looks()
        silent_ns = now_ns - self._looked_ns - self._asking_ns
        why = self._wrong(silent_ns, now_ns - self._checked_ns, self._limit_ns)
        self._checked_ns = now_ns
        if not why:
            return
        self.end()
        if self._guided:
            self._control.endTeachMode()
            self.halted = why
            self._state.note_guiding_lost(True)
        elif self._control.getAsyncOperationProgressEx().isAsyncOperationRunning():
            self._control.stopL(BRAKE_M_S2, True)
            self.halted = why

    def _note_looks(self) -> None:
        looked_ns = max(self._began_ns, self._state.looked_ns())
        if looked_ns != self._looked_ns:
            self._looked_ns, self._asking_ns = looked_ns, 0

    def _wrong(self, silent_ns: int, since_check_ns: int, limit_ns: int) -> str:
        """Say what is wrong with the program; nothing while it works, or gets to work again in time."""
        if silent_ns <= LATE_NS:
            self._waited_ns = 0
            # each time: where this process gets no core either, the next look comes late
            self._program.note()
            return ""
        if self._program.is_stopped():
            return "its program was stopped by a signal (SIGSTOP, Ctrl-Z, a debugger)"
        self._waited_ns += self._program.waited_ns(since_check_ns)
        if silent_ns - self._waited_ns <= limit_ns and silent_ns <= self._longest_ns:
            return ""
        silence = f"its program did not look at it for {silent_ns / NS_PER_S:.2f} s"
        if since_check_ns > silent_ns / 2:
            stood_s = since_check_ns / NS_PER_S
            return f"{silence}; for {stood_s:.2f} s of it the process that watches it stood still as well"
        if self._waited_ns < silent_ns / 2:
            return f"{silence}: it hangs"
        waited_s = self._waited_ns / NS_PER_S
        return (
            f"{silence}, of which it waited {waited_s:.2f} s for a core: the computer is too busy to move an "
            "arm; end what else runs"
        )
