"""Stop a motion, or guiding by hand, if the program that started it no longer polls the arm.

If the program is suspended (SIGSTOP, Ctrl-Z), hangs or swaps, the motion would otherwise run to its end,
because the command process lives on and keeps kicking the controller's watchdog. Each poll of the arm's state
in the program's own loop is a heartbeat; there is no separate heartbeat thread.

A late heartbeat is not a missing one. If the program is suspended, the motion is stopped immediately. If the
program had the time to poll and did not, the arm stops within `MOST_WAY_M`. Two intervals do not count as
silence. The first is the time in which the program waits for the answer to a command: a slow controller is
not the program's fault, and the controller's own watchdog supervises that time. The second is the time in
which the program was ready to run and got no core, which happens briefly on a loaded host. Without a core,
however, no motion continues for longer than `LONGEST_S`.
"""

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.ur5e.shared_state import SharedState

_CPUCLOCK_SCHED = 2
"""Clock id of the CPU time of all threads of a process, ns; `man 3 clock_getcpuclockid` is not in Python."""
MOST_WAY_M = 0.020
"""Longest distance that the arm may travel after the last heartbeat of a program that hangs."""
BRAKE_M_S2 = 10.0
"""Deceleration of every stop: a commanded one, and after a program hangs or its connection is lost."""
REACTION_S = 0.010
"""Time from the decision to stop to the first slower cycle, and from a heartbeat to its check; rounded up."""
LEAST_S, LONGEST_S = 0.03, 0.35
"""Shortest limit that a computer can keep, and longest time that any motion continues without a poll."""
GUIDED_S = 1.0
"""Both limits for an arm that a person leads by hand: it does not move by itself."""
LATE_NS = to_ns(0.015)
"""Age of a heartbeat at which the program is inspected: a working program polls each 8 ms, or each frame."""


class Program:
    """A process with all its threads. Without /proc it is assumed to be running.

    slowness: seconds of CPU time that count as one second, as on a slowed clock.
    """

    def __init__(self, pid: int, slowness: int = 1) -> None:
        self._slowness = slowness
        self._stat, self._threads = Path(f"/proc/{pid}/stat"), Path(f"/proc/{pid}/task")
        self._clock = (~pid << 3) | _CPUCLOCK_SCHED
        self._ran_ns: int | None = None

    def is_stopped(self) -> bool:
        """Whether the process was suspended by a signal (SIGSTOP, Ctrl-Z, a debugger), or is dead."""
        return _state(self._stat) in ("T", "Z", "X")

    def waited_ns(self, during_ns: int) -> int:
        """Return how long the process was ready to run without a core since the last call or `note`, ns.

        A thread without a core blocks the others, because they share one interpreter.
        """
        before_ns = self._ran_ns
        self.note()
        if before_ns is None or self._ran_ns is None or not self._wants_a_core():
            return 0
        return max(0, during_ns - (self._ran_ns - before_ns))

    def note(self) -> None:
        """Start a new measurement of `waited_ns`."""
        self._ran_ns = self._has_run_ns()

    def _wants_a_core(self) -> bool:
        with suppress(OSError):
            return any(_state(thread / "stat") == "R" for thread in self._threads.iterdir())
        return False

    def _has_run_ns(self) -> int | None:
        with suppress(OSError):
            return time.clock_gettime_ns(self._clock) // self._slowness
        return None


def _state(stat: Path) -> str:
    """Return the process state letter (`man 5 proc_pid_stat`); the name before it may contain anything."""
    with suppress(OSError, IndexError):
        return stat.read_text(errors="replace").rpartition(")")[2].split()[0]
    return ""


def silence_limit_s(speed_m_s: float) -> float:
    """Return the longest silence of a program, s, so that the arm stands within `MOST_WAY_M`."""
    left_m = MOST_WAY_M - speed_m_s**2 / (2 * BRAKE_M_S2)
    return min(LONGEST_S, max(LEAST_S, left_m / speed_m_s - REACTION_S))


class Heartbeat:
    """Stops a motion through ur-rtde's `control` if the program no longer polls the arm."""

    def __init__(self, control: Any, state: SharedState, program: Program, clock: Clock) -> None:
        self._control, self._state, self._program, self._clock = control, state, program, clock
        self._limit_ns: int | None = None
        self._guided, self._longest_ns = False, to_ns(LONGEST_S)
        self._began_ns = self._checked_ns = self._waited_ns = self._polled_ns = self._asking_ns = 0
        self.halted = ""
        """Reason if this class stopped the newest motion; otherwise empty."""

    def begin(self, speed_m_s: float | None) -> None:
        """Supervise a motion at a speed, or, without one, guiding by hand."""
        self._guided = speed_m_s is None
        limit_s, longest_s = GUIDED_S, GUIDED_S
        if speed_m_s is not None:
            limit_s, longest_s = silence_limit_s(speed_m_s), LONGEST_S
        self._limit_ns, self._longest_ns = to_ns(limit_s), to_ns(longest_s)
        self.halted = ""
        self._state.note_guiding_lost(False)
        self._began_ns = self._checked_ns = self._clock.now_ns()
        self._waited_ns = 0
        self._program.note()

    def note_answer(self, asked_ns: int) -> None:
        """Note that the program got the answer to a call of time `asked_ns`; it could not poll meanwhile."""
        self._note_polls()
        self._checked_ns = self._clock.now_ns()
        self._asking_ns += self._checked_ns - max(asked_ns, self._began_ns)
        self._program.note()

    def end(self) -> None:
        """End the supervision: the motion or the guiding has ended, or is being stopped."""
        self._limit_ns = None
        self._state.note_guiding_lost(False)

    def check(self) -> None:
        """Stop the motion if the program no longer polls."""
        if self._limit_ns is None:
            return
        now_ns = self._clock.now_ns()
        self._note_polls()
        silent_ns = now_ns - self._polled_ns - self._asking_ns
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

    def _note_polls(self) -> None:
        polled_ns = max(self._began_ns, self._state.polled_ns())
        if polled_ns != self._polled_ns:
            self._polled_ns, self._asking_ns = polled_ns, 0

    def _wrong(self, silent_ns: int, since_check_ns: int, limit_ns: int) -> str:
        """Return why to stop; empty while the program polls, or can still poll in time."""
        if silent_ns <= LATE_NS:
            self._waited_ns = 0
            # at every check: if this process gets no core either, the next check comes late
            self._program.note()
            return ""
        if self._program.is_stopped():
            return "its program was stopped by a signal (SIGSTOP, Ctrl-Z, a debugger)"
        self._waited_ns += self._program.waited_ns(since_check_ns)
        if silent_ns - self._waited_ns <= limit_ns and silent_ns <= self._longest_ns:
            return ""
        silence = f"its program did not poll it for {silent_ns / NS_PER_S:.2f} s"
        if since_check_ns > silent_ns / 2:
            stood_s = since_check_ns / NS_PER_S
            return f"{silence}; for {stood_s:.2f} s of it the supervising process did not run either"
        if self._waited_ns < silent_ns / 2:
            return f"{silence}: it hangs"
        waited_s = self._waited_ns / NS_PER_S
        return (
            f"{silence}, of which it waited {waited_s:.2f} s for a core: the computer is too busy to move "
            "an arm; end other programs"
        )
