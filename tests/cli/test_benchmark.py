"""`rig benchmark` as a user types it: default, exit codes, one JSON object."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import rig.benchmark.estimators.benchmark as estimators
import rig.benchmark.estimators.timing as timing
from rig.cli.main import app
from rig.config import load_bench
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.trial import run_trial
from rig.tactile.estimators import choose_estimator


def rig(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rig", "benchmark", *arguments],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=100,
        check=False,
    )


@pytest.mark.parametrize("arguments", [(), ("estimators",)])
def test_estimators_are_the_default_and_have_help(arguments: tuple[str, ...]) -> None:
    done = rig(*arguments, "--help")
    assert done.returncode == 0
    assert "estimators" in done.stdout
    assert ("Examples" in done.stdout) == bool(arguments)


def test_a_session_that_is_none_is_one_line(tmp_path: Path) -> None:
    done = rig("--session", str(tmp_path / "none"), "--out", str(tmp_path))
    assert done.returncode == 2
    assert "no such session folder" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_readme_without_markers_is_refused_at_once(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("nothing here\n")
    done = rig("estimators", "--out", str(tmp_path), "--readme", str(readme))
    assert done.returncode == 2
    assert "put these two lines" in done.stderr.splitlines()[-1]
    assert readme.read_text() == "nothing here\n"


@pytest.mark.timeout(300)
def test_a_run_prints_one_object_and_a_missed_limit_is_exit_4(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, out = tmp_path / "session", tmp_path / "out"
    run_trial(session, TrialSettings(load_bench("fake"), 0, choose_estimator()), ["t2"], 1)
    monkeypatch.setattr(estimators, "stress_tasks", lambda full, seed: [])  # a minute less
    monkeypatch.setattr(timing, "FRAMES_PER_LIFT", 120)
    done = CliRunner().invoke(
        app, ["benchmark", "--session", str(session), "--out", str(out), "--jobs", "1", "--json"]
    )
    assert done.exit_code == 4, done.output
    figures = json.loads(done.stdout)
    assert figures["lifts"] == 1
    assert figures["simulated"] is True
    missed = [limit["name"] for limit in figures["limits"] if not limit["met"]]
    assert "share of frames refused on smooth round contacts" in missed  # there was nothing to measure
    assert all(f"limit missed: {name}" in done.stderr for name in missed)
    assert {path.name for path in out.iterdir()} == {"results.json", "pareto.png", "index.html", "table.md"}
