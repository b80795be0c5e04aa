"""`rig benchmark` as a user types it: default, exit codes, one JSON object."""

import json
from pathlib import Path

import pytest

import rig.benchmark.estimators.lifts as lifts
import rig.benchmark.estimators.study as estimators
import rig.benchmark.estimators.timing as timing
from support.command_line import rig


def test_faults_are_injected_into_no_bench_but_its_own_fakes(tmp_path: Path) -> None:
    done = rig("benchmark", "faults", "--bench", "fake", "--out", str(tmp_path / "f"))
    assert done.returncode == 2
    assert "fakes that the benchmark starts itself" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "f").exists()


def test_a_readme_without_markers_is_refused_at_once(tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("nothing here\n")
    done = rig("benchmark", "estimators", "--out", str(tmp_path), "--readme", str(readme))
    assert done.returncode == 2
    assert "put these two lines" in done.stderr.splitlines()[-1]
    assert readme.read_text() == "nothing here\n"


def test_a_run_prints_one_object_and_a_missed_limit_is_exit_4(
    one_lift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(estimators, "stress_tasks", lambda seed, names: [])  # a minute less
    monkeypatch.setattr(timing, "FRAMES_PER_LIFT", 12)
    monkeypatch.setattr(lifts, "WINDOWS", lifts.WINDOWS[:2])
    done = rig("benchmark", "--session", one_lift, "--out", out, "--jobs", "1", "--json")
    assert done.returncode == 4, done.stderr
    figures = json.loads(done.stdout)
    assert figures["lifts"] == 1
    assert figures["simulated"] is True
    missed = [limit["name"] for limit in figures["limits"] if not limit["met"]]
    assert "share of frames refused on smooth round contacts" in missed  # there was nothing to measure
    assert all(f"limit missed: {name}" in done.stderr for name in missed)
    assert {path.name for path in out.iterdir()} == {"results.json", "table.md"}
