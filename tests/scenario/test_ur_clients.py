"""The real ur_rtde interfaces, used as a user's own script would, on the simulated controller.

The script runs in a process of its own: the library's constructors keep the interpreter to
themselves, and the controller lives in this one.
"""

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator

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
from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
host = sys.argv[1]
said = {}
def settle():
    time.sleep(0.05)
"""
MOTIONS = """
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
home, q = receive.getActualTCPPose(), receive.getActualQ()
low = home[:2] + [home[2] - 0.05] + home[3:]
said["moveL"] = control.moveL(low, 0.5, 2.0)
settle()
said["low_m"] = receive.getActualTCPPose()[2] - home[2]
said["moveJ"] = control.moveJ(q, 1.5, 3.0)
settle()
said["joints_off"] = max(abs(a - b) for a, b in zip(receive.getActualQ(), q))
said["asynchronous"] = control.moveL(low, 0.05, 0.5, True)
settle()
said["running"] = control.getAsyncOperationProgressEx().isAsyncOperationRunning()
control.stopL(5.0, True)
settle()
said["stopped"] = not control.getAsyncOperationProgressEx().isAsyncOperationRunning()
said["path"] = control.moveL([home + [0.5, 2.0, 0.0], low + [0.5, 2.0, 0.0]])
target = receive.getActualQ()
for _ in range(250):
    cycle = control.initPeriod()
    target[0] += 0.0005
    assert control.servoJ(target, 0.0, 0.0, 0.002, 0.05, 300)
    control.waitPeriod(cycle)
time.sleep(0.5)
said["servo_off"] = abs(receive.getActualQ()[0] - target[0])
said["servoStop"] = control.servoStop()
"""
OTHER_MOTIONS = """
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
home, q = receive.getActualTCPPose(), receive.getActualQ()
low = home[:2] + [home[2] - 0.05] + home[3:]
def speed():
    time.sleep(0.3)
    return receive.getActualTCPSpeed()[2]
said["moveJ_IK"], said["moveL_FK"] = control.moveJ_IK(low, 1.5, 3.0), control.moveL_FK(q, 0.5, 2.0)
said["moveJ path"] = control.moveJ([q + [1.0, 2.0, 0.01], q + [1.0, 2.0, 0.0]])
path = Path()
poses = ("MoveJ", "PositionTcpPose", low), ("MoveL", "PositionTcpPose", home)
for kind, place, to in (*poses, ("MoveJ", "PositionJoints", q)):
    path.addEntry(PathEntry(getattr(PathEntry, kind), getattr(PathEntry, place), to + [0.5, 1.0, 0.0]))
said["movePath"] = control.movePath(path)
said["speedL"], said["speedL_m_s"] = control.speedL([0, 0, -0.05, 0, 0, 0], 0.5), speed()
said["speedL ends"] = control.speedStop()
said["speedJ"] = control.speedJ([0.1, 0, 0, 0, 0, 0], 0.5, 0.2)
said["speedJ ends"] = control.speedStop()
said["jogStart"], said["jog_m_s"] = control.jogStart([0, 0, 0.02, 0, 0, 0], control.FEATURE_TOOL), speed()
said["jogStop"] = control.jogStop()
said["servoL"], _ = control.servoL(low, 0, 0, 0.002, 0.1, 300), time.sleep(0.5)
said["servoL ends"] = control.servoStop()
said["freedrive"] = control.freedriveMode() and control.endFreedriveMode()
said["force mode"] = control.forceMode([0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [1] * 6)
said["force mode ends"] = control.forceModeStop()
said["moveUntilContact"] = control.moveUntilContact([0, 0, -0.2, 0, 0, 0], [0, 0, -1, 0, 0, 0], 0.5)
settle()
said["floor_m"] = receive.getActualTCPPose()[2]
said["home again"] = control.moveJ(q)
"""
PENDANT = """
receive, control, dashboard = RTDEReceiveInterface(host), RTDEControlInterface(host), DashboardClient(host)
dashboard.connect()
pose = receive.getActualTCPPose()
dashboard.pause(); settle()
said["paused"] = control.isProgramRunning()
dashboard.play(); settle()
said["played"] = control.moveL(pose)
dashboard.stop(); settle()
said["stopped"] = control.moveL(pose)
said["reuploaded"] = control.reuploadScript()
time.sleep(0.2)
said["moves"] = control.moveL(pose)
dashboard.powerOff(); time.sleep(0.2)
said["off"] = receive.getRobotMode()
dashboard.powerOn(); time.sleep(2.5); dashboard.brakeRelease(); time.sleep(1.5)
said["on"] = receive.getRobotMode()
"""
CALCULATIONS = """
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
pose = receive.getActualTCPPose()
solution = control.getInverseKinematics(pose, receive.getActualQ())
back = control.getForwardKinematics(solution, control.getTCPOffset())
said["kinematics_off"] = max(abs(a - b) for a, b in zip(back[:3], pose[:3]))
said["reach"] = [control.isPoseWithinSafetyLimits(p) for p in (pose, [2, 0, 0, 0, 0, 0])]
said["zero"] = control.zeroFtSensor()
settle()
said["force"] = max(map(abs, receive.getActualTCPForce()[:3]))
said["payload"] = [control.setPayload(1.2, [0, 0, 0.05]), settle(), receive.getPayload()]
said["trans"] = control.poseTrans([1, 2, 3, 0, 0, 0], [0.5, 0, 0, 0, 0, 0])[:3]
said["script"] = control.sendCustomScriptFunction("lamp", "set_standard_digital_out(1, True)")
settle()
said["outputs"] = receive.getActualDigitalOutputBits()
io = RTDEIOInterface(host)
said["io"] = [io.setStandardDigitalOut(2, True), io.setSpeedSlider(0.5)]
settle()
said["outputs_then"], said["slider"] = receive.getActualDigitalOutputBits(), receive.getTargetSpeedFraction()
"""
PROTECTIVE = """
receive, control, dashboard = RTDEReceiveInterface(host), RTDEControlInterface(host), DashboardClient(host)
dashboard.connect()
pose = receive.getActualTCPPose()
control.triggerProtectiveStop()
settle()
said["stopped"] = receive.isProtectiveStopped()
said["moved"] = control.moveL(pose)
try:
    dashboard.unlockProtectiveStop()
    said["too early"] = "released"
except RuntimeError as error:
    said["too early"] = str(error)
time.sleep(0.6)
dashboard.closeSafetyPopup()
dashboard.unlockProtectiveStop()
settle()
said["then"] = receive.isProtectiveStopped()
said["uploaded"] = control.reuploadScript()
settle()
said["moves again"] = control.moveL(pose)
said["modes"] = [dashboard.robotmode(), dashboard.safetymode(), dashboard.running()]
said["remote"] = dashboard.isInRemoteControl()
control.stopScript()
said["running"] = control.isProgramRunning()
"""
_addresses = itertools.count(1)


def make(version: str) -> URController:
    pid = os.getpid()
    host = f"127.{150 + pid % 50}.{pid // 50 % 250}.{next(_addresses)}"
    home = Pose.from_rotation((0.45, 0.0, 0.3), Rotation.from_euler("x", 180, degrees=True))
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), home), seed=1)
    return URController(world, SimulatedClock(realtime=True), host, version, release_after_s=0.5)


@pytest.fixture(params=["5.11.0", "5.25.0"])
def controller(request: pytest.FixtureRequest) -> Iterator[URController]:
    controller = make(request.param)
    controller.start()
    yield controller
    controller.stop()


def start(script: str, host: str) -> subprocess.Popen[str]:
    # the library's destructors take half a second each and have nothing to do with what is tested
    ending = "\nprint(json.dumps(said), flush=True)\nimport os; os._exit(0)\n"
    command = [sys.executable, "-c", PREAMBLE + script + ending, host]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> dict:
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return json.loads(out.splitlines()[-1])


def test_motions(controller: URController) -> None:
    said = finish(start(MOTIONS, controller.host))
    for call in ("moveL", "moveJ", "asynchronous", "running", "stopped", "path", "servoStop"):
        assert said[call] is True, call
    assert said["low_m"] == pytest.approx(-0.05, abs=1e-6)
    assert said["joints_off"] < 1e-6
    assert said["servo_off"] < 0.002


def test_the_other_motions(controller: URController) -> None:
    said = finish(start(OTHER_MOTIONS, controller.host))
    assert said.pop("speedL_m_s") == pytest.approx(-0.05, abs=1e-6)
    assert said.pop("jog_m_s") == pytest.approx(-0.02, abs=1e-6), "the tool looks down"
    assert said.pop("floor_m") == pytest.approx(0.0, abs=0.002)
    assert {call for call, value in said.items() if value is not True} == set()


def test_what_a_person_does_at_the_pendant(controller: URController) -> None:
    said = finish(start(PENDANT, controller.host))
    assert (said["paused"], said["played"], said["stopped"]) == (False, True, False)
    assert said["reuploaded"]
    assert said["moves"]
    assert (said["off"], said["on"]) == (3, 7)


def test_calculations_sensors_and_outputs(controller: URController) -> None:
    said = finish(start(CALCULATIONS, controller.host))
    assert said["kinematics_off"] < 1e-6
    assert said["reach"] == [True, False]
    assert said["zero"] is True
    assert said["force"] < 0.6
    assert said["payload"] == [True, None, 1.2]
    assert said["trans"] == pytest.approx([1.5, 2, 3])
    assert said["script"] is True
    assert (said["outputs"], said["outputs_then"], said["slider"]) == (2, 6, 0.5)


def test_a_protective_stop_and_the_way_out_of_it(controller: URController) -> None:
    said = finish(start(PROTECTIVE, controller.host))
    assert (said["stopped"], said["moved"], said["then"]) == (True, False, False)
    assert "5s" in said["too early"]
    assert said["uploaded"]
    assert said["moves again"]
    assert said["modes"] == ["Robotmode: RUNNING", "Safetymode: NORMAL", True]
    assert said["remote"] is True
    assert said["running"] is False


def test_two_controllers_at_once(controller: URController) -> None:
    other = make("5.11.0")
    other.start()
    try:
        for said in map(finish, [start(MOTIONS, controller.host), start(MOTIONS, other.host)]):
            assert said["low_m"] == pytest.approx(-0.05, abs=1e-6)
    finally:
        other.stop()
