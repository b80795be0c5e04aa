"""The loop of trials and recordings repeats faults, stores results at once, ends after repeated faults."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from rig.experiments.attempts import Attempt, Run, run_session
from rig.experiments.lift_plan import LiftTask
from rig.results.table import lifts_csv
from rig.sessions.records import LIFTS, Lift, LiftTiming
from rig.sessions.rows import read_lifts
from support.recordings import trial_request

MakeRow = Callable[..., Lift]
Progress = Callable[[int, int, Lift], None]


@dataclass
class Bench:
    """Creates attempts; the given ones fail, by number and attempt, with one of the texts each."""

    make: MakeRow
    failing: set[tuple[int, int]]
    texts: Iterator[str] = field(default_factory=lambda: repeat("lost"))

    def attempt(self, task: LiftTask) -> Attempt[Lift]:
        fault = next(self.texts) if (task.number, task.attempt) in self.failing else None
        timing = LiftTiming(number=task.number, attempt=task.attempt, wall_s=0.0, stages={})
        row: Lift = self.make(task.number, fault, attempt=task.attempt)
        return Attempt(row, timing, {f"lifts/{task.number}-{task.attempt}": b"frames"})


def trial(
    folder: Path, bench: Bench, count: int, resume: bool = False, progress: Progress = lambda *_: None
) -> list[Lift]:
    """Run a trial of lifts 1 to count."""
    manifest = trial_request(lifts=count)
    tasks = [LiftTask(number, "t1", number) for number in range(1, count + 1)]
    plan = Run("trial", "lift", manifest, LIFTS, tasks, lambda *_: bench.attempt, ("t.csv", lifts_csv), str)
    return run_session(folder, plan, resume, None, progress)


def test_fault_is_stored_and_the_attempt_is_repeated_at_once(tmp_path: Path, lift_row: MakeRow) -> None:
    seen: list[tuple[int, int, int, bool]] = []

    def progress(done: int, total: int, row: Lift) -> None:
        assert (tmp_path / "s" / f"lifts/{row.number}-{row.attempt}").exists()
        assert read_lifts(tmp_path / "s")[-1] == row
        seen.append((done, total, row.number, row.accepted))

    rows = trial(tmp_path / "s", Bench(lift_row, {(2, 0), (2, 1)}), 3, progress=progress)
    assert seen == [(1, 3, 1, True), (1, 3, 2, False), (1, 3, 2, False), (2, 3, 2, True), (3, 3, 3, True)]
    made = [(row.number, row.attempt) for row in read_lifts(tmp_path / "s")]
    assert made == [(1, 0), (2, 0), (2, 1), (2, 2), (3, 0)] == [(row.number, row.attempt) for row in rows]


def test_three_faults_in_a_row_end_the_trial_which_can_be_resumed(tmp_path: Path, lift_row: MakeRow) -> None:
    bench = Bench(lift_row, {(2, 0), (2, 1), (2, 2)})
    with pytest.raises(DeviceError) as raised:
        trial(tmp_path / "s", bench, 2)
    assert str(raised.value) == (
        "trial: 3 rig faults in a row, all the same: lost; 1 of 2 lifts are done: fix the fault, then "
        "continue with --resume"
    )
    rows = trial(tmp_path / "s", bench, 2, resume=True)
    assert [row.accepted for row in rows] == [True, False, False, False, True]
    assert rows[-1].attempt == 3
    assert trial(tmp_path / "s", bench, 2, resume=True) == rows


def test_faults_that_differ_in_a_measured_value_are_the_same(tmp_path: Path, lift_row: MakeRow) -> None:
    texts = (f"camera: silent for {late_s} s" for late_s in (0.41, 0.52, 0.63))
    with pytest.raises(DeviceError, match="all the same: camera: silent for 0"):
        trial(tmp_path / "s", Bench(lift_row, {(1, 0), (1, 1), (1, 2)}, texts), 1)


def test_faults_with_successes_between_do_not_end_the_trial(tmp_path: Path, lift_row: MakeRow) -> None:
    bench = Bench(lift_row, {(1, 0), (1, 1), (2, 0), (2, 1), (3, 0)})
    assert sum(row.accepted for row in trial(tmp_path / "s", bench, 3)) == 3
