"""The UR5e's driver on the simulated controller: motions, stops, and every fault in mid-motion."""

import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    NotConnectedError,
    OperatorStopError,
    OutOfLimitsError,
    ProtectiveStopError,
)
from drivers.types import ArmMode, Pose
from drivers.ur5e.arm import UR5e
from drivers.ur5e.dashboard import Dashboard
from fakes.clock import SimulatedClock
from fakes.devices.arm import LIMITS, TOOL_LENGTH_M
from fakes.wire.ur.controller import URController
from fakes.world.world import BenchLayout, World

pytest.importorskip("rtde_control", reason="ur-rtde is not installed here")
pytestmark = pytest.mark.real_time

DOWN = Rotation.from_euler("x", 180, degrees=True)
HOME = Pose.from_rotation((0.45, 0.0, 0.3), DOWN)
_addresses = itertools.count(1)


def make_controller(version: str = "5.11.0") -> URController:
    pid = os.getpid()
    host = f"127.{200 + pid % 50}.{pid // 50 % 250}.{next(_addresses)}"
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), HOME), seed=1)
    return URController(world, SimulatedClock(realtime=True), host, version, release_after_s=0.5)


def make_arm(host: str, payload_kg: float = 1.8) -> UR5e:
    return UR5e(host, LIMITS, Pose((0.0, 0.0, TOOL_LENGTH_M)), payload_kg, (0.0, 0.0, 0.08))


@pytest.fixture
def controller() -> Iterator[URController]:
    controller = make_controller()
    controller.start()
    yield controller
    controller.stop()


@pytest.fixture
def arm(controller: URController) -> Iterator[UR5e]:
    arm = make_arm(controller.host)
    arm.connect()
    yield arm
    arm.disconnect()


def agree(question: str) -> None:
    """A person who has looked at the arm."""


def first_error(call: Callable[[], object], limit_s: float = 3.0) -> tuple[DeviceError, float]:
    """Ask until it raises; return the error and how long that took."""
    began = time.monotonic()
    while time.monotonic() - began < limit_s:
        try:
            call()
        except DeviceError as error:
            return error, time.monotonic() - began
        time.sleep(0.005)
    pytest.fail("no error")


def stands(controller: URController) -> bool:
    """Whether the arm stands, having had the time to brake."""
    time.sleep(0.1)
    before = controller.snapshot()["tcp_m"]
    time.sleep(0.1)
    return np.allclose(controller.snapshot()["tcp_m"], before, atol=1e-6)


@pytest.mark.parametrize("version", ["5.11.0", "5.25.0"])
def test_a_motion_on_either_version(version: str) -> None:
    controller = make_controller(version)
    controller.start()
    arm = make_arm(controller.host)
    try:
        arm.connect()
        motion = arm.move_linear(HOME.translated(z_m=-0.05), 0.25, 1.0)
        assert motion.progress() < 0.9
        motion.wait(5.0)
        assert motion.progress() == 1.0
        assert arm.state().base_T_tcp.position_m == pytest.approx((0.45, 0.0, 0.25), abs=1e-4)
        assert arm.identity()["firmware"].startswith(version)
    finally:
        arm.disconnect()
        controller.stop()


def test_connecting_moves_nothing_and_sets_up_the_tool(controller: URController, arm: UR5e) -> None:
    assert arm.state().base_T_tcp.position_m == pytest.approx(HOME.position_m, abs=1e-9)
    assert controller.robot.bank.get("payload") == 1.8
    assert controller.robot.body.tool[2] == pytest.approx(TOOL_LENGTH_M)
    assert set(controller.snapshot()["commands"]) <= {"17", "29", "35", "40"}


def test_a_program_that_stands_still_is_ended_before_ours_is_started(controller: URController) -> None:
    with Dashboard(controller.host) as pendant:
        pendant.ask("load wait.urp")
        assert pendant.ask("play") == "Starting program"
    arm = make_arm(controller.host)
    arm.connect()
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)
    arm.disconnect()


def test_a_program_that_moves_the_arm_is_left_alone(controller: URController) -> None:
    with socket.create_connection((controller.host, 30003)) as scripts:
        scripts.sendall(b"def sweep():\n  movel(p[0.45, 0, 0.1, 3.1415926, 0, 0], a=1, v=0.02)\nend\n")
        until(lambda: controller.snapshot()["tcp_m"][2] < 0.299)
        arm = make_arm(controller.host)
        with pytest.raises(DeviceError, match="a program moves it"):
            arm.connect()
    assert controller.snapshot()["program_running"]


def test_two_arms_at_once(controller: URController, arm: UR5e) -> None:
    other = make_controller()
    other.start()
    second = make_arm(other.host)
    try:
        second.connect()
        motions = [
            a.move_linear(HOME.translated(z_m=d), 0.25, 1.0) for a, d in ((arm, -0.05), (second, 0.05))
        ]
        for motion in motions:
            motion.wait(5.0)
        assert arm.state().base_T_tcp.position_m[2] == pytest.approx(0.25, abs=1e-4)
        assert second.state().base_T_tcp.position_m[2] == pytest.approx(0.35, abs=1e-4)
    finally:
        second.disconnect()
        other.stop()


def test_a_stop_from_another_thread(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    stopper = threading.Timer(0.3, arm.stop)
    stopper.start()
    motion.wait(5.0)
    stopper.join()
    assert motion.done()
    assert 0.2 < arm.state().base_T_tcp.position_m[2] < 0.299
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


def test_a_stop_during_the_preparation_of_a_motion_keeps_it_from_being_sent(
    controller: URController, arm: UR5e, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop_meanwhile(*_: object) -> None:
        arm.stop()

    monkeypatch.setattr("drivers.ur5e.arm.check_joints", stop_meanwhile)
    with pytest.raises(DeviceError, match="not sent"):
        arm.move_linear(HOME.translated(z_m=-0.1), 0.1, 1.0)
    assert "3" not in controller.snapshot()["commands"]


def test_letting_go_stops_a_motion(controller: URController, arm: UR5e) -> None:
    arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    arm.disconnect()
    assert stands(controller)
    assert not controller.snapshot()["program_running"]


def test_a_motion_that_takes_too_long_is_stopped(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.02, 1.0)
    with pytest.raises(DeviceTimeoutError, match="stopped it"):
        motion.wait(0.3)
    assert stands(controller)


def test_what_cannot_be_reached_is_refused_and_the_program_survives(
    controller: URController, arm: UR5e
) -> None:
    sideways = Pose((0.7, 0.35, 0.02), (0.7, 0.0, 0.0, 0.7))
    with pytest.raises(OutOfLimitsError, match="reach"):
        arm.move_linear(sideways, 0.1, 1.0)
    assert "3" not in controller.snapshot()["commands"], "no motion was sent"
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)


def test_joints_are_kept_in_their_limits(controller: URController) -> None:
    tool, narrow = Pose((0.0, 0.0, TOOL_LENGTH_M)), (0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
    limits = ((-0.1, -0.1, -0.1, -0.1, -0.1, -0.1), narrow)
    arm = UR5e(controller.host, LIMITS, tool, 1.8, (0.0, 0.0, 0.08), joint_limits_rad=limits)
    arm.connect()
    with pytest.raises(OutOfLimitsError, match="joint 1"):
        arm.move_linear(HOME.translated(z_m=-0.01), 0.1, 1.0)
    arm.disconnect()


def test_a_protective_stop_is_released_on_request_only(controller: URController, arm: UR5e) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.2), 0.1, 1.0)
    controller.inject("protective_stop")
    error, _ = first_error(motion.done)
    assert isinstance(error, ProtectiveStopError)
    assert arm.state().mode is ArmMode.PROTECTIVE_STOP

    def refuse(question: str) -> None:
        raise OperatorStopError("no")

    with pytest.raises(OperatorStopError):
        arm.recover(refuse)
    assert arm.state().mode is ArmMode.PROTECTIVE_STOP
    arm.recover(agree)
    assert arm.state().mode is ArmMode.RUNNING
    assert stands(controller), "recovery moves nothing"
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


def test_one_can_connect_in_a_protective_stop_and_recover(controller: URController) -> None:
    controller.inject("protective_stop")
    arm = make_arm(controller.host)
    arm.connect()
    with pytest.raises(ProtectiveStopError):
        arm.move_linear(HOME, 0.1, 1.0)
    arm.recover(agree)
    arm.move_linear(HOME.translated(z_m=-0.01), 0.25, 1.0).wait(5.0)
    arm.disconnect()


@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        ("program_killed", {}, "control program is stopped"),
        ("stream_frozen", {}, "state is unknown"),
        ("stream_frozen", {"repeat": True}, "state is unknown"),
        ("socket_dropped", {}, "connection lost"),
        ("silent", {}, "state is unknown"),
        ("emergency_stop", {}, "emergency stop"),
    ],
)
def test_a_fault_in_mid_motion_is_named_and_the_arm_stops(
    controller: URController, arm: UR5e, kind: str, arguments: dict[str, bool], said: str
) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.25), 0.1, 1.0)
    time.sleep(0.2)
    controller.inject(kind, **arguments)
    error, _ = first_error(motion.done)
    assert said in str(error)
    arm.stop()
    assert stands(controller)
    with pytest.raises(DeviceError):
        arm.move_linear(HOME, 0.1, 1.0)
    arm.disconnect()
    controller.inject("clear")
    if kind == "emergency_stop":
        with pytest.raises(DeviceError, match="power off"):
            arm.connect()
        return
    arm.connect()
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        ("silent", {}, "does not answer"),
        ("stream_frozen", {}, "does not answer"),
        ("stream_frozen", {"repeat": True}, "time stands still|does not answer"),
        ("remote_control_off", {}, "remote control is off"),
        ("recipe_refused", {"reply": "IN_USE"}, "already in use"),
        ("recipe_refused", {"reply": "NOT_FOUND"}, "NOT_FOUND"),
        ("recipe_refused", {"reply": "NOT_FOUND", "prefix": "actual_q"}, "no state.*actual_q"),
        ("emergency_stop", {}, "emergency stop"),
    ],
)
def test_a_fault_at_connect_is_named_at_once(
    controller: URController, kind: str, arguments: dict[str, bool | str], said: str
) -> None:
    controller.inject(kind, **arguments)
    arm = make_arm(controller.host)
    with pytest.raises(DeviceError, match=said):
        arm.connect()
    with pytest.raises(NotConnectedError):
        arm.state()


def test_nothing_starts_while_the_pendant_is_in_local_control(controller: URController, arm: UR5e) -> None:
    controller.inject("remote_control_off")
    with pytest.raises(DeviceError, match="remote control is off"):
        arm.move_linear(HOME.translated(z_m=-0.01), 0.1, 1.0)
    assert "3" not in controller.snapshot()["commands"]


@pytest.mark.parametrize("crash", [signal.SIGSEGV, signal.SIGKILL])
def test_a_crash_of_the_process_that_commands_costs_the_motion_only(
    controller: URController, arm: UR5e, crash: signal.Signals
) -> None:
    motion = arm.move_linear(HOME.translated(z_m=-0.25), 0.05, 1.0)
    process = arm._link.control._process._process  # type: ignore[union-attr]
    process.send_signal(crash)
    process.wait()
    error, _ = first_error(motion.done)
    assert crash.name in str(error) or "control program" in str(error)
    arm.stop()
    assert stands(controller)
    arm.recover(agree)
    arm.move_linear(HOME, 0.25, 1.0).wait(5.0)


def test_a_crash_of_the_process_that_listens_leaves_the_state_unknown(
    controller: URController, arm: UR5e
) -> None:
    process = arm._link._listener._process  # type: ignore[union-attr]
    process.send_signal(signal.SIGSEGV)
    process.wait()
    error, _ = first_error(arm.state)
    assert "SIGSEGV" in str(error)
    arm.connect()
    assert arm.state().mode is ArmMode.RUNNING


def test_when_the_rig_dies_its_processes_go_and_the_arm_stops(controller: URController) -> None:
    code = (
        "import sys, time\n"
        "from drivers.types import Pose\n"
        "from drivers.ur5e.arm import UR5e\n"
        "from fakes.devices.arm import LIMITS\n"
        "arm = UR5e(sys.argv[1], LIMITS, Pose((0, 0, 0.28)), 1.8, (0, 0, 0.08))\n"
        "arm.connect()\n"
        "arm.move_linear(arm.state().base_T_tcp.translated(z_m=-0.25), 0.05, 1.0)\n"
        "print(arm._link._listener._process.pid, arm._link.control._process._process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    rig = subprocess.Popen([sys.executable, "-c", code, controller.host], stdout=subprocess.PIPE, text=True)
    assert rig.stdout is not None
    children = [int(pid) for pid in rig.stdout.readline().split()]
    rig.kill()
    rig.wait()
    rig.stdout.close()
    until(lambda: not any(map(exists, children)))
    until(lambda: not controller.snapshot()["program_running"])
    assert stands(controller)


def until(met: Callable[[], bool], limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def exists(pid: int) -> bool:
    """Whether a process runs (one that is only not yet collected does not)."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def at_rest(arm: UR5e) -> bool:
    """Zero the force sensor if the arm has rested for long enough; return whether it had."""
    try:
        arm.zero_force_sensor()
    except DeviceError as error:
        if "not at rest" not in str(error):
            raise
        return False
    return True


def test_the_force_sensor_is_zeroed_at_rest_only(controller: URController, arm: UR5e) -> None:
    arm.move_linear(HOME.translated(z_m=-0.02), 0.25, 1.0).wait(5.0)
    with pytest.raises(DeviceError, match="not at rest"):
        arm.zero_force_sensor()
    until(lambda: at_rest(arm))
    assert np.linalg.norm(arm.state().wrench[:3]) < 0.6


def test_samples_are_dated_on_the_rigs_clock(arm: UR5e) -> None:
    dates = [arm.state().time_ns for _ in range(2000)]
    assert dates == sorted(dates)
    assert 0 <= time.monotonic_ns() - arm.state().time_ns < 200_000_000
    assert arm.counters()["samples"] > 0
    assert arm.clock_offset_s() < 0.0


def test_everything_but_the_arm_runs_without_its_library(
    monkeypatch: pytest.MonkeyPatch, controller: URController
) -> None:
    monkeypatch.setattr("drivers.ur5e.link.importlib.util.find_spec", lambda name: None)
    with pytest.raises(DeviceError, match="ur-rtde is not installed"):
        make_arm(controller.host).connect()
