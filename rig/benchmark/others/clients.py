"""Foreign clients on the simulated devices, on loopback: one process and one time limit each.

The scripts use each client as its users do, and print their result as JSON. Their arguments are
the controller's address, the gripper's host and port, and the folder of a clone.
"""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rig.bench.fakes_process import started_fakes
from rig.benchmark.harness import Run, column
from rig.config import BenchConfig, load_bench

LIMIT_S = 120.0
"""Longest duration of a foreign program."""
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


@dataclass(frozen=True, slots=True)
class Row:
    """One client or reader. met: whether the result is as expected; None if it was skipped."""

    part: str = column("part")
    what: str = column("what")
    version: str = column("version")
    result: str = column("result")
    met: bool | None = column("passed", lambda met: {True: "yes", False: "NO", None: ""}[met])


def skipped(part: str, what: str, reason: str) -> Row:
    """Return the row of a missing client or reader, with how to install it."""
    return Row(part, what, "", f"skipped: {reason}", None)


def installed(package: str) -> str | None:
    """Return the version of a package, None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def output(command: list[str]) -> tuple[int, str]:
    """Run a foreign program; return its exit code and the end of its output."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)  # noqa: S603
    return done.returncode, (done.stdout + done.stderr).strip()[-160:]


@dataclass(frozen=True, slots=True)
class Client:
    """A foreign client. It is a package of PyPI or else a repository, OWNER/NAME."""

    name: str
    script: str
    package: str = ""
    repository: str = ""


_UR_CLIENT = "UniversalRobots/RTDE_Python_Client_Library"
CLIENTS = (
    Client("ur-rtde: motions, upload again", UR_RTDE, "ur-rtde"),
    Client("UR's RTDE client: record.py", RECORD, repository=_UR_CLIENT),
    Client("UR's RTDE client: registers", REGISTERS, repository=_UR_CLIENT),
    Client("pyModbusTCP: the gripper", PYMODBUS_TCP, "pyModbusTCP"),
)


def run_clients(clones: Path | None, run: Run) -> list[Row]:
    """Return a row for each client. The fakes are started again for each, so that all find the same state."""
    return [_run(client, clones, run) for client in CLIENTS]


def _run(client: Client, clones: Path | None, run: Run) -> Row:
    clone = clones / client.repository if clones is not None and client.repository else None
    if client.package:
        found, how = installed(client.package), f"pip install {client.package}"
    else:
        url = f"https://github.com/{client.repository}"
        found, how = commit_of(clone), f"git clone {url} CLONES/{client.repository}, then --clones CLONES"
    if found is None:
        return skipped("clients", client.name, how)
    run.say(f"{client.name} {found}")
    with started_fakes(load_bench("wire")) as bench:
        ok, result = _run_script(client, bench, clone)
    return Row("clients", client.name, found, result, met=ok)


def commit_of(clone: Path | None) -> str | None:
    """Return the short commit of a clone, "unknown" without git or its folder, None without a clone."""
    if clone is None or not clone.is_dir():
        return None
    git = shutil.which("git")
    code, text = output([git, "-C", str(clone), "rev-parse", "--short=7", "HEAD"]) if git else (1, "")
    return "unknown" if code else text


def _run_script(client: Client, bench: BenchConfig, clone: Path | None) -> tuple[bool, str]:
    python = shutil.which("python", path=str(Path(sys.executable).parent)) or sys.executable
    where = [str(bench.arm.host), str(bench.gripper.host), str(bench.gripper.port), str(clone or "")]
    try:
        done = subprocess.run(  # noqa: S603 - our own scripts
            [python, "-P", "-c", client.script, *where],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"did not end within {LIMIT_S:.0f} s"
    report = _last_json(done.stdout)
    if report is None:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no output"]
        return False, f"exit {done.returncode}: {lines[-1][:160]}"
    return bool(report["ok"]), str(report["result"]).strip()


def _last_json(text: str) -> dict[str, Any] | None:
    for line in reversed(text.splitlines()):
        if line.startswith("{"):
            return json.loads(line)
    return None
