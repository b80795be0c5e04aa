"""The loop of trials and recordings repeats faults, stores results at once, ends after repeated faults."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import pytest

from drivers.errors import DeviceError
from rig.config import load_bench
from rig.experiments.attempts import Attempt, Wording, left_to_do, repeat_until_accepted
from rig.sessions.manifest import TrialManifest, begun_on
from rig.sessions.records import LIFTS, FailedLift, FinishedLift, LiftHead, LiftOutcome, LiftRow
from rig.sessions.rows import read_lifts
from rig.sessions.session import Session, open_session
from rig.sessions.timing import LiftTiming

MakeRow = Callable[..., FinishedLift]
WORDING = Wording("trial", "lift")


@dataclass(frozen=True)
class Piece:
    """A lift to execute."""

    number: int
    attempt: int = 0

    @property
    def name(self) -> str:
        return f"t1/{self.number}"


@dataclass
class Bench:
    """Creates attempts; the given ones fail, by number and attempt."""

    make: MakeRow
    failing: set[tuple[int, int]]

    def attempt(self, piece: Piece) -> Attempt[LiftRow]:
        row: LiftRow = self.make(piece.number, attempt=piece.attempt)
        timing = LiftTiming(number=piece.number, attempt=piece.attempt, wall_s=0.0, stages={})
        files = {f"lifts/{piece.number}-{piece.attempt}": b"frames"}
        if (piece.number, piece.attempt) not in self.failing:
            return Attempt(row, timing, None, files)
        head = {field.name: getattr(row, field.name) for field in fields(LiftHead)}
        failed = FailedLift(**head, accepted=False, outcome=LiftOutcome.FAULT, fault="lost", bench_s=1.0)
        return Attempt(failed, timing, "lost", files)


def session(folder: Path, resume: bool = False) -> Session[LiftRow]:
    asked = begun_on(load_bench("fake"), "trial", 0, ["t1"])
    manifest = TrialManifest(
        **vars(asked), lifts_per_object=3, estimator="slip", window=1, skip=True, truth="edges"
    )
    return open_session(folder, manifest, LIFTS, resume)


def test_fault_is_stored_and_the_attempt_is_repeated_at_once(tmp_path: Path, lift_row: MakeRow) -> None:
    seen: list[tuple[int, int, int, bool]] = []

    def progress(done: int, total: int, row: LiftRow) -> None:
        assert (tmp_path / "s" / f"lifts/{row.number}-{row.attempt}").exists()
        assert read_lifts(tmp_path / "s")[-1] == row
        seen.append((done, total, row.number, row.accepted))

    bench = Bench(lift_row, {(2, 0), (2, 1)})
    with session(tmp_path / "s") as kept:
        repeat_until_accepted(kept, [Piece(1), Piece(2), Piece(3)], bench.attempt, WORDING, progress)
    assert seen == [(1, 3, 1, True), (1, 3, 2, False), (1, 3, 2, False), (2, 3, 2, True), (3, 3, 3, True)]
    made = [(row.number, row.attempt) for row in read_lifts(tmp_path / "s")]
    assert made == [(1, 0), (2, 0), (2, 1), (2, 2), (3, 0)]


def test_three_faults_in_a_row_end_the_trial_which_can_be_resumed(tmp_path: Path, lift_row: MakeRow) -> None:
    pieces = [Piece(1), Piece(2)]
    bench = Bench(lift_row, {(2, 0), (2, 1), (2, 2)})
    with session(tmp_path / "s") as kept, pytest.raises(DeviceError) as raised:
        repeat_until_accepted(kept, list(pieces), bench.attempt, WORDING, lambda *_: None)
    assert str(raised.value) == (
        "trial: 3 rig faults in a row, all the same: lost; 1 of 2 lifts are done: fix the fault, then "
        "continue with --resume"
    )
    with session(tmp_path / "s", resume=True) as again:
        left = left_to_do(pieces, again.rows, lambda row: row.number)
        assert left == [replace(pieces[1], attempt=3)]
        repeat_until_accepted(again, left, bench.attempt, WORDING, lambda *_: None)
        assert [row.accepted for row in again.rows] == [True, False, False, False, True]
        assert left_to_do(pieces, again.rows, lambda row: row.number) == []


def test_faults_that_differ_in_a_measured_value_are_the_same(tmp_path: Path, lift_row: MakeRow) -> None:
    bench, late_s = Bench(lift_row, {(1, 0), (1, 1), (1, 2)}), iter((0.41, 0.52, 0.63))

    def attempt(piece: Piece) -> Attempt[LiftRow]:
        return replace(bench.attempt(piece), fault=f"camera: silent for {next(late_s)} s")

    with (
        session(tmp_path / "s") as kept,
        pytest.raises(DeviceError, match="all the same: camera: silent for 0"),
    ):
        repeat_until_accepted(kept, [Piece(1)], attempt, WORDING, lambda *_: None)


def test_faults_with_successes_between_do_not_end_the_trial(tmp_path: Path, lift_row: MakeRow) -> None:
    bench = Bench(lift_row, {(1, 0), (1, 1), (2, 0), (2, 1), (3, 0)})
    with session(tmp_path / "s") as kept:
        repeat_until_accepted(kept, [Piece(1), Piece(2), Piece(3)], bench.attempt, WORDING, lambda *_: None)
        assert sum(row.accepted for row in kept.rows) == 3
