"""Scripts that use ur-rtde on the simulated controller.

Each script runs in its own process: the constructors of the library hold the interpreter lock, and the
controller runs in this process.
"""

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.clock import SimulatedClock
from fakes.wire.ur.controller import URController
from fakes.world.world import BenchLayout, World

pytest.importorskip("rtde_control", reason="ur-rtde is not installed here")
pytestmark = pytest.mark.real_time

PREAMBLE = """
import json, sys, time
from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
host = sys.argv[1]
said = {}
def reads(read, expected, limit_s=5.0):
    "Read until the value is as expected or the time is over; return the last value."
    give_up = time.monotonic() + limit_s
    while not expected(read()) and time.monotonic() < give_up:
        time.sleep(0.005)
    return read()
def near(target, tolerance):
    return lambda value: abs(value - target) < tolerance
"""
MOTIONS = """
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
home = receive.getActualTCPPose()
low = home[:2] + [home[2] - 0.05] + home[3:]
def lowered():
    return receive.getActualTCPPose()[2] - home[2]
def running():
    return control.getAsyncOperationProgressEx().isAsyncOperationRunning()
said["moveL"] = control.moveL(low, 0.5, 2.0)
said["low_m"] = reads(lowered, near(-0.05, 1e-6))
said["back"] = control.moveL(home, 0.5, 2.0)
said["asynchronous"] = control.moveL(low, 0.05, 0.5, True)
said["running"] = reads(running, bool)
control.stopL(5.0, True)
said["stopped"] = not reads(running, lambda still: not still)
"""
PENDANT = """
receive, control, dashboard = RTDEReceiveInterface(host), RTDEControlInterface(host), DashboardClient(host)
dashboard.connect()
pose, runs = receive.getActualTCPPose(), control.isProgramRunning
said["modes"] = [dashboard.robotmode(), dashboard.safetymode(), dashboard.running()]
said["remote"] = dashboard.isInRemoteControl()
dashboard.stop()
reads(runs, lambda value: not value)
said["stopped"] = control.moveL(pose)
said["reuploaded"], said["moves at once"] = control.reuploadScript(), control.moveL(pose)
reads(runs, bool)
said["moves"] = control.moveL(pose)
control.stopScript()
said["running"] = runs()
"""
CALCULATIONS = """
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
pose, q = receive.getActualTCPPose(), receive.getActualQ()
said["joints_off"] = max(abs(a - b) for a, b in zip(control.getInverseKinematics(pose, q), q))
said["reach"] = [control.isPoseWithinSafetyLimits(p) for p in (pose, [2, 0, 0, 0, 0, 0])]
said["zero"] = control.zeroFtSensor()
said["force"] = reads(lambda: max(map(abs, receive.getActualTCPForce()[:3])), lambda force: force < 0.6)
said["payload"] = [control.setPayload(1.2, [0, 0, 0.05]), reads(receive.getPayload, near(1.2, 1e-9))]
io = RTDEIOInterface(host)
said["io"] = io.setSpeedSlider(0.5)
said["slider"] = reads(receive.getTargetSpeedFraction, near(0.5, 1e-9))
"""
VERSIONS = ("5.11.0", "5.25.0")
_addresses = itertools.count(1)


def make(version: str) -> URController:
    pid = os.getpid()
    host = f"127.{150 + pid % 50}.{pid // 50 % 250}.{next(_addresses)}"
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1)
    return URController(world, SimulatedClock(realtime=True), host, version, release_after_s=0.5)


@contextmanager
def started(versions: Sequence[str]) -> Iterator[list[URController]]:
    """Controllers of these versions, side by side."""
    controllers = [make(version) for version in versions]
    with ExitStack() as running:
        for controller in controllers:
            controller.start()
            running.callback(controller.stop)
        yield controllers


def start(script: str, host: str) -> "subprocess.Popen[str]":
    # the library's destructors take half a second each and have nothing to do with what is tested
    ending = "\nprint(json.dumps(said), flush=True)\nimport os; os._exit(0)\n"
    command = [sys.executable, "-c", PREAMBLE + script + ending, host]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: "subprocess.Popen[str]") -> dict[str, Any]:
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return json.loads(out.splitlines()[-1])


@cache
def said_by(script: str, versions: Sequence[str]) -> list[dict[str, Any]]:
    """What a script says of controllers that run at once; they wait for their arms more than they work."""
    with started(versions) as controllers:
        processes = [start(script, controller.host) for controller in controllers]
        return [finish(process) for process in processes]


@pytest.fixture(params=range(len(VERSIONS)), ids=VERSIONS)
def said(request: pytest.FixtureRequest) -> Callable[[str], dict[str, Any]]:
    """What a script says of a controller of this version."""
    return lambda script: dict(said_by(script, VERSIONS)[request.param])


def test_motions_end_at_their_targets(said: Callable[[str], dict[str, Any]]) -> None:
    of = said(MOTIONS)
    for call in ("moveL", "back", "asynchronous", "running", "stopped"):
        assert of[call] is True, call
    assert of["low_m"] == pytest.approx(-0.05, abs=1e-6)


def test_program_is_stopped_and_uploaded_again(said: Callable[[str], dict[str, Any]]) -> None:
    of = said(PENDANT)
    assert of["modes"] == ["Robotmode: RUNNING", "Safetymode: NORMAL", True]
    assert of["remote"] is True
    assert not of["stopped"]
    assert of["reuploaded"]
    assert not of["moves at once"], "it is sent before the controller says that the program runs"
    assert of["moves"]
    assert of["running"] is False


def test_kinematics_force_payload_and_speed_slider(said: Callable[[str], dict[str, Any]]) -> None:
    of = said(CALCULATIONS)
    assert of["joints_off"] < 1e-6
    assert of["reach"] == [True, False]
    assert of["zero"] is True
    assert of["force"] < 0.6
    assert of["payload"] == [True, 1.2]
    assert (of["io"], of["slider"]) == (True, 0.5)
