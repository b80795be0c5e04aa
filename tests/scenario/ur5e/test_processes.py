"""The UR5e's processes: a crash of one, the end of the rig, and a rig without their library."""

import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from drivers.types import ArmMode
from drivers.ur5e.arm import UR5e
from fakes.wire.ur.controller import URController
from support.marks import heavy, require_ur_rtde
from support.slow_motion import SLOWNESS, pause
from support.ur5e import agree, first_error, make_arm, running, stands
from support.waiting import until
from support.worlds import HOME

require_ur_rtde()


MOVING = """
import os, subprocess, sys, time

def busy(for_s, watching):
    # Other programs take this one's core, on which it runs only if nothing else does. The process that
    # watches this one keeps to the other cores: on the same core it would report that it stood still itself.
    cores = os.sched_getaffinity(0)
    for thread in os.listdir(f"/proc/{watching}/task"):
        os.sched_setaffinity(int(thread), cores - {min(cores)} or cores)
    spin = f"import time\\nwhile time.monotonic() < {time.monotonic() + for_s}: pass"
    os.sched_setaffinity(0, {min(cores)})
    for _ in range(8):  # beside a single one this program would run once a second
        subprocess.Popen([sys.executable, "-I", "-S", "-c", spin])
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))

from drivers.clock import SystemClock
from drivers.types import Pose
from drivers.ur5e.arm import UR5e
from fakes.devices.arm import LIMITS
slowness, how = int(sys.argv[2]), sys.argv[3]
arm = UR5e(sys.argv[1], LIMITS, Pose((0, 0, 0.28)), 2.5, (0, 0, 0.08), clock=SystemClock(slowness))
arm.connect()
motion = arm.move_linear(arm.state().base_T_tcp.translated(z_m=-0.20), 0.25, 1.0)
if how == "hangs":
    while motion.progress() < 0.01:
        time.sleep(0.001)
    print("hangs", flush=True)
    time.sleep(300)
if how == "busy":
    mine = open(f"/proc/self/task/{os.getpid()}/children").read().split()
    named = "ur5e.processes\\0control"
    commanding = next(pid for pid in mine if named in open(f"/proc/{pid}/cmdline").read())
    busy(slowness * 0.1, commanding)
try:
    motion.wait(10.0)
except Exception as error:
    print(error, flush=True)
arm.disconnect()
"""
"""Moves the arm down at the speed of an approach. Its last argument: "looks", "busy", or "hangs": it hangs,
and prints this word, once the arm moves."""


def height_m(controller: URController) -> float:
    return controller.snapshot()["tcp_m"][2]


def process_of(controller: URController, kind: str) -> int:
    """Return a process of the driver that is connected to a controller: `state` or `control`."""
    names = f"drivers.ur5e.processes\0{kind}\0{controller.host}\0".encode()
    return next(int(of.parent.name) for of in Path("/proc").glob("[0-9]*/cmdline") if names in _read(of))


def exists(pid: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    state = _read(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()
    return bool(state) and state[0] != b"Z"


def _read(file: Path) -> bytes:
    with suppress(OSError):
        return file.read_bytes()
    return b""


@pytest.mark.heavy
@pytest.mark.parametrize("crash", [signal.SIGSEGV, *heavy(signal.SIGKILL)])
def test_crash_of_the_commanding_process_ends_the_motion_and_recovers(
    controller: URController, arm: UR5e, crash: signal.Signals
) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.25), 0.05, 1.0)
    os.kill(process_of(controller, "control"), crash)
    error = first_error(motion.is_done)
    assert crash.name in str(error) or "control program" in str(error)
    arm.stop()
    assert stands(controller)
    arm.recover(agree)
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


@pytest.mark.heavy
def test_crash_of_the_listening_process_is_an_error_until_reconnected(
    controller: URController, arm: UR5e
) -> None:
    listening = process_of(controller, "state")
    os.kill(listening, signal.SIGSEGV)
    until(lambda: not exists(listening))
    assert "SIGSEGV" in str(first_error(arm.state))
    arm.connect()
    assert arm.state().mode is ArmMode.RUNNING


@pytest.mark.heavy
def test_killed_program_leaves_no_process_and_stops_the_arm(controller: URController) -> None:
    with running(MOVING, controller, "hangs") as program:
        assert program.stdout.readline() == "hangs\n"
        children = [process_of(controller, name) for name in ("state", "control")]
        program.kill()
    until(lambda: not any(map(exists, children)))
    until(lambda: not controller.snapshot()["program_running"])
    assert stands(controller)


@pytest.mark.heavy
def test_motion_stops_if_its_program_is_suspended(controller: URController) -> None:
    with running(MOVING, controller, "looks") as program:
        until(lambda: height_m(controller) < HOME.position_m[2] - 0.05)
        program.send_signal(signal.SIGSTOP)
        there = height_m(controller)
        pause(0.5)
        ended = height_m(controller)
        assert there - ended <= 0.020
        assert stands(controller)
        assert height_m(controller) == ended
        program.send_signal(signal.SIGCONT)
        assert "stopped by a signal" in program.stdout.read()


@pytest.mark.heavy
def test_motion_stops_if_its_program_hangs(controller: URController) -> None:
    with running(MOVING, controller, "hangs") as program:
        assert program.stdout.readline() == "hangs\n"
        there = height_m(controller)
        pause(0.5)
        assert there - height_m(controller) <= 0.020
        assert stands(controller)


@pytest.mark.heavy
@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="this system has no SCHED_IDLE")
def test_motion_continues_for_a_moment_without_a_core(controller: URController) -> None:
    # After how long it stops is a test of the heartbeat: how long a program waits is the scheduler's choice.
    with running(MOVING, controller, "busy") as program:
        assert program.stdout.read() == ""
        assert HOME.position_m[2] - height_m(controller) > 0.199


@pytest.mark.heavy
def test_controller_stops_the_arm_if_it_gets_no_commands(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.20), 0.25, 1.0)
    until(lambda: motion.is_done() or motion.progress() > 0.25)
    there = height_m(controller)
    os.kill(process_of(controller, "control"), signal.SIGKILL)
    pause(0.5)
    assert there - height_m(controller) <= 0.030
    assert stands(controller)


@pytest.mark.heavy
@pytest.mark.parametrize("all_of_it", [False, True])
def test_computer_that_stands_still_does_not_end_the_program_of_a_simulated_controller(
    controller: URController, arm: UR5e, all_of_it: bool
) -> None:
    commanding = process_of(controller, "control")
    before_s = sys.getswitchinterval()
    end_s = time.monotonic() + SLOWNESS * 0.2
    if all_of_it:
        os.kill(commanding, signal.SIGSTOP)
    sys.setswitchinterval(SLOWNESS)
    while time.monotonic() < end_s:  # the controller's thread does not run
        pass
    sys.setswitchinterval(before_s)
    os.kill(commanding, signal.SIGCONT)
    pause(0.05)
    assert controller.snapshot()["program_running"], controller.snapshot()["program_end"]


def test_missing_arm_library_is_named_on_connecting(
    monkeypatch: pytest.MonkeyPatch, controller: URController
) -> None:
    monkeypatch.setattr("drivers.ur5e.link.importlib.util.find_spec", lambda name: None)
    with pytest.raises(DeviceError, match="ur-rtde is not installed"):
        make_arm(controller.host).connect()
