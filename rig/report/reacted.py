"""Lifts with a reaction to slip, compared with the same lifts without a reaction."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError, counted
from protocols.reaction import ReactionKind
from rig.report.lift_chart import lift_chart, on_one_scale
from rig.report.parts import Chart, Table
from rig.report.session import Trial
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.records import Lift, LiftOutcome

MOST_SHOWN = 3


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Data of the comparison.

    table: all lifts of both. pairs: charts without and with a reaction, of the lifts with the largest
    improvement.
    """

    table: Table
    pairs: list[list[Chart]]
    without: Path
    reacted: Path


def beside(trial: Trial, other: Trial) -> Beside:
    """Pair lifts of equal object, number and seed. Raises `InputError` if there is no pair."""
    without, reacted = _in_order(trial, other)
    kept = {_same(lift): lift for lift in without.lifts}
    both = [(kept[_same(lift)], lift) for lift in reacted.lifts if _same(lift) in kept]
    if not both:
        raise InputError(
            f"{other.folder}: no lift of the same object, number and seed as in {trial.folder}; repeat them "
            "with the same --seed"
        )
    return Beside(_table(both), _pairs(both), without.folder, reacted.folder)


def _in_order(trial: Trial, other: Trial) -> tuple[Trial, Trial]:
    """Return the session without a reaction and the one with a reaction. Raises `InputError`."""
    reacts = [each.manifest.react is not ReactionKind.NONE for each in (trial, other)]
    if reacts[0] == reacts[1]:
        both = "both react" if reacts[0] else "neither reacts"
        raise InputError(
            f"{trial.folder}, {other.folder}: {both} to slip; give one with --react beside one without"
        )
    return (other, trial) if reacts[0] else (trial, other)


def _same(row: Lift) -> tuple[str, int, int]:
    return row.object, row.lift, row.seed


def _table(both: Sequence[tuple[Lift, Lift]]) -> Table:
    columns = ("lift", "true end turn without, °", "with, °", "reactions", "grip steps added", "outcome")
    rows = [
        [
            lift.title,
            _turn(before),
            _turn(lift),
            str(len(lift.reactions or ())),
            str(lift.counts_added or 0),
            lift.outcome.value,
        ]
        for before, lift in both
    ]
    return Table(columns, rows, text=(0, 5))


def _pairs(both: Sequence[tuple[Lift, Lift]]) -> list[list[Chart]]:
    """Return the charts of caught lifts with the largest reduction of the final rotation."""
    caught = [pair for pair in both if pair[1].outcome is LiftOutcome.CAUGHT]
    caught.sort(key=lambda pair: abs(pair[1].final_truth_deg or 0.0) - abs(pair[0].final_truth_deg or 0.0))
    curves = [(pair, [lift.curves for lift in pair if lift.curves is not None]) for pair in caught]
    drawn = [(pair, on_one_scale(both)) for pair, both in curves if len(both) == len(pair)]
    return [[_chart(lift, own) for lift, own in zip(*each, strict=True)] for each in drawn[:MOST_SHOWN]]


def _chart(row: Lift, curves: LiftCurves) -> Chart:
    if not row.reactions:
        return lift_chart(curves, f"without a reaction: turned {_turn(row)}°, {row.outcome.value}")
    first = row.reactions[0].command_s
    reactions = (
        f"{counted(len(row.reactions), 'reaction')}, the first {first:.2f} s into the lift, "
        f"{counted(row.counts_added or 0, 'grip step')} added"
    )
    return lift_chart(curves, f"with '{row.react.value}': turned {_turn(row)}°; {reactions}")


def _turn(row: Lift) -> str:
    return "-" if row.final_truth_deg is None else f"{row.final_truth_deg:+.1f}"
