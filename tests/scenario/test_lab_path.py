"""A lab's own way, from an empty folder: its bench file, objects, an estimator in a package, results.

On a simulated bench in this process; behind wires the same commands take real time.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.command_line import rig

OBJECT = """id = "{id}"
name = "{name}"
orientations_deg = [0.0]
grip_counts = [3, 5]

[[position]]
name = "end"
offset_m = -0.05
width_m = 0.03
lift_height_m = 0.05
surface = "edge"
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, light_bench_file: Path) -> Path:
    """The folder, with the estimator's package installed into `site`."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copy(light_bench_file, folder / "bench.toml")
    (folder / "objects").mkdir()
    for name in ("lever", "hook"):
        (folder / "objects" / f"{name}.toml").write_text(OBJECT.format(id=name, name=f"my {name}"))
    assert rig("new", "estimator", folder / "lab_turns").returncode == 0
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(folder / "lab_turns")], check=True)
    return folder


def run(lab: Path, *words: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)], cwd=lab, capture_output=True, text=True, timeout=240,
        env={**os.environ, "PYTHONPATH": str(lab / "site")}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done


def test_a_lab_comes_from_an_empty_folder_to_its_own_results(lab: Path) -> None:
    bench = ("--bench", "bench.toml")
    run(lab, "rig", "teach", "lever", *bench, "--yes")
    assert {"lever", "hook"} <= {
        o["id"] for o in json.loads(run(lab, "rig", "objects", *bench, "--json").stdout)["objects"]
    }

    run(lab, "rig", "record", *bench, "--object", "hook", "--poses", 1, "--out", "poses")
    both = ("--object", "lever", "--object", "my hook", "--lifts", 1)
    trial = (
        "rig",
        "trial",
        *bench,
        *both,
        "--estimator",
        "lab-turns",
        "--out",
        "trial",
        "--tag",
        "gel-1",
        "--json",
    )
    run(lab, *trial)
    rows = [json.loads(line) for line in (lab / "trial" / "lifts.jsonl").read_text().splitlines()]
    assert sorted(row["object"] for row in rows if row["accepted"]) == ["hook", "lever"]

    run(lab, "rig", "compare", "slip", "lab-turns", "--on", "trial", "--out", "compared")
    run(lab, "rig", "report", "trial")
    run(lab, "rig", "export", "trial", "--to", "csv", "--out", "tables")
    assert (lab / "trial" / "report.html").is_file()
    assert list((lab / "tables").rglob("*.csv"))
    listed = json.loads(run(lab, "rig", "sessions", ".", "--tag", "gel-1", "--json").stdout)
    assert "trial" in json.dumps(listed)


def test_and_its_session_opens_in_python(lab: Path) -> None:
    code = (
        "import rig\n"
        "session = rig.open_session('trial')\n"
        "lifts = list(session)\n"
        "assert {lift.object for lift in lifts} == {'lever', 'hook'}\n"
        "assert all(len(lift.estimate.time_s) for lift in lifts)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=lab, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
