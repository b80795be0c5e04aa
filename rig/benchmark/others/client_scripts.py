"""The scripts of the foreign clients, as a user would write them. Each prints its result as JSON.

Arguments of a script: the controller's address, the gripper's host and port, and the folder of a clone.
"""

_START = """
import json, sys, time
host, gripper_host, gripper_port, clone = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4]
def reads(read, expected, limit_s=8.0):
    give_up = time.monotonic() + limit_s
    while not expected(read()) and time.monotonic() < give_up:
        time.sleep(0.02)
    return read()
def report(ok, **figures):
    print("\\n" + json.dumps({"ok": bool(ok), **figures}), flush=True)
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
report(moved and back and again and ready and abs(down + 0.05) < 1e-4,
    result=f"moveL by {1e3 * down:.2f} mm and back; stopped, uploaded again, moved again")
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
report(done.returncode == 0 and len(rows) in (500, 501),
    result=f"{len(rows) - 1} samples of {columns} columns in {took:.1f} s {done.stderr[-120:]}")
"""
)

REGISTERS = (
    _START
    + """
sys.path.insert(0, clone)
import rtde.rtde as rtde
connection = rtde.RTDE(host)
connection.connect()
version = ".".join(map(str, connection.get_controller_version()[:2]))
inputs = ["speed_slider_mask", "speed_slider_fraction", "input_int_register_0"]
outputs = ["target_speed_fraction", "input_int_register_0"]
command = connection.send_input_setup(inputs, ["UINT32", "DOUBLE", "INT32"])
ready = connection.send_output_setup(outputs, ["DOUBLE", "INT32"], 125) and connection.send_start()
command.speed_slider_mask, read_back = 1, 0
for number in range(1, 101):
    command.speed_slider_fraction, command.input_int_register_0 = number / 100, number
    connection.send(command)
    state = reads(connection.receive, lambda now: now.input_int_register_0 == number)
    read_back += abs(state.target_speed_fraction - number / 100) < 1e-9
report(ready and read_back == 100,
    result=f"version {version}: register and speed slider written and read back {read_back} of 100 times")
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
report(ready == [0x3100] and there[1] & 0xFF == 0x30,
    result=f"activated, at 0x30: status {there[0]:04X}, fault {there[1] >> 8}")
"""
)
