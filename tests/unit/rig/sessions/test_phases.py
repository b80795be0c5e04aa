"""A recording has the phases of a lift, once each and in order."""

import shutil
from pathlib import Path

import pytest

from drivers.errors import SessionError
from rig.sessions.reading import phase_times
from support.recordings import Edit, written_again

STORED = Path(__file__).parents[3] / "data" / "stored_trial"


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda name: [] if name == "C" else [(name, 0)], "phase lower out of order"),
        (lambda name: [] if name == "lower" else [(name, 0)], "phase lower is missing"),
        (lambda name: [(name, 0), (name, 1)], "phase reference out of order"),
        (lambda name: [(name, -(10**9))] if name == "C" else [(name, 0)], "phase C out of order"),
        (lambda name: [(name, 0), ("settle", 1)] if name == "A" else [(name, 0)], "the recording is damaged"),
    ],
    ids=["left out", "last left out", "twice", "back in time", "unknown"],
)
def test_recording_without_the_phases_in_order_is_refused(tmp_path: Path, edit: Edit, said: str) -> None:
    path = tmp_path / "001.mcap"
    shutil.copy(STORED / "lifts" / "001.mcap", path)
    written_again(path, edit)
    with pytest.raises(SessionError, match=said):
        phase_times(path)
