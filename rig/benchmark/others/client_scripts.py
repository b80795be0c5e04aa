"""What each client is asked to do, as a user's script would; each prints its figures as JSON.

A script gets the controller's address, then the gripper's host and port, then the folder of a clone.
"""

_START = """
import json, sys, time
host, gripper_host, gripper_port, clone = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
def reads(read, expected, limit_s=8.0):
    give_up = time.monotonic() + limit_s
    while not expected(read()) and time.monotonic() < give_up:
        time.sleep(0.02)
    return read()
def say(ok, **said):
    print("\\n" + json.dumps({"ok": bool(ok), **said}), flush=True)
    import os; os._exit(0)
"""

UR_RTDE = (
    _START
    + """
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
from dashboard_client import DashboardClient
receive, control, dashboard = RTDEReceiveInterface(host), RTDEControlInterface(host), DashboardClient(host)
dashboard.connect()
home = receive.getActualTCPPose()
low = home[:2] + [home[2] - 0.05] + home[3:]
moved = control.moveL(low, 0.5, 2.0)
down = reads(receive.getActualTCPPose, lambda pose: abs(pose[2] - low[2]) < 1e-5)[2] - home[2]
back = control.moveL(home, 0.5, 2.0)
dashboard.stop()
reads(control.isProgramRunning, lambda running: not running)
again = control.reuploadScript()
reads(control.isProgramRunning, bool)
ready = control.moveL(low, 0.5, 2.0)
say(moved and back and again and ready and abs(down + 0.05) < 1e-4,
    result=f"moveL by {1e3 * down:.2f} mm and back; stopped, uploaded again, moved again")
"""
)

URX = (
    _START
    + """
import logging
logging.disable(logging.CRITICAL)
if clone:
    sys.path.insert(0, clone)
# urx.Robot is the same over math3d, whose newer versions it does not know
from urx.urrobot import URRobot
robot = URRobot(host, use_rt=True, **({"urFirm": 5.11} if clone else {}))
home = robot.getl()
low = [*home[:2], home[2] - 0.03, *home[3:]]
# Not waited for by urx: 0.11.0 takes every state of PolyScope 5 for one of a robot that is off, the newest
# takes a tool that looks straight down (a turn by pi, or by minus pi) for far away.
robot.movel(low, acc=0.5, vel=0.2, wait=False)
down = reads(robot.getl, lambda pose: abs(pose[2] - low[2]) < 1e-4)[2] - home[2]
robot.send_program("set_digital_out(1, True)")  # its own set_digital_out writes digital_out[1], of CB2
output = reads(lambda: robot.get_digital_out(1), bool)
joints, real_time = robot.getj(), reads(lambda: robot.rtmon.getActual(False), lambda seen: seen is not None)
# 0.11.0 reads outputs of PolyScope 5 at the places of CB2, the newest no states of 30003 newer than 5.9
say(abs(down + 0.03) < 1e-3 and len(joints) == 6 and (output if clone else real_time is not None),
    result=f"movel by {1e3 * down:.2f} mm, joints and pose read on 30002; "
    + ("an output set and read" if clone else "joints read on 30003"))
"""
)

URKIT = (
    _START
    + """
import os, tempfile
os.chdir(tempfile.mkdtemp())
import urkit
robot = urkit.URRobot(host, points="points.db")
pose = robot.rtde_receive.getActualTCPPose
home = pose()
robot.move_relative(dz=-0.03)
down = reads(pose, lambda at: abs(at[2] - home[2] + 0.03) < 1e-3)[2] - home[2]
robot.set_digital_output(2, True)
output = reads(lambda: robot.get_digital_output(2), bool)
say(abs(down + 0.03) < 1e-3 and output,
    result=f"moved by {1e3 * down:.2f} mm, an output set and read")
"""
)

UR_CLIENTS = (
    _START
    + """
import universal_robots_clients.dashboard_client as dashboard
import universal_robots_clients.rtde_client as rtde
mode, program = dashboard.send_command(host, "robotmode"), dashboard.get_program_state(host)
client = rtde.connect(host)
joints, robot_mode = rtde.read_actual_joint_positions(client=client), rtde.read_robot_mode(client=client)
rtde.write_speed_slider_fraction(0.5, client=client)
slider = reads(lambda: rtde.read_speed_slider_fraction(client=client), lambda value: abs(value - 0.5) < 1e-6)
rtde.write_speed_slider_fraction(1.0, client=client)
say("RUNNING" in mode and program and len(joints) == 6 and robot_mode == 7 and abs(slider - 0.5) < 1e-6,
    result=f"{mode}, program {program}; joints and modes read, speed slider written and read")
"""
)

RECORD = (
    _START
    + """
import csv, os, subprocess, tempfile
output = os.path.join(tempfile.mkdtemp(), "robot_data.csv")
command = [sys.executable, "record.py", "--host", host, "--samples", "500", "--frequency", "125"]
command += ["--output", output]
started = time.monotonic()
examples = os.path.join(clone, "examples")
done = subprocess.run(command, cwd=examples, capture_output=True, text=True, timeout=60)
rows = list(csv.reader(open(output), delimiter=" ")) if os.path.exists(output) else []
took = time.monotonic() - started
columns = len(rows[0]) if rows else 0
say(done.returncode == 0 and len(rows) in (500, 501),
    result=f"{len(rows) - 1} samples of {columns} columns in {took:.1f} s {done.stderr[-120:]}")
"""
)

CONTROL_LOOP = (
    _START
    + """
import os, re, subprocess, threading, socket
folder = os.path.join(clone, "examples")
program = '''def loop():
  while True:
    write_output_integer_register(0, 1)
    while read_input_integer_register(0) == 0:
      sync()
    end
    write_output_integer_register(0, 0)
    while read_input_integer_register(0) == 1:
      sync()
    end
  end
end
'''
with socket.create_connection((host, 30002)) as primary:
    primary.sendall(program.encode())
    time.sleep(1.0)
    source = open(os.path.join(folder, "example_control_loop.py")).read().replace('"localhost"', repr(host))
    process = subprocess.Popen([sys.executable, "-u", "-c", source], cwd=folder, stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True)
    time.sleep(4.0)
    process.kill()
    said = process.communicate()[0]
poses = said.count("New pose")
say(poses >= 3 and "Traceback" not in said,
    result=f"{poses} set points taken in 4 s {said[-80:] if poses < 3 else ''}")
"""
)

CPP_RTDE = (
    _START
    + """
import os, subprocess
program = os.path.join(clone, "build", "examples", "rtde_client_example")
os.environ["LD_LIBRARY_PATH"] = os.path.join(clone, "build")
done = subprocess.run([program, host, "4"], cwd=clone, capture_output=True, text=True, timeout=60)
say(done.returncode == 0 and "target_speed_fraction" in done.stdout,
    result=f"exit {done.returncode} after 4 s"
    + ("" if done.returncode == 0 else (done.stdout + done.stderr)[-200:]))
"""
)

CPP_DASHBOARD = (
    _START
    + """
import os, subprocess
program = os.path.join(clone, "build", "examples", "dashboard_example")
os.environ["LD_LIBRARY_PATH"] = os.path.join(clone, "build")
done = subprocess.run([program, host], cwd=clone, capture_output=True, text=True, timeout=120)
say(done.returncode == 0, result=f"exit {done.returncode}"
    + ("" if done.returncode == 0 else (done.stdout + done.stderr)[-160:]))
"""
)

PYMODBUS_TCP = (
    _START
    + """
from pyModbusTCP.client import ModbusClient
client = ModbusClient(gripper_host, gripper_port, unit_id=9, timeout=2.0)
client.write_multiple_registers(0, [0x0100, 0, 0])
ready = reads(lambda: client.read_input_registers(0, 1), lambda seen: seen and seen[0] == 0x3100, 20.0)
client.write_multiple_registers(0, [0x0900, 0x0030, 0xFFFF])
there = reads(lambda: client.read_input_registers(0, 3), lambda seen: seen and seen[0] >> 14 == 3)
say(ready == [0x3100] and there[1] & 0xFF == 0x30,
    result=f"activated, at 0x30: status {there[0]:04X}, fault {there[1] >> 8}")
"""
)

ROBOTIQ3F_PY = (
    _START
    + """
sys.path.insert(0, clone)
from robotiqcontrol.GripperController import GripperController
gripper = GripperController(gripper_host, port=gripper_port)
gripper.activate()
fault = gripper.FaultStatus
reads(lambda: gripper.gIMC, lambda seen: seen == 3, 20.0)
gripper.command_gripper(rPRA=[60] * 3, rSP=[250] * 3, rFR=[250] * 3, rMOD="Pinch", rICF=False)
reads(lambda: gripper.gMOD, lambda seen: seen == "Pinch Mode", 10.0)
at = reads(lambda: gripper.FingerA_Position, lambda seen: seen == 60, 15.0)
say(at == 60 and gripper.FaultStatus == 0,
    result=f"rACT with rGTO: fault {fault} while activating, {gripper.FaultStatus} after; pinch, at {at}")
"""
)

ROS_3F = (
    _START
    + """
import os, types
fields = ("rACT rMOD rGTO rATR rGLV rICF rICS rPRA rSPA rFRA "
          "rPRB rSPB rFRB rPRC rSPC rFRC rPRS rSPS rFRS").split()
package, messages = (types.ModuleType(n) for n in ("robotiq_3f_gripper_articulated_msgs", "x"))
class Answer:
    pass
messages.Robotiq3FGripperRobotInput = Answer
sys.modules[package.__name__], sys.modules[package.__name__ + ".msg"] = package, messages
sys.path.insert(0, os.path.join(clone, "robotiq_3f_gripper_control", "src", "robotiq_3f_gripper_control"))
from baseRobotiq3FGripper import robotiqbaseRobotiq3FGripper
from pymodbus.client import ModbusTcpClient
class Master:
    "What comModbusTcp.py does, of this pymodbus; its own is of one from before Python 3."
    def __init__(self):
        self.link = ModbusTcpClient(gripper_host, port=gripper_port)
        self.link.connect()
    def sendCommand(self, data):
        data = list(data) + [0] * (len(data) % 2)
        self.link.write_registers(0, [(a << 8) + b for a, b in zip(data[::2], data[1::2])], device_id=9)
    def getStatus(self, count):
        seen = self.link.read_input_registers(0, count=(count + 1) // 2, device_id=9).registers
        return [byte for word in seen for byte in (word >> 8, word & 255)]
gripper = robotiqbaseRobotiq3FGripper()
gripper.client = Master()
def command(**wanted):
    asked = types.SimpleNamespace(**{name: wanted.get(name, 0) for name in fields})
    gripper.refreshCommand(asked)
    gripper.sendCommand()
command()
time.sleep(0.3)
command(rACT=1, rGTO=1, rSPA=255, rFRA=150)
time.sleep(0.5)
fault = gripper.getStatus().gFLT
reads(lambda: gripper.getStatus().gIMC, lambda seen: seen == 3, 20.0)
command(rACT=1, rGTO=1, rSPA=255, rFRA=150, rPRA=80)
at = reads(lambda: gripper.getStatus().gPOA, lambda seen: seen == 80, 15.0)
say(at == 80 and gripper.getStatus().gFLT == 0,
    result=f"ROS-style activation: fault {fault} until it is over, then 0; at {at}")
"""
)
