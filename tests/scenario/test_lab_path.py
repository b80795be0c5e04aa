"""The workflow of a lab from an empty folder: bench file, objects, an estimator in a package, results.

The commands are run as a person types them, over the wire protocols and in real time.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import rig as in_python
from rig.bench.fakes_process import started_fakes
from rig.config import BenchConfig
from rig.config.objects import parse_object
from rig.config.write import write_bench
from support.command_line import rig
from support.marks import require_ur_rtde
from support.notebook import run_notebook
from support.own_estimators import forget
from support.slow_motion import SLOWNESS, slow_down

require_ur_rtde()

OBJECT = """id = "{id}"
name = "my {id}"
orientations_deg = [0.0]
grip_mm = [1.87, 3.11]

[[position]]
name = "end"   # where it balances
offset_m = -0.05
width_m = 0.11
surface = "edge"
"""
ONE_LIFT = ("--lifts", 1, "--object", "lever", "--estimator", "lab-turns", "--tag", "gel-1")


@pytest.fixture
def lab(tmp_path: Path, unhurried_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder, with the estimator's package installed into `site`; the fakes of its bench are served."""
    (tmp_path / "objects").mkdir()
    for name in ("lever", "hook"):
        (tmp_path / "objects" / f"{name}.toml").write_text(OBJECT.format(id=name))
    installed(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "site")
    forget()
    for phase in ("protocols.slip_trial.GRASP_S", "protocols.slip_trial.HOLD_S"):
        monkeypatch.setattr(phase, 0.5)
    monkeypatch.setattr("rig.bench.fakes_process.LED_S", 1.5)
    slow_down(monkeypatch)
    with started_fakes(unhurried_bench, SLOWNESS) as served:
        write_bench(tmp_path / "bench.toml", served)
        yield tmp_path


def installed(folder: Path) -> None:
    assert rig("new", "lab", folder / "lab_turns").returncode == 0
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(folder / "lab_turns")], check=True)


def done(*words: object) -> Any:
    """Run a command; return what it printed as JSON."""
    ended = rig(*words, "--json")
    assert ended.returncode == 0, ended.stderr
    return json.loads(ended.stdout)


@pytest.mark.heavy
def test_lab_workflow_runs_from_an_empty_folder_to_results(lab: Path) -> None:
    bench = ("--bench", "bench.toml")
    (found,) = done("teach", "lever", *bench, "--yes")["positions"]
    assert found["problems"] == []
    assert found["offset_m"] == pytest.approx(-0.05, abs=0.005)
    assert found["height_m"] == pytest.approx(0.0, abs=0.005)
    assert found["width_m"] == pytest.approx(0.11, abs=0.003)
    assert found["lift_height_m"] == pytest.approx(0.05, abs=0.008)
    text = (lab / "objects" / "lever.toml").read_text()
    assert parse_object(text, "").position[0].width_m == found["width_m"]
    assert "# where it balances" in text
    assert {"lever", "hook"} <= {each["id"] for each in done("objects", *bench)["objects"]}

    poses = ("--poses", 1, "--images", 4, "--no-report", "--out", "poses")
    assert done("record", *bench, "--object", "my hook", *poses)["poses_accepted"] == 1
    assert done("trial", *bench, *ONE_LIFT, "--no-report", "--out", "trial")["lifts_accepted"] == 1

    compared = done("compare", "slip", "lab-turns", "--on", "trial", "--jobs", 1, "--out", "compared")
    assert compared["lifts"] == 1
    assert rig("report", "trial").returncode == 0
    assert (lab / "trial" / "report.html").is_file()
    assert rig("export", "trial", "--to", "csv", "--out", "tables").returncode == 0
    assert list((lab / "tables").rglob("*.csv"))
    assert "trial" in json.dumps(done("sessions", ".", "--tag", "gel-1"))
    assert [lift.object for lift in in_python.open_session("trial")] == ["lever"]
    assert "SIMULATED" in repr(run_notebook(lab / "trial")[1])
