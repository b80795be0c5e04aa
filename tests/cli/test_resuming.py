"""Resuming an interrupted session with its original options."""

import json
import shutil
import tomllib
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import OperatorStopError
from rig.config import BenchConfig, load_bench
from rig.results.notes import lift_note
from rig.sessions.codec import json_value
from rig.sessions.manifest import begun_on, read_manifest
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_lifts
from rig.terminal.progress import OneMessage
from support.benches import real_bench, real_bench_file
from support.command_line import answer, refusal, rig, succeed
from support.quick_lifts import quick_lifts

pytestmark = pytest.mark.usefixtures("quick_pages")


def copied(one_lift: Path, folder: Path, **changes: Any) -> Path:
    """A copy of the session, its manifest changed: as if it had been stopped before its end."""
    shutil.copytree(one_lift, folder)
    manifest = json.loads((folder / "session.json").read_text())
    del manifest["completed"]
    (folder / "session.json").write_text(json.dumps({**manifest, "status": "running", **changes}))
    return folder


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder of the commands."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_resume_alone_continues_the_newest_unfinished_session_with_its_options(
    here: Path, one_lift: Path, light_bench_file: Path
) -> None:
    copied(one_lift, here / "sessions" / "old", started="2026-01-01T00:00:00+00:00")
    newest = copied(one_lift, here / "sessions" / "new")
    done = answer("trial", "--resume", "--bench", light_bench_file, "--no-report")
    assert done["session"] == str(newest.relative_to(here))
    assert json.loads((newest / "session.json").read_text())["status"] == "complete"
    assert json.loads((here / "sessions" / "old" / "session.json").read_text())["status"] == "running"


def test_resume_names_the_stored_bench_at_once_and_separates_its_times(
    here: Path, one_lift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copied(one_lift, here / "s", bench="wire")
    phases: list[str] = []
    monkeypatch.setattr("rig.cli.helping.begin_phase", phases.append)
    rig("trial", "--resume", "--out", folder, "--no-report")
    assert phases == [f"SIMULATED bench 'wire' as stored in {folder}: loading"]
    (lift,) = read_lifts(one_lift)
    done = rig("trial", "--resume", "--out", copied(one_lift, here / "same"), "--no-report")
    earlier = f"before it was resumed: {lift.bench_s:.1f} s of simulated bench time"
    assert f" s for 0.0 s of simulated bench time; {earlier}" in " ".join(done.stdout.split()), done.stderr
    rig("trial", "--resume", "--bench", "fake", "--out", here / "other", "--dry-run")
    assert phases[2:] == ["SIMULATED bench 'fake': loading"]


def test_resume_without_an_unfinished_session_is_rejected(here: Path, one_lift: Path) -> None:
    copied(one_lift, here / "sessions" / "other", bench="another")
    for command in (("trial",), ("record",), ("replay",)):
        done = refusal(*command, "--resume")
        assert "no unfinished" in done.splitlines()[-1]
        assert "--out" in done.splitlines()[-1]
        named = "(sessions/other is one on bench 'another')" in done.splitlines()[-1]
        assert named == (command == ("trial",))
    assert "--object" in rig("record").stderr
    assert "no session given" in rig("replay").stderr


def test_resume_with_other_options_or_another_bench_names_the_difference(
    here: Path, one_lift: Path, light_bench_file: Path
) -> None:
    folder = copied(one_lift, here / "s")
    common = ("trial", "--resume", "--out", folder, "--bench", light_bench_file)
    text, other = light_bench_file.read_text(), here / "other.toml"
    assert "marker_side_m = 0.04" in text
    other.write_text(text.replace("marker_side_m = 0.04", "marker_side_m = 0.05"))
    differs = "config.camera.marker_side_m 0.04, not 0.05"
    for options, said in (
        (("--lifts", 2), "lifts_per_object 1, not 2"),
        (("--seed", 3), "seed 0, not 3"),
        (("--object", "wrench"), "objects t2, not t1"),
        (("--estimator", "pca"), "estimator slip, not pca"),
        (("--bench", other), differs),
        (("--bench", other, "--dry-run"), differs),
    ):
        assert said in refusal(*common, *options).splitlines()[-1]


def test_documented_resume_uses_the_stored_bench(
    here: Path, one_lift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_lifts(monkeypatch)
    folder = copied(one_lift, here / "s")
    (folder / "lifts.jsonl").unlink()
    done = succeed("trial", "--resume", "--out", folder, "--no-report", "--jobs", 1, "--json")
    assert json.loads(done.stdout)["lifts_accepted"] == 1
    assert f"bench 'fake' as stored in {folder}" in done.stderr
    (again,), (before,) = read_lifts(folder), read_lifts(one_lift)
    assert (again.seed, again.position, again.grip_counts) == (
        before.seed,
        before.position,
        before.grip_counts,
    )
    assert read_manifest(folder).config == read_manifest(one_lift).config


def stored_with(config: BenchConfig) -> dict[str, Any]:
    """Return the keys of a manifest that name the bench."""
    manifest = json_value(begun_on(config, "trial", 0, ["t2"]))
    return {key: manifest[key] for key in ("bench", "simulated", "serials", "signs", "config")}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"/dev/video94"', '"http://me:secret@192.0.2.12/stream"', "has a password, which is not stored"),
        (
            'driver = "camera"  ',
            'driver = "my_camera:Camera"  ',
            "names my_camera:Camera, which runs only if you name",
        ),
        ("sign = -1", "sign = 1", "session.json: tactile.1.sign: opposing fingertips"),
    ],
)
def test_stored_bench_that_cannot_be_used_is_refused(
    here: Path, one_lift: Path, old: str, new: str, said: str
) -> None:
    text = real_bench()
    assert old in text
    values = tomllib.loads(text.replace(old, new))
    if ":" in new and "http" not in new:
        del values["camera"]["address"]
    config = BenchConfig.model_validate_json(json.dumps(values))
    folder = copied(one_lift, here / "s", **stored_with(config.without_passwords()))
    assert said in refusal("trial", "--resume", "--out", folder, "--yes").splitlines()[-1]


def test_yes_answers_for_a_real_bench_only_if_the_command_line_names_it(
    here: Path, one_lift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answered: list[bool] = []

    def operator(_ask: object, agreed: bool, feeder: str | None) -> None:
        answered.append(agreed)
        raise OperatorStopError("nothing is started here")

    monkeypatch.setattr("rig.bench.operators.ConsoleOperator", operator)
    file = real_bench_file(here)
    folder = copied(one_lift, here / "s", **stored_with(load_bench(str(file))))
    common = ("trial", "--resume", "--out", folder, "--yes", "--no-report")
    assert rig(*common).returncode == 3
    assert rig(*common, "--bench", file).returncode == 3
    assert answered == [False, True]


@pytest.mark.heavy
def test_stopped_trial_writes_its_report_and_prints_the_command_to_continue(
    here: Path, one_lift: Path, light_bench_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(folder: Path, *_: object, **__: object) -> None:
        copied(one_lift, folder, lifts_per_object=2)
        raise OperatorStopError("stopped by the operator; finished results are kept")

    monkeypatch.setattr("rig.experiments.trial.run_trial", stopped)
    done = rig("trial", "--lifts", 2, "--object", "toothbrush", "--bench", light_bench_file)
    assert done.returncode == 3
    assert "SIMULATED rotational error per object" in done.stdout
    counted, report, line, last = done.stderr.splitlines()[-4:]
    assert counted == "1 of 2 lifts are done"
    (folder,) = (here / "sessions").iterdir()
    assert report == f"report: sessions/{folder.name}/report.html"
    assert "toothbrush" in (folder / "report.html").read_text()
    assert line == (
        f"continue with: rig trial --lifts 2 --object toothbrush --bench {light_bench_file} --resume "
        f"--out sessions/{folder.name}"
    )
    assert last.startswith("rig: stopped by the operator")


def test_ctrl_c_in_the_first_lift_keeps_the_session_for_resume(
    here: Path, light_bench_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise OperatorStopError("stopped by the operator; finished results are kept")

    common = ("trial", "--bench", light_bench_file, "--no-report", "--jobs", 1)
    what = ("--lifts", 1, "--object", "t2", "--estimator", "pca", "--name", "first try", "--tag", "new")
    with monkeypatch.context() as patch:
        patch.setattr("rig.experiments.lift_attempt.run_lift", stopped)
        done = rig(*common, *what)
    assert done.returncode == 3, done.stderr
    assert "continue with: rig trial" in done.stderr
    (folder,) = (here / "sessions").iterdir()
    quick_lifts(monkeypatch)
    again = answer(*common, "--resume")
    assert again["lifts_accepted"] == 1
    manifest = read_manifest(folder)
    assert (manifest.remarks.name, manifest.remarks.tags) == ("first try", ("new",))
    assert (manifest.status, manifest.estimator) == ("complete", "pca")


def test_cause_of_a_fault_is_printed_once(one_lift: Path) -> None:
    (row,) = read_lifts(one_lift)
    failed = [
        replace(row, accepted=False, outcome=LiftOutcome.FAULT, fault=fault)
        for fault in ("camera silent for 0.41 s", "camera silent for 0.52 s", "arm lost")
    ]
    note = OneMessage(lift_note, attrgetter("fault"))
    said = [note(row) for row in (failed[0], failed[1], row, failed[1], failed[2])]
    assert [text.split("fault: ")[-1] for text in said if "fault" in text] == [
        "camera silent for 0.41 s", "the same fault again", "the same fault again", "arm lost",
    ]  # fmt: skip
