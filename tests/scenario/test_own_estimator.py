"""A lab's own estimator in lifts, replays, its own frames and labelled clips."""

import csv
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import EstimatorError
from rig.benchmark import lifts
from rig.benchmark.clips import study as clips
from rig.benchmark.estimators.contenders import score_lift
from rig.benchmark.harness import Run
from rig.config import BenchConfig
from rig.experiments.lift_plan import TrialSettings, stored_trial
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.report.write import write_report
from rig.results.listing import list_session
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator
from support.angle_clips import write_clip
from support.benches import short_phases
from support.command_line import answer, refusal, rig
from support.own_estimators import MODULE, forget, own_estimators

pytestmark = pytest.mark.usefixtures("quick_pages")
MINE, FAILING = f"{MODULE}:Mine", f"{MODULE}:Now_and_then"
Draw = Callable[..., NDArray[np.uint8]]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the lab's module, in which the tests run; returns the file that importing it leaves."""
    with own_estimators(tmp_path_factory.mktemp("lab")) as imported:
        yield imported


@pytest.fixture(scope="module")
def session(lab: Path, two_lifts: Path) -> Path:
    """The two lifts as a trial with the lab's estimator, whose rows are those of `pca`."""
    folder = Path(shutil.copytree(two_lifts, lab.parent / "trial"))
    manifest = json.loads((folder / "session.json").read_text())
    (folder / "session.json").write_text(json.dumps({**manifest, "estimator": MINE}))
    return folder


@pytest.fixture
def not_imported(lab: Path) -> Callable[[], bool]:
    """Whether the module was not imported since the test began."""
    lab.unlink(missing_ok=True)
    sys.modules.pop(MODULE, None)
    forget()
    return lambda: not lab.exists() and MODULE not in sys.modules


@pytest.mark.heavy
def test_own_estimator_gives_the_rows_of_the_one_it_wraps_in_a_replay_by_two_processes(session: Path) -> None:
    assert all(row.answered > 0.5 and row.estimator_faults is None for row in read_finished_lifts(session))
    done = answer("replay", session, "--estimator", MINE, "--jobs", "2")
    assert done["identical"] == 2


@pytest.mark.heavy
def test_session_of_an_own_estimator_imports_nothing(session: Path, not_imported: Callable[[], bool]) -> None:
    assert stored_trial(session).settings.bench.simulated
    assert list_session(session).problem is None
    write_report([session])
    with pytest.raises(EstimatorError, match=f"add --estimator {MINE}"):
        run_replay(stored_trial(session), jobs=1)
    for command in (
        ["replay", session],
        ["replay", session, session.parent, "--out", session.parent / "table"],
        ["trial", "--resume", "--out", session],
    ):
        assert f"add --estimator {MINE}" in refusal(*command)
    assert rig("sessions", session.parent).returncode == 0
    assert rig("export", session, "--to", "csv", "--out", session.parent / "csv").returncode == 0
    assert not_imported()


def test_listing_imports_nothing(lab: Path, not_imported: Callable[[], bool]) -> None:
    done = rig("estimators", "--json")
    found = {of["name"]: of for of in json.loads(done.stdout)["estimators"]}
    assert found["lab-pca"] == {"name": "lab-pca", "from": "lab-rotation 0.3", "class": MINE}
    assert found["slip"]["from"] == "the rig"
    assert found[MINE]["class"] == MINE  # offered as `slip`, which is ours
    assert "lab-pca" in rig("estimators").stdout
    assert not_imported()


@pytest.mark.heavy
def test_failed_frames_are_reported_in_output_and_table(session: Path) -> None:
    folder = Path(shutil.copytree(session, session.parent / "failing"))
    out = session.parent / "failed"
    done = refusal("replay", folder, "--estimator", FAILING, "--jobs", "1", "--out", out)
    assert "WARNING: the estimator failed on" in done
    assert "rig: done, but in 2 lifts the estimator failed on" in done
    assert 'line 53: raise ValueError("no gradient today")' in done
    with (out / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2
    assert all("ValueError: no gradient today" in row["estimator_fault"] for row in rows)


@pytest.mark.heavy
def test_lift_with_failing_estimator_is_kept_and_reports_it(lab: Path, light_bench: BenchConfig) -> None:
    folder = lab.parent / "kept"
    with short_phases():
        summary = run_trial(folder, TrialSettings(light_bench, 0, choose_estimator(FAILING)), ["t2"], lifts=1)
    assert summary.lifts_accepted == 1
    (row,) = read_finished_lifts(folder)
    assert row.estimator_faults.frames == pytest.approx(0.1 * sum(row.states.values()), abs=2)
    assert "no gradient today" in (folder / "log.txt").read_text()
    assert "The estimator itself failed" in write_report([folder]).path.read_text()


@pytest.mark.heavy
@pytest.mark.parametrize("wrong", ["In_a_library", "Arguments"])
def test_touch_of_the_fingers_does_not_depend_on_an_own_estimator(
    wrong: str, lab: Path, light_bench: BenchConfig
) -> None:
    """One estimator fails in every frame, the other reports a contact in every frame."""
    folder = lab.parent / wrong
    settings = TrialSettings(light_bench, 0, choose_estimator(f"{MODULE}:{wrong}"))
    run_trial(folder, settings, ["t2"], lifts=1)
    (row,) = read_finished_lifts(folder)
    assert row.accepted
    assert row.outcome is LiftOutcome.SLIPPED
    assert (row.estimator_faults is None) == (wrong == "Arguments")


@pytest.fixture(scope="module")
def clip(lab: Path, press: Draw, blank: NDArray[np.uint8]) -> Path:
    return write_clip(lab.parent / "clips" / "one", press, blank)


@pytest.mark.heavy
def test_own_estimator_answers_a_folder_of_frames(clip: Path) -> None:
    frames = [clip / "frames", "--background", clip / "background.png"]
    done = [rig("estimate", *frames, "--estimator", name, "--window", "1") for name in (MINE, "pca")]
    assert [each.returncode for each in done] == [0, 0], done[0].stderr
    assert done[0].stdout == done[1].stdout
    failing = rig("estimate", *frames, "--estimator", FAILING)
    assert failing.returncode == 2
    assert "rig: done, but the estimator failed on 1 frame" in failing.stderr
    assert failing.stdout.count("\n") == done[0].stdout.count("\n")
    live = refusal("live", "fake", "--terminal", "--seconds", "2", "--estimator", FAILING)
    assert "the estimator failed; the state is then 'lost'" in live
    assert 'line 53: raise ValueError("no gradient today"))' in live.splitlines()[-1]


@pytest.mark.heavy
def test_own_estimator_is_scored_on_labelled_clips(clip: Path) -> None:
    (clip / "labels.csv").write_text(
        "reference_frame,keyframe,angle_deg,sigma_deg\n5,9,20,0.5\n5,11,30,0.5\n"
    )
    report = clips.measure(clips.ClipsOptions(clip.parent, [FAILING, "lab-pca"]), Run())
    assert {name: faults.frames for name, faults in report.faults.items()} == {FAILING: 1}
    assert report.tables[1].records[1]["score"].mean_deg < 3.0


@pytest.mark.heavy
def test_own_estimator_is_compared_on_a_session_and_by_the_second_renderer(
    session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(session.parent)
    done = answer("compare", "lab-pca", "pca", "--on", session, "--jobs", "1")
    assert done["lifts"] == 2
    report = lifts.measure(
        lifts.LiftsOptions(lifts.DRAWN, seeds=1, lifts=1, estimator=[FAILING]), Run(jobs=1)
    )
    assert report.faults[FAILING].frames > 2
    assert "no gradient today" in report.faults[FAILING].first


@pytest.mark.heavy
def test_estimator_benchmark_scores_own_estimator(session: Path) -> None:
    row = read_finished_lifts(session)[0]
    scores = score_lift(session, ("slip", "pca", MINE, FAILING), row)
    assert scores.scores[MINE, 1] == scores.scores["pca", 1]
    assert scores.scores[MINE, 4] == scores.scores["pca", 4]
    assert list(scores.faults) == [FAILING]
