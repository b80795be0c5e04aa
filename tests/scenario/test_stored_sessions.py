"""Stored sessions of this version open, list, replay, report and export; their frames can be streamed."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import rig
from drivers.clock import NS_PER_S
from protocols.observer import Phase
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.export.formats import export_session
from rig.frames.of_session import recording_frames
from rig.report.film import write_film
from rig.report.session import find_lift
from rig.report.write import write_report
from rig.results.listing import SessionState, find_sessions, list_session
from rig.results.table import lifts_csv
from rig.sessions.codec import json_line, json_value
from rig.sessions.files import LOG, RESULTS, TIMING
from rig.sessions.manifest import TrialManifest, read_manifest, read_manifest_of
from rig.sessions.reading import phase_times, recorded_angles
from rig.sessions.records import LIFT_TIMINGS, LIFTS, POSES
from rig.sessions.rows import read_lifts, read_rows
from rig.tactile.angles import Angles
from rig.version import processor, version_text
from support.command_line import rig as command_line
from support.marks import heavy

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
        assert b"".join(map(json_line, read_rows(file, codec))) == file.read_bytes()
    assert lifts_csv(read_lifts(TRIAL)) == (TRIAL / "lifts.csv").read_bytes()


def test_stored_sessions_are_listed_with_their_results() -> None:
    entries = {path.name: list_session(path) for path in find_sessions(STORED)}
    trial, record = entries["stored_trial"], entries["stored_record"]
    assert (trial.state, trial.problem) == (SessionState.COMPLETE, None)
    assert (record.state, record.problem) == (SessionState.COMPLETE, None)
    assert (trial.objects, trial.done, trial.wanted) == (("t2",), 1, 1)
    assert (record.objects, record.done, record.wanted) == (("7",), 1, 1)
    assert trial.mare.mean_deg == pytest.approx(1.0453961448583102, abs=1e-12)


@pytest.mark.heavy
def test_replay_gives_the_stored_rows() -> None:
    [stored], replay = read_lifts(TRIAL), run_replay(stored_trial(TRIAL), jobs=1)
    [again] = replay.rows
    for name in ("outcome", "frames", "states", "skipped", "disagreements", "phases_s"):
        assert getattr(again, name) == getattr(stored, name)
    # Rounding depends on the processor: code without AVX changes these angles by 4e-5 degrees.
    assert replay.agreement is not None
    assert replay.agreement.difference_deg == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("moved_deg", "said"),
    [(0.01, "the others within 0.05 degrees (0.01)"), (0.3, "others differ by up to 0.3 degrees")],
)
def test_replay_prints_its_difference_from_the_stored_lift_and_what_may_be_the_reason(
    trial: Path, moved_deg: float, said: str
) -> None:
    lift = json.loads((trial / "lifts.jsonl").read_text())
    lift["final_estimate_deg"] += moved_deg
    (trial / "lifts.jsonl").write_text(json.dumps(lift) + "\n")
    manifest = json.loads((trial / "session.json").read_text())
    (trial / "session.json").write_text(json.dumps({**manifest, "processor": "Another One"}))
    done = command_line("replay", trial, "--jobs", 1, "--json")
    assert done.returncode == 0
    origins = f"stored by version 1.0.0 on Another One, replayed by version {version_text()} on {processor()}"
    assert f"0 of 1 lift exactly as stored, {said}; {origins}\n" in done.stderr
    figures = json.loads(done.stdout)
    assert figures["identical"] == 0
    assert figures["difference_deg"] == pytest.approx(moved_deg, abs=1e-3)


def test_complete_trial_is_opened_unchanged(trial: Path) -> None:
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    before = {p: p.read_bytes() for p in trial.rglob("*") if p.is_file() and p.name != LOG}
    summary = run_trial(trial, stored_trial(trial).settings, list(manifest.objects), 1, resume=True)
    assert summary.lifts_accepted == 1
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.heavy
def test_stored_sessions_have_reports_and_a_film(trial: Path, tmp_path: Path) -> None:
    for folder, said in ((trial, "toothbrush, lift 1"), (RECORD, "Recording of 7 spam")):
        written = write_report([folder], tmp_path / f"{folder.name}.html")
        assert written.problems == ()
        assert said in written.path.read_text()
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    film = write_film([(trial, manifest, find_lift(trial, manifest, "t2/1"))], tmp_path / "lift.avi", fps=5.0)
    assert film.frames > 5


@pytest.mark.parametrize("to", ["csv", "parquet", "coco", "labelme", "lerobot"])
def test_stored_sessions_are_exported(to: str, tmp_path: Path) -> None:
    if to in ("parquet", "lerobot"):
        pytest.importorskip("pyarrow")
    of_trial = export_session(TRIAL, to, tmp_path / "trial").counts
    assert min(of_trial.values()) > 0
    if to == "coco":
        about = json.loads((tmp_path / "trial" / "coco.json").read_text())["info"]["description"]
        assert "SIMULATED" in about
        assert "proposed by image processing" in about
    if to != "lerobot":
        of_record = export_session(RECORD, to, tmp_path / "record").counts
        assert of_record["images"] == 2


@pytest.mark.heavy
@pytest.mark.parametrize("place", [0, *heavy(1)])
def test_streamed_frames_give_the_angles_of_the_lift(one_lift: Path, place: int) -> None:
    recording = one_lift / "lifts" / "001.mcap"
    tip, phases = recording_frames(recording)[place], phase_times(recording)
    lift_ns, lower_ns = phases[Phase.LIFT], phases[Phase.LOWER]
    estimator = rig.estimator("slip", background=tip.background, pixel_aspect=tip.aspect, sign=tip.sign)
    streamed: list[rig.SlipSample] = []
    zero_is_set = False
    for frame in tip.frames:
        if frame.time.time_ns >= lower_ns:
            break
        if not zero_is_set and frame.time.time_ns >= lift_ns:
            estimator.set_reference(lift_ns / NS_PER_S)
            zero_is_set = True
        assert frame.image is not None
        sample = estimator.update(frame.image, frame.time.time_ns / NS_PER_S)
        if zero_is_set:
            streamed.append(sample)
    angles = Angles.of(streamed, tip.serial)
    stored = recorded_angles(recording, tip.serial)[tip.serial].between(lift_ns, lower_ns)
    assert angles.states == stored.states
    for column in ("time_ns", "angle_deg", "sigma_deg", "contact_area_px"):
        np.testing.assert_array_equal(getattr(angles, column), getattr(stored, column))
    assert len(angles.known) > 30
    assert np.abs(angles.known.angle_deg).max() > 5.0
