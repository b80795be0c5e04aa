"""How long an unpolled motion may continue, depending on its speed and on the state of its program."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.clock import SystemClock, to_ns
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


class Control:
    """A controller with a motion that continues until it is stopped."""

    def __init__(self) -> None:
        self.running, self.stops = True, 0

    def getAsyncOperationProgressEx(self) -> SimpleNamespace:  # noqa: N802
        return SimpleNamespace(isAsyncOperationRunning=lambda: self.running)

    def stopL(self, deceleration: float, asynchronous: bool) -> None:  # noqa: N802
        self.stops += 1


class ScriptedProgram(Program):
    """A program that waits for a core for a fraction of the time."""

    def __init__(self, waits: float = 0.0) -> None:
        super().__init__(os.getpid())
        self.waits, self.state, self.ran_ns = waits, "R", 0

    def pass_time(self, duration_ns: int) -> None:
        self.ran_ns += round((1.0 - self.waits) * duration_ns)

    def is_stopped(self) -> bool:
        return self.state == "T"

    def _wants_a_core(self) -> bool:
        return self.state == "R"

    def _has_run_ns(self) -> int:
        return self.ran_ns


class SteppedClock(SystemClock):
    """A clock that the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.time_ns = to_ns(100.0)

    def now_ns(self) -> int:
        return self.time_ns


@pytest.fixture
def state() -> Iterator[SharedState]:
    state = SharedState()
    yield state
    state.close()


class Watched:
    """A motion at approach speed, just begun."""

    def __init__(self, state: SharedState, program: ScriptedProgram) -> None:
        self.control, self.clock, self.state, self.program = Control(), SteppedClock(), state, program
        self.heartbeat = Heartbeat(self.control, self.state, program, self.clock)
        self.heartbeat.check()
        self.heartbeat.begin(SPEED_M_S)

    def wait(self, duration_s: float) -> None:
        end_ns = self.clock.time_ns + to_ns(duration_s)
        while self.clock.time_ns < end_ns:
            self.pass_unchecked(0.005)
            self.heartbeat.check()

    def pass_unchecked(self, duration_s: float) -> None:
        """Suspend or occupy the command process."""
        self.clock.time_ns += to_ns(duration_s)
        self.program.pass_time(to_ns(duration_s))

    def look(self) -> None:
        self.state.note_poll(self.clock.time_ns)


def test_motion_is_stopped_once_when_polling_ends_and_not_before(state: SharedState) -> None:
    watched = Watched(state, ScriptedProgram())
    for _ in range(100):
        watched.look()
        watched.wait(0.030)
    assert (watched.control.stops, watched.heartbeat.halted) == (0, "")
    watched.wait(1.5 * LIMIT_S)
    assert watched.control.stops == 1
    assert "it hangs" in watched.heartbeat.halted
    watched.heartbeat.begin(SPEED_M_S)
    assert watched.heartbeat.halted == ""
    watched.control.running = False  # the motion has ended without a poll, so there is nothing to stop
    watched.wait(0.1)
    assert (watched.control.stops, watched.heartbeat.halted) == (1, "")


def test_program_without_a_core_gets_more_time_up_to_the_limit(state: SharedState) -> None:
    watched = Watched(state, ScriptedProgram(waits=1.0))
    for _ in range(3):
        watched.wait(LONGEST_S - 0.01)
        watched.look()  # late, but it came
    assert watched.control.stops == 0
    watched.wait(LONGEST_S + 0.02)
    assert watched.control.stops == 1
    assert "too busy" in watched.heartbeat.halted


def test_stalled_host_is_reported_instead_of_a_hanging_program(state: SharedState) -> None:
    watched = Watched(state, ScriptedProgram())
    watched.look()
    watched.pass_unchecked(0.5)  # a virtual machine that was held: neither the program nor who watches it ran
    watched.heartbeat.check()
    assert watched.control.stops == 1
    assert "0.50 s of it the supervising process did not run" in watched.heartbeat.halted


def test_wait_for_a_slow_controller_is_not_counted_as_silence(
    state: SharedState,
) -> None:
    watched = Watched(state, ScriptedProgram())
    watched.wait(0.020)
    watched.look()
    asked_ns = watched.clock.time_ns
    watched.pass_unchecked(0.75)  # the process that commands waits as well
    watched.heartbeat.answered(asked_ns)
    watched.wait(0.9 * LIMIT_S)
    assert watched.control.stops == 0
    watched.wait(0.2 * LIMIT_S)
    assert watched.control.stops == 1


@pytest.mark.parametrize(("waits", "stops"), [(1.0, 0), (0.0, 1)])
def test_hanging_program_is_distinguished_from_one_without_a_core(
    state: SharedState, waits: float, stops: int
) -> None:
    watched = Watched(state, ScriptedProgram(waits))
    watched.look()
    watched.wait(0.010)
    watched.pass_unchecked(3 * LIMIT_S)
    watched.heartbeat.check()
    assert watched.control.stops == stops


def test_suspended_program_stops_the_arm_at_once(state: SharedState) -> None:
    watched = Watched(state, ScriptedProgram())
    watched.program.state = "T"
    watched.wait(0.025)
    assert watched.control.stops == 1
    assert "SIGSTOP" in watched.heartbeat.halted


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
