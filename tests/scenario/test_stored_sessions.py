"""Sessions of the version before still open, list, replay, report and export."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.export.formats import export_session
from rig.report.film import FilmedLift, write_film
from rig.report.session import find_lift
from rig.report.write import write_report
from rig.results.listing import SessionState, find_sessions, list_session
from rig.results.table import lifts_csv
from rig.sessions.codec import json_line, json_value
from rig.sessions.files import LOG, RESULTS, TIMING
from rig.sessions.manifest import TrialManifest, read_manifest, read_manifest_of
from rig.sessions.records import LIFTS, POSES
from rig.sessions.rows import read_finished_lifts, read_lifts, read_rows
from rig.sessions.timing import LIFT_TIMINGS

STORED = Path(__file__).parents[1] / "data"
TRIAL, RECORD = STORED / "stored_trial", STORED / "stored_record"


@pytest.fixture
def trial(tmp_path: Path) -> Path:
    """A copy of the trial that may be written to."""
    return Path(shutil.copytree(TRIAL, tmp_path / "trial"))


def test_stored_files_are_written_back_unchanged() -> None:
    for folder in (TRIAL, RECORD):
        text = json.dumps(json_value(read_manifest(folder)), indent=2, sort_keys=True) + "\n"
        assert text.encode() == (folder / "session.json").read_bytes()
    for file, codec in (
        (TRIAL / RESULTS["trial"], LIFTS),
        (RECORD / RESULTS["record"], POSES),
        (TRIAL / TIMING, LIFT_TIMINGS),
    ):
        kept = file.read_bytes().replace(b'"force_n": null, ', b"")  # a key that is no longer written
        assert b"".join(map(json_line, read_rows(file, codec))) == kept
    now = lifts_csv(read_lifts(TRIAL)).decode().splitlines()
    assert now[0].endswith(",warnings,speed_fraction")
    assert [line.rsplit(",", 2)[0] for line in now] == (TRIAL / "lifts.csv").read_text().splitlines()


def test_stored_sessions_are_listed_with_their_results() -> None:
    entries = {path.name: list_session(path) for path in find_sessions(STORED)}
    trial, record = entries["stored_trial"], entries["stored_record"]
    assert (trial.state, trial.problem) == (SessionState.COMPLETE, None)
    assert (record.state, record.problem) == (SessionState.COMPLETE, None)
    assert (trial.objects, trial.done, trial.wanted) == (("t2",), 1, 1)
    assert (record.objects, record.done, record.wanted) == (("7",), 1, 1)
    assert trial.mare is not None
    assert trial.mare.mean_deg == pytest.approx(1.0317541729443707, abs=1e-12)


def test_replay_gives_identical_fingertip_angles() -> None:
    """The markers' angle may be measured better than it was; the estimate may not change."""
    [stored] = read_finished_lifts(TRIAL)
    [again] = run_replay(stored_trial(TRIAL), jobs=1).rows
    for key in ("final_estimate_deg", "onset_estimate_s", "onset_alarm_s", "answered", "contact_area_px",
                "phases_s", "frames", "dropped", "states", "skipped", "disagreements"):  # fmt: skip
        assert getattr(again, key) == getattr(stored, key), key
    assert again.outcome is stored.outcome
    assert again.final_truth_deg == pytest.approx(stored.final_truth_deg, abs=0.3)


def test_replay_notes_the_other_measurement_of_ground_truth() -> None:
    said = stored_trial(TRIAL).truth_note
    assert said is not None
    assert "by the markers' corners, a replay measures them by their edges" in said
    assert "stored rows stay" in said


def test_unfinished_trial_is_not_continued_with_another_ground_truth(trial: Path) -> None:
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    unfinished = replace(manifest, status="running", completed=None, lifts_per_object=2)
    (trial / "session.json").write_text(json.dumps(json_value(unfinished)))
    with pytest.raises(InputError, match="measured by the markers' corners, but now by their edges"):
        run_trial(trial, stored_trial(trial).settings, list(manifest.objects), 2, resume=True)
    assert len(read_lifts(trial)) == 1


def test_complete_trial_is_opened_unchanged(trial: Path) -> None:
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    before = {p: p.read_bytes() for p in trial.rglob("*") if p.is_file() and p.name != LOG}
    summary = run_trial(trial, stored_trial(trial).settings, list(manifest.objects), 1, resume=True)
    assert summary.lifts_accepted == 1
    assert {path: path.read_bytes() for path in before} == before


def test_stored_sessions_have_reports_and_a_film(trial: Path, tmp_path: Path) -> None:
    for folder, said in ((trial, "toothbrush, lift 1"), (RECORD, "Recording of 7 spam")):
        written = write_report([folder], tmp_path / f"{folder.name}.html")
        assert written.problems == ()
        assert said in written.path.read_text()
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    film = write_film(
        [FilmedLift(trial, manifest, find_lift(trial, manifest, "t2/1"))], tmp_path / "lift.avi", fps=5.0
    )
    assert film.frames > 5


@pytest.mark.parametrize("to", ["csv", "parquet", "coco", "labelme", "lerobot"])
def test_stored_sessions_are_exported(to: str, tmp_path: Path) -> None:
    if to in ("parquet", "lerobot"):
        pytest.importorskip("pyarrow")
    of_trial = export_session(TRIAL, to, tmp_path / "trial").counts
    assert min(of_trial.values()) > 0
    if to != "lerobot":
        of_record = export_session(RECORD, to, tmp_path / "record").counts
        assert of_record["images"] == 2
