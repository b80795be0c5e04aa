"""How long an unpolled motion may continue, depending on its speed and on the state of its program."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import to_ns
from drivers.ur5e.heartbeat import BRAKE_M_S2, LONGEST_S, MOST_WAY_M, Heartbeat, Program, silence_limit_s
from drivers.ur5e.shared_state import SharedState
from support.waiting import until

SPEED_M_S = 0.25
LIMIT_S = silence_limit_s(SPEED_M_S)
READY = "import threading, time; print(flush=True)\n"
SPINS, SLEEPS = f"{READY}while True: pass", f"{READY}time.sleep(60)"
WAITS_FOR_A_THREAD = """
import threading
def spin():
    while True: pass
thread = threading.Thread(target=spin, daemon=True)
thread.start()
print(flush=True)
thread.join()
"""


@pytest.mark.parametrize("speed_m_s", [0.001, 0.05, 0.1, 0.15, 0.25, 0.3])
def test_unpolled_motion_stops_within_the_allowed_distance(speed_m_s: float) -> None:
    limit_s = silence_limit_s(speed_m_s)
    assert limit_s <= LONGEST_S
    assert limit_s * speed_m_s + speed_m_s**2 / (2 * BRAKE_M_S2) <= MOST_WAY_M


class ScriptedProgram(Program):
    """A program that waits for a core for a fraction of the time."""

    def __init__(self, waits: float) -> None:
        super().__init__(os.getpid())
        self.waits, self.state, self.ran_ns = waits, "R", 0

    def is_stopped(self) -> bool:
        return self.state == "T"

    def _wants_a_core(self) -> bool:
        return self.state == "R"

    def _has_run_ns(self) -> int:
        return self.ran_ns


class Watched:
    """A motion at approach speed, just begun, that continues until it is stopped; the test sets the clock."""

    def __init__(self, state: SharedState, waits: float = 0.0) -> None:
        self.time_ns, self.running, self.stops = to_ns(100.0), True, 0
        self.state, self.program = state, ScriptedProgram(waits)
        control = SimpleNamespace(
            getAsyncOperationProgressEx=lambda: SimpleNamespace(isAsyncOperationRunning=lambda: self.running),
            stopL=self._stop,
        )
        clock: Any = SimpleNamespace(now_ns=lambda: self.time_ns)
        self.heartbeat = Heartbeat(control, state, self.program, clock)
        self.heartbeat.check()
        self.heartbeat.begin(SPEED_M_S)

    def _stop(self, deceleration_m_s2: float, asynchronous: bool) -> None:
        assert (deceleration_m_s2, asynchronous) == (BRAKE_M_S2, True)
        self.stops += 1

    def wait(self, duration_s: float) -> None:
        end_ns = self.time_ns + to_ns(duration_s)
        while self.time_ns < end_ns:
            self.pass_unchecked(0.005)
            self.heartbeat.check()

    def pass_unchecked(self, duration_s: float) -> None:
        """Suspend or occupy the command process."""
        self.time_ns += to_ns(duration_s)
        self.program.ran_ns += round((1.0 - self.program.waits) * to_ns(duration_s))

    def look(self) -> None:
        self.state.note_poll(self.time_ns)


@pytest.fixture
def watch() -> Iterator[Callable[..., Watched]]:
    """Begins to watch a motion: `watch(waits=1.0)`."""
    state = SharedState()
    yield lambda waits=0.0: Watched(state, waits)
    state.close()


def test_motion_is_stopped_once_when_polling_ends_and_not_before(watch: Callable[..., Watched]) -> None:
    watched = watch()
    for _ in range(100):
        watched.look()
        watched.wait(0.030)
    assert (watched.stops, watched.heartbeat.halted) == (0, "")
    watched.wait(1.5 * LIMIT_S)
    assert watched.stops == 1
    assert "it hangs" in watched.heartbeat.halted
    watched.heartbeat.begin(SPEED_M_S)
    assert watched.heartbeat.halted == ""
    watched.running = False  # the motion has ended without a poll, so there is nothing to stop
    watched.wait(0.1)
    assert (watched.stops, watched.heartbeat.halted) == (1, "")


def test_program_without_a_core_gets_more_time_up_to_the_limit(watch: Callable[..., Watched]) -> None:
    watched = watch(waits=1.0)
    for _ in range(3):
        watched.wait(LONGEST_S - 0.01)
        watched.look()  # late, but it came
    assert watched.stops == 0
    watched.wait(LONGEST_S + 0.02)
    assert watched.stops == 1
    assert "too busy" in watched.heartbeat.halted


def test_wait_for_a_slow_controller_is_not_counted_as_silence(watch: Callable[..., Watched]) -> None:
    watched = watch()
    watched.wait(0.020)
    watched.look()
    asked_ns = watched.time_ns
    watched.pass_unchecked(0.75)  # the process that commands waits as well
    watched.heartbeat.note_answer(asked_ns)
    watched.wait(0.9 * LIMIT_S)
    assert watched.stops == 0
    watched.wait(0.2 * LIMIT_S)
    assert watched.stops == 1


@pytest.mark.parametrize(
    ("waits", "looks_s", "unchecked_s", "state", "said"),
    [
        (1.0, 0.010, 3 * LIMIT_S, "R", ""),  # it gets no core
        (0.0, 0.010, 3 * LIMIT_S, "R", "it hangs|did not run"),
        # a virtual machine that was held: neither the program nor the process that watches it ran
        (0.0, 0.0, 0.5, "R", r"0\.50 s of it the supervising process did not run"),
        (0.0, 0.025, 0.0, "T", "SIGSTOP"),
    ],
)
def test_hanging_suspended_and_busy_programs_are_distinguished(
    watch: Callable[..., Watched], waits: float, looks_s: float, unchecked_s: float, state: str, said: str
) -> None:
    watched = watch(waits)
    watched.look()
    watched.program.state = state
    watched.wait(looks_s)
    watched.pass_unchecked(unchecked_s)
    watched.heartbeat.check()
    assert watched.stops == bool(said)
    assert re.search(said, watched.heartbeat.halted)


@pytest.fixture
def started(request: pytest.FixtureRequest) -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen([sys.executable, "-I", "-c", request.param], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()  # it has started
        yield process
        process.kill()


@pytest.mark.parametrize("started", [SPINS, SLEEPS], indirect=True)
def test_stopped_and_dead_programs_are_detected(started: "subprocess.Popen[bytes]") -> None:
    program = Program(started.pid)
    assert not program.is_stopped()
    started.send_signal(signal.SIGSTOP)
    until(program.is_stopped)
    started.send_signal(signal.SIGCONT)
    until(lambda: not program.is_stopped())
    started.kill()
    until(program.is_stopped)


def waited_share(program: Program, duration_s: float) -> float:
    """Fraction of the time in which a program was ready to run but got no core."""
    program.note()
    began = last = time.monotonic_ns()
    waited = 0
    while time.monotonic_ns() - began < to_ns(duration_s):
        time.sleep(0.005)
        now = time.monotonic_ns()
        waited, last = waited + program.waited_ns(now - last), now
    return waited / (last - began)


@pytest.mark.parametrize("started", [SLEEPS], indirect=True)
def test_sleeping_program_does_not_count_as_waiting(started: "subprocess.Popen[bytes]") -> None:
    until(lambda: Path(f"/proc/{started.pid}/stat").read_text().split()[2] == "S")
    assert waited_share(Program(started.pid), 0.2) < 0.1


@pytest.mark.heavy
@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="this system has no SCHED_IDLE")
@pytest.mark.parametrize("started", [SPINS, WAITS_FOR_A_THREAD], indirect=True)
def test_idle_priority_program_counts_as_waiting_for_a_core(started: "subprocess.Popen[bytes]") -> None:
    core = {min(os.sched_getaffinity(0))}
    with subprocess.Popen([sys.executable, "-I", "-c", SPINS], stdout=subprocess.PIPE) as other:
        try:
            assert other.stdout is not None
            other.stdout.readline()
            os.sched_setaffinity(other.pid, core)
            os.sched_setscheduler(other.pid, os.SCHED_OTHER, os.sched_param(0))
            for thread in os.listdir(f"/proc/{started.pid}/task"):
                os.sched_setaffinity(int(thread), core)
                os.sched_setscheduler(int(thread), os.SCHED_IDLE, os.sched_param(0))
            assert waited_share(Program(started.pid), 0.5) > 0.7
        finally:
            other.kill()
