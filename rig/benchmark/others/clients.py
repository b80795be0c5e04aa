"""Foreign clients on the simulated devices, on loopback: one process and one time limit each."""

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
    """A foreign client. It is a package of PyPI or else a repository, OWNER/NAME."""

    name: str
    script: str
    package: str = ""
    repository: str = ""


_UR_CLIENT = "UniversalRobots/RTDE_Python_Client_Library"
CLIENTS = (
    Client("ur-rtde: motions, upload again", scripts.UR_RTDE, "ur-rtde"),
    Client("UR's RTDE client: record.py", scripts.RECORD, repository=_UR_CLIENT),
    Client("UR's RTDE client: registers", scripts.REGISTERS, repository=_UR_CLIENT),
    Client("pyModbusTCP: the gripper", scripts.PYMODBUS_TCP, "pyModbusTCP"),
)


def run_clients(clones: Path | None, say: Say) -> list[Row]:
    """Return a row for each client. The fakes are started again for each, so that all find the same state."""
    return [_run(client, clones, say) for client in CLIENTS]


def _run(client: Client, clones: Path | None, say: Say) -> Row:
    clone = clone_of(client.repository, clones) if client.repository else None
    version = installed(client.package) if client.package else clone and commit_of(clone)
    if version is None:
        how = f"pip install {client.package}" if client.package else how_to_clone(client.repository)
        return skipped(PART, client.name, how)
    say(f"{client.name} {version}")
    with started_fakes(load_bench("wire")) as bench:
        ok, result = _run_script(client, bench, clone)
    return Row(PART, client.name, version, result, met=ok)


def _run_script(client: Client, bench: BenchConfig, clone: Path | None) -> tuple[bool, str]:
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
