"""A session with a further phase opens, replays and is reported."""

import json
import shutil
from pathlib import Path

import pytest

from drivers.errors import SessionError
from protocols.observer import Phase
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.export.formats import export_session
from rig.report.write import write_report
from rig.results.listing import SessionState, list_session
from rig.sessions.reading import phase_times
from rig.sessions.rows import read_finished_lifts
from support.recordings import Edit, written_again

STORED = Path(__file__).parents[3] / "data" / "stored_trial"
BEFORE_B_NS = 300_000_000
"""The added phase begins 0.3 s before phase B."""


@pytest.fixture
def longer_trial(tmp_path: Path) -> Path:
    """The stored trial as another version writes it, with a phase "settle" before B."""
    folder = Path(shutil.copytree(STORED, tmp_path / "trial"))
    row = json.loads((folder / "lifts.jsonl").read_text())
    row["phases_s"]["settle"] = row["phases_s"]["B"] - BEFORE_B_NS / 1e9
    (folder / "lifts.jsonl").write_text(json.dumps(row, sort_keys=True) + "\n")
    written_again(
        folder / row["recording"],
        lambda name: [("settle", -BEFORE_B_NS), (name, 0)] if name == "B" else [(name, 0)],
    )
    return folder


def test_session_with_a_further_phase_opens_and_is_listed(longer_trial: Path) -> None:
    entry = list_session(longer_trial)
    assert (entry.state, entry.problem, entry.done) == (SessionState.COMPLETE, None, 1)
    [row] = read_finished_lifts(longer_trial)
    phases_ns = phase_times(longer_trial / row.recording)
    assert list(phases_ns) == ["reference", "A", "settle", "B", "C", "lower"]
    assert phases_ns[Phase.LIFT] - phases_ns["settle"] == BEFORE_B_NS


def test_session_with_a_further_phase_replays_as_without_it(longer_trial: Path) -> None:
    [stored] = read_finished_lifts(STORED)
    replay = run_replay(stored_trial(longer_trial), jobs=1)
    [again] = replay.rows
    assert replay.problems == ()
    assert again.final_estimate_deg == stored.final_estimate_deg
    assert again.answered == stored.answered
    assert again.phases_s == {**stored.phases_s, "settle": pytest.approx(stored.phases_s["B"] - 0.3)}


def test_session_with_a_further_phase_is_reported_and_exported(longer_trial: Path, tmp_path: Path) -> None:
    written = write_report([longer_trial], tmp_path / "report.html")
    assert written.problems == ()
    assert "settle" in written.path.read_text()
    export_session(longer_trial, "csv", tmp_path / "csv")
    assert ",settle," in (tmp_path / "csv" / "frames.csv").read_text()


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda name: [] if name == "C" else [(name, 0)], "phase lower out of order"),
        (lambda name: [] if name == "lower" else [(name, 0)], "phase lower is missing"),
        (lambda name: [(name, 0), (name, 1)], "phase reference out of order"),
        (lambda name: [(name, 0), ("early", -(10**9))] if name == "B" else [(name, 0)], "phase early out"),
    ],
    ids=["left out", "last left out", "twice", "back in time"],
)
def test_a_recording_without_one_of_the_papers_phases_is_refused(
    tmp_path: Path, edit: Edit, said: str
) -> None:
    path = tmp_path / "001.mcap"
    shutil.copy(STORED / "lifts" / "001.mcap", path)
    written_again(path, edit)
    with pytest.raises(SessionError, match=said):
        phase_times(path)
