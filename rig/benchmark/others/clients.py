"""Other people's clients on the devices behind wires: a process for each, on loopback, bounded in time."""

import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.bench.fakes_process import started_fakes
from rig.benchmark.others import client_scripts as scripts
from rig.benchmark.others.rows import Row, Say, clone_of, commit_of, how_to_clone, installed, skipped
from rig.config import BenchConfig, load_bench

PART = "clients"
_LIMIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Client:
    """package: on PyPI, or repository: OWNER/NAME; needs: a file in its clone. script: what it does."""

    name: str
    script: str
    package: str = ""
    repository: str = ""
    needs: str = ""


_UR = "UniversalRobots"
CLIENTS = (
    Client("ur-rtde: motions, upload again", scripts.UR_RTDE, "ur-rtde"),
    Client("urx: ports 30002 and 30003", scripts.URX, "urx"),
    Client("python-urx, newest: the same", scripts.URX, repository="SintefManufacturing/python-urx"),
    Client("urkit: over ur-rtde", scripts.URKIT, "urkit"),
    Client("universal-robots-clients: dashboard, RTDE", scripts.UR_CLIENTS, "universal-robots-clients"),
    Client("UR's RTDE client, record.py", scripts.RECORD, repository=f"{_UR}/RTDE_Python_Client_Library"),
    Client(
        "UR's RTDE client, control loop", scripts.CONTROL_LOOP, repository=f"{_UR}/RTDE_Python_Client_Library"
    ),
    Client(
        "UR's C++ library, RTDE example", scripts.CPP_RTDE,
        repository=f"{_UR}/Universal_Robots_Client_Library", needs="build/examples/rtde_client_example",
    ),
    Client(
        "UR's C++ library, dashboard example", scripts.CPP_DASHBOARD,
        repository=f"{_UR}/Universal_Robots_Client_Library", needs="build/examples/dashboard_example",
    ),
    Client("pyModbusTCP: the gripper", scripts.PYMODBUS_TCP, "pyModbusTCP"),
    Client("robotiq3f_py: the gripper", scripts.ROBOTIQ3F_PY, repository="baha2r/robotiq3f_py"),
    Client("ROS robotiq, baseRobotiq3FGripper", scripts.ROS_3F, repository="ros-industrial-attic/robotiq"),
)  # fmt: skip


def run_clients(clones: Path | None, say: Say) -> list[Row]:
    """A row for each client; the fakes are started anew for each, so that none finds what another left."""
    return [_run(client, clones, say) for client in CLIENTS]


def _run(client: Client, clones: Path | None, say: Say) -> Row:
    clone = clone_of(client.repository, clones) if client.repository else None
    version = installed(client.package) if client.package else clone and commit_of(clone)
    if version is None:
        how = f"pip install {client.package}" if client.package else how_to_clone(client.repository)
        return skipped(PART, client.name, how)
    if client.needs and not (clone and (clone / client.needs).is_file()):
        return skipped(PART, client.name, f"{client.needs} is not there: build the clone as its README says")
    say(f"{client.name} {version}")
    with started_fakes(load_bench("wire")) as bench:
        ok, result = _asked(client, bench, clone)
    return Row(PART, client.name, version, result, met=ok)


def _asked(client: Client, bench: BenchConfig, clone: Path | None) -> tuple[bool, str]:
    python = shutil.which("python", path=str(Path(sys.executable).parent)) or sys.executable
    where = [str(bench.arm.host), str(bench.gripper.host), str(bench.gripper.port), str(clone or "")]
    try:
        done = subprocess.run(  # noqa: S603 - our own scripts
            [python, "-P", "-c", client.script, *where],
            capture_output=True,
            text=True,
            timeout=_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"did not end within {_LIMIT_S:.0f} s"
    said = _last_json(done.stdout)
    if said is None:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["said nothing"]
        return False, f"exit {done.returncode}: {lines[-1][:160]}"
    return bool(said["ok"]), str(said["result"]).strip()


def _last_json(text: str) -> dict[str, Any] | None:
    for line in reversed(text.splitlines()):
        if line.startswith("{"):
            return json.loads(line)
    return None
