"""Recordings with damaged chunks are used without these, and the gap is reported."""

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import SessionError
from protocols.observer import Phase
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import plan_replays, replay_task, run_replay
from rig.report.session import find_lift, read_trial
from rig.report.write import write_report
from rig.results.listing import SessionState, list_session
from rig.results.table import has_figures
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.recording_file import recorded_messages, recording_gaps
from rig.sessions.rows import read_finished_lifts
from support.command_line import refusal
from support.marks import heavy
from support.recordings import chunk_with, damage_chunks, written_again

CHUNK_BYTES = 15_000
FRAMES = "/image/SIM-D0001"


@pytest.fixture
def trial(tmp_path: Path, stored_trial_twice: Callable[[Path], Path]) -> Path:
    """Two lifts in recordings of many chunks."""
    folder = stored_trial_twice(tmp_path / "trial")
    for row in read_finished_lifts(folder):
        written_again(folder / row.recording, chunk_bytes=CHUNK_BYTES)
    return folder


@pytest.fixture
def damaged_chunk(trial: Path) -> int:
    """A chunk in the middle of lift 2 with a flipped bit."""
    recording = trial / "lifts" / "002.mcap"
    number = chunk_with(recording, "/phase", 2) + 1
    damage_chunks(recording, number)
    return number


def test_messages_before_and_after_a_damaged_chunk_are_read(trial: Path) -> None:
    recording = trial / "lifts" / "001.mcap"
    whole = list(recorded_messages(recording))
    damage_chunks(recording, 3, 7)
    gaps: list[str] = []
    left = list(recorded_messages(recording, gaps=gaps))
    assert 0.8 * len(whole) < len(left) < len(whole)
    in_order = iter(whole)
    assert all(message in in_order for message in left)
    assert [gap.split(",")[0].split(" of")[0] for gap in gaps] == ["chunk 3", "chunk 7"]
    assert all(gap.endswith(" s: the checksum differs") for gap in gaps)
    assert recording_gaps(recording) == gaps
    with pytest.raises(SessionError, match=r"chunk 3 of \d+, .* s: the checksum differs"):
        list(recorded_messages(recording))


def test_truncated_recording_is_read_to_its_end(trial: Path) -> None:
    recording = trial / "lifts" / "001.mcap"
    whole = list(recorded_messages(recording))
    data = recording.read_bytes()
    recording.write_bytes(data[: len(data) // 2])
    gaps: list[str] = []
    left = list(recorded_messages(recording, gaps=gaps))
    assert left == whole[: len(left)]
    assert len(left) > 0.3 * len(whole)
    assert gaps == ["it is truncated"]
    with pytest.raises(SessionError, match="it is truncated"):
        list(recorded_messages(recording))


@pytest.mark.heavy
def test_replay_uses_the_rest_of_a_lift_and_names_the_gap(trial: Path, damaged_chunk: int) -> None:
    replay = run_replay(stored_trial(trial), jobs=1)
    stored, partly = replay.rows
    assert partly.phases_s == stored.phases_s
    assert sum(partly.dropped.values()) > sum(stored.dropped.values())
    assert 0 < sum(partly.frames.values()) < sum(stored.frames.values())
    assert partly.final_estimate_deg == pytest.approx(stored.final_estimate_deg, abs=1.0)
    [problem] = replay.problems
    assert f"002.mcap: the recording is damaged (chunk {damaged_chunk} of " in problem
    assert problem.endswith("the data before and after were used")


@pytest.mark.heavy
@pytest.mark.parametrize("phase", [Phase.HOLD, *heavy(Phase.LIFT, Phase.LOWER)])
def test_phase_in_a_gap_is_taken_from_the_row_of_the_lift(trial: Path, phase: Phase) -> None:
    recording = trial / "lifts" / "002.mcap"
    damage_chunks(recording, chunk_with(recording, "/phase", list(Phase).index(phase)))
    replay = run_replay(stored_trial(trial), jobs=1)
    stored, partly = replay.rows
    assert partly.phases_s == stored.phases_s
    assert partly.final_estimate_deg == pytest.approx(stored.final_estimate_deg, abs=2.0)
    assert len(replay.problems) == 1


@pytest.mark.heavy
def test_table_of_many_sessions_has_the_figures_and_the_gap(trial: Path, damaged_chunk: int) -> None:
    plan = plan_replays([trial], "pca", None)
    whole, partly = (replay_task(task) for task in plan.tasks)
    assert whole["problem"] is None
    assert f"chunk {damaged_chunk} of " in str(partly["problem"])
    assert has_figures(partly)
    assert partly["final_estimate_deg"] is not None


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_report_shows_the_rest_of_a_lift_and_names_the_gap(trial: Path, tmp_path: Path) -> None:
    recording = trial / "lifts" / "002.mcap"
    damaged_chunk = chunk_with(recording, "/angle/estimate")
    damage_chunks(recording, damaged_chunk)
    shown = read_trial(trial, read_manifest_of(trial, TrialManifest, "no trial"))
    whole, partly = shown.lifts
    assert 0 < partly.estimate.time_s.size < whole.estimate.time_s.size
    written = write_report([trial], tmp_path / "report.html")
    [problem] = written.problems
    assert problem.startswith("1 of 2 recordings are damaged in part: toothbrush, lift 2 (lifts/002.mcap: ")
    assert f"chunk {damaged_chunk} of " in problem
    assert "cannot be shown" not in written.path.read_text()


def test_listing_names_every_gap(trial: Path) -> None:
    damage_chunks(trial / "lifts" / "002.mcap", 3, 7)
    entry = list_session(trial)
    assert entry.state is SessionState.BROKEN
    assert "002.mcap: the recording is damaged (chunk 3 of " in str(entry.problem)
    assert "; chunk 7 of " in str(entry.problem)


@pytest.mark.heavy
def test_film_is_made_and_the_command_names_the_gap(trial: Path, damaged_chunk: int, tmp_path: Path) -> None:
    manifest = read_manifest_of(trial, TrialManifest, "no trial")
    assert len(find_lift(trial, manifest, "2").notes) == 1
    film = tmp_path / "film.avi"
    done = refusal("play", trial, "--lift", "2", "--fps", "5", "--out", film)
    assert film.stat().st_size > 1000
    assert f"002.mcap: the recording is damaged (chunk {damaged_chunk} of " in done.splitlines()[-1]
