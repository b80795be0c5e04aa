"""Scripts of users with the real client of ur-rtde on the simulated controller.

A script runs in its own process: the constructors of the client hold the interpreter lock, and the controller
is in this process. `pause` waits on the controller's slow clock.
"""

import json
import logging
import subprocess
from typing import Any

import pytest

from fakes.wire.ur.controller import URController
from support.marks import heavy, require_ur_rtde
from support.ur5e import running
from support.waiting import until

require_ur_rtde()
HEAD = """
import json, sys, time
from dashboard_client import DashboardClient
from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
host, slowness = sys.argv[1], int(sys.argv[2])
receive, control = RTDEReceiveInterface(host), RTDEControlInterface(host)
home, q = receive.getTargetTCPPose(), receive.getTargetQ()
low = home[:2] + [home[2] - 0.05] + home[3:]
results = {}
def pause(duration_s):
    time.sleep(duration_s * slowness)
def wait_until(condition, limit_s=5.0):
    end = time.monotonic() + limit_s * slowness
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    return condition()
def height():
    return receive.getTargetTCPPose()[2] - home[2]
def joint_1():
    return receive.getTargetQ()[0] - q[0]
def still():
    return max(map(abs, receive.getActualQd())) == 0.0
def off(joints):
    return max(abs(a - b) for a, b in zip(receive.getTargetQ(), joints))
def reupload():
    return control.reuploadScript() and wait_until(control.isProgramRunning)
"""


def results(controller: URController, script: str) -> dict[str, Any]:
    """Run a script and return its `results`."""
    code = f"{HEAD}{script}\nprint(json.dumps(results))\n"
    with running(code, controller, stderr=subprocess.PIPE) as process:
        output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return json.loads(output.splitlines()[-1])


CALLS = {
    "motions": """
results["moveL"], results["low_m"] = control.moveL(low, 1.0, 10.0), wait_until(lambda: height() < -0.04999)
turned = [q[0] + 0.1] + q[1:]
results["moveJ"], results["turned"] = control.moveJ(turned, 3.0, 20.0), wait_until(lambda: off(turned) < 1e-6)
results["moveJ_IK"], results["home"] = control.moveJ_IK(home, 3.0, 20.0), wait_until(lambda: off(q) < 1e-6)
results["zeroFtSensor"] = control.zeroFtSensor()
results["path"] = control.moveJ([turned + [3.0, 20.0, 0.0], q + [3.0, 20.0, 0.0]])
results["path_l"] = control.moveL([low + [1.0, 10.0, 0.0], home + [1.0, 10.0, 0.0]])
results["home_after_path"] = wait_until(lambda: off(q) < 1e-4)  # the client sends six digits
""",
    "stops": """
for stop in ("stopL", "stopJ"):
    control.moveL(low, 0.02, 1.2, True)
    wait_until(lambda: height() < -0.001)
    getattr(control, stop)(5.0)
    results[stop] = wait_until(still) and -0.045 < height() < -0.0005
    control.moveJ(q, 3.0, 20.0)
control.moveJ([q[0] + 0.2] + q[1:], 0.1, 1.4, True)
wait_until(lambda: joint_1() > 0.01)
results["running"] = control.getAsyncOperationProgressEx().isAsyncOperationRunning()
control.stopJ(5.0)
results["stopped"] = wait_until(still) and 0.01 < joint_1() < 0.19
control.moveJ(q, 3.0, 20.0)
""",
    "servo": """
start, target, sent = receive.getTimestamp(), list(q), []
while (t := receive.getTimestamp() - start) < 0.4:
    target[0] = q[0] + 0.1 * t
    sent.append(control.servoJ(target, 0.5, 0.5, 0.008, 0.1, 300))
    pause(0.004)
results["sent"] = all(sent)
results["lag"] = abs(joint_1() - (target[0] - q[0])) < 0.03
results["reached"] = wait_until(lambda: off(target) < 1e-4)
results["program_runs"] = control.isProgramRunning()
results["servoStop"] = control.servoStop(10.0)
results["servo_still"] = wait_until(still)
results["servo_home"] = control.moveJ(q, 3.0, 20.0) and wait_until(lambda: off(q) < 1e-6)
control.servoJ(q, 0.5, 0.5, 0.3, 0.1, 300)
pause(0.05)
control.servoJ([q[0] + 0.1] + q[1:], 0.5, 0.5, 0.3, 0.1, 300)
pause(0.1)
results["new_target_waits_for_the_time_of_the_old_one"] = joint_1() == 0.0
results["new_target_is_reached"] = wait_until(lambda: joint_1() > 0.09)
control.servoStop()
control.moveJ(q, 3.0, 20.0)
""",
    "speed": """
def speed():
    return max(abs(receive.getActualTCPSpeed()[2]) / 0.05, abs(receive.getActualQd()[0]) / 0.1)
for name, call in (("speedL", lambda: control.speedL([0, 0, -0.05, 0, 0, 0], 0.5)),
                   ("speedJ", lambda: control.speedJ([0.1, 0, 0, 0, 0, 0], 0.5))):
    results[name] = call() and wait_until(lambda: abs(speed() - 1.0) < 1e-3)
    pause(0.1)
    results[name + " kept"] = abs(speed() - 1.0) < 1e-3
    results[name + " stop"] = control.speedStop(10.0)
    results[name + " still"] = wait_until(still) and -0.1 < height() and joint_1() < 0.3
    results[name + " home"] = control.moveJ(q, 3.0, 20.0)
""",
    "inverse kinematics": """
near, far = [angle + 0.01 for angle in q], [2.0, 0, 0, 0, 0, 0]
for name, joints in (("alone", control.getInverseKinematics(home)),
                     ("near", control.getInverseKinematics(home, near))):
    results[name] = off(joints) < 1e-9
results["solution"] = control.getInverseKinematicsHasSolution(home)
results["solution_near"] = control.getInverseKinematicsHasSolution(home, near)
results["none"] = not control.getInverseKinematicsHasSolution(far)
results["program"] = control.isProgramRunning()
results["far"] = control.getInverseKinematics(far) == []
results["ended"] = wait_until(lambda: not control.isProgramRunning())
results["uploaded_again"] = reupload()
""",
    "protective stop": """
dashboard = DashboardClient(host)
dashboard.connect()
control.moveL(low, 0.02, 1.2, True)
wait_until(lambda: height() < -0.001)
results["triggered"] = control.triggerProtectiveStop()
results["stopped"] = wait_until(receive.isProtectiveStopped) and wait_until(still) and height() > -0.045
results["refused"] = not control.moveL(home)
pause(0.6)
dashboard.unlockProtectiveStop()
results["released"] = wait_until(lambda: not receive.isProtectiveStopped())
results["program_restarted"] = not control.isProgramRunning() and reupload()
results["moves"] = control.moveL(home, 1.0, 10.0)
""",
}
"""Scripts whose `results` are all True, and which end with the arm at home."""


@pytest.mark.heavy
@pytest.mark.parametrize(
    "names", [("motions", "stops", "servo", "speed"), ("inverse kinematics", "protective stop")]
)
def test_calls_of_scripts_are_simulated(controller: URController, names: tuple[str, ...]) -> None:
    read = results(controller, "".join(CALLS[name] for name in names))
    assert all(value is True for value in read.values()), json.dumps(read)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        ("control.forceMode([0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -5, 0, 0, 0], 2, [1] * 6)", "forceMode"),
        ("control.jogStart([0, 0, 0.02, 0, 0, 0])", "jogStart"),
        (
            "control.sendCustomScriptFunction('lamp', 'set_standard_digital_out(1, True)')",
            "write_output_integer_register",
        ),
        *heavy(
            ("control.servoC(low, 0.1, 0.5, 0.01)", "servoC"),
            ("control.moveUntilContact([0, 0, -0.1, 0, 0, 0])", "moveUntilContact"),
            ("control.poseTrans(home, low)", "poseTrans"),
        ),
    ],
)
def test_call_that_is_not_simulated_ends_the_program_and_is_named(
    controller: URController, caplog: pytest.LogCaptureFixture, call: str, name: str
) -> None:
    # it is killed, because some calls wait forever for an answer of their program
    with caplog.at_level(logging.WARNING), running(HEAD + call, controller, stderr=subprocess.DEVNULL):
        until(lambda: f"program ends: {name}" in caplog.text.replace("'", ""))
    assert "not simulated" in caplog.text
    until(lambda: not controller.snapshot()["program_running"])


def test_requests_and_outputs_that_are_not_simulated_are_named(
    controller: URController, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        read = results(
            controller,
            """
dashboard, io = DashboardClient(host), RTDEIOInterface(host)
dashboard.connect()
try:
    dashboard.loadURP("pick.urp")
except Exception as error:
    results["refused"] = str(error)
io.setSpeedSlider(0.5)
results["slider"] = wait_until(lambda: receive.getTargetSpeedFraction() == 0.5)
io.setStandardDigitalOut(2, True)
pause(0.1)
""",
        )
    assert read["slider"]
    assert "load pick.urp" in caplog.text
    assert "standard_digital_output" in caplog.text
    assert "speed_slider" not in caplog.text


@pytest.mark.parametrize(
    "start",
    [
        "servoJ(q, 0.5, 0.5, 0.008, 0.1, 300)",
        "moveL(low, 0.02, 1.2, True)",
        *heavy("speedL([0, 0, -0.01, 0, 0, 0])"),
    ],
)
def test_motion_beside_another_one_ends_the_program(
    controller: URController, caplog: pytest.LogCaptureFixture, start: str
) -> None:
    other = "servoJ(q, 0.5, 0.5, 0.008, 0.1, 300)" if "move" in start else "moveJ(q)"
    with caplog.at_level(logging.WARNING):
        read = results(
            controller,
            f"""
control.{start}
pause(0.1)
control.{other}
results["ended"] = wait_until(lambda: receive.getRuntimeState() == 1)
""",
        )
    assert read == {"ended": True}
    assert "already controls the arm" in caplog.text
