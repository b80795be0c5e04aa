"""Comparisons: paired, with intervals, and no winner where none is shown."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from protocols.reaction import ReactionKind
from rig.pages.palette import FIRST, SECOND, TRUTH
from rig.report.compare import (
    ERROR,
    compare_figure,
    compare_lifts,
    compare_page,
    figure_table,
    lift_charts,
    verdict,
)
from rig.report.sides import session_side
from rig.sessions.records import ErrorSummary, Lift, LiftOutcome, lift_of_table

NAMES = ("old", "new")


def row(lift: int, error: float | None, name: str = "wrench", answered: float = 1.0) -> Lift:
    part = None if error is None else ErrorSummary(error, 0.1, 2 * error, 100)
    return lift_of_table(
        number=lift, object=f"id {name}", name=name, lift=lift, simulated=True, outcome=LiftOutcome.SLIPPED,
        re=part, re_b=part, re_held=part, answered=answered, final_truth_deg=10.0,
    )  # fmt: skip


def rising(first: float, lifts: int = 10, **changes: Any) -> list[Lift]:
    return [replace(row(i, first + 0.1 * i), **changes) for i in range(lifts)]


@pytest.mark.heavy
def test_side_that_is_always_closer_wins() -> None:
    found = compare_lifts(NAMES, rising(1.0), rising(0.6))
    error = found.overall[0]
    assert error.difference == pytest.approx(-0.4)
    assert (error.wins, error.winner) == ((0, 10, 0), 1)
    assert verdict(found).startswith("new is better by 0.40°")
    assert '<li class="good"><b>new is better' in compare_page(found, simulated=False, about="two")
    same = compare_lifts(NAMES, rising(1.0), [row(i, 1.0 + 0.1 * (9 - i)) for i in range(10)])
    assert '<li class="note"><b>No significant difference' in compare_page(same, simulated=False, about="two")


@pytest.mark.parametrize("lifts", range(1, 5))
def test_fewer_than_five_lifts_have_no_verdict(lifts: int) -> None:
    found = compare_lifts(NAMES, rising(1.0, lifts), rising(0.2, lifts))
    assert {(p.low, p.high, p.winner) for p in found.overall} == {(None, None, None)}
    assert verdict(found).startswith(f"No verdict over {lifts} lift")
    assert "at least 5 with an error" in verdict(found)
    assert found.judged is False
    assert '<li class="note"><b>No verdict' in compare_page(found, simulated=False, about="two")


def test_refused_lifts_are_counted_in_verdict_and_table() -> None:
    found = compare_lifts(NAMES, [row(0, None), *rising(1.0)[1:]], rising(0.6))
    assert verdict(found).endswith("over 9 of 10 lifts, 1 refused.")
    assert "9 of 10" in figure_table(found).rows[0]


def test_pairing_detects_differences_smaller_than_the_spread() -> None:
    rng = np.random.default_rng(3)
    spread = rng.uniform(0.2, 8.0, 30)
    old = [row(i, float(error)) for i, error in enumerate(spread)]
    new = [row(i, float(error) + 0.05 + float(rng.normal(0, 0.02))) for i, error in enumerate(spread)]
    assert compare_lifts(NAMES, old, new).overall[0].winner == 0


def test_two_runs_of_one_estimator_have_no_winner_in_time() -> None:
    sides = [[replace(row(i, 1.0), frame_ms=ms + 0.01 * i) for i in range(10)] for ms in (1.0, 2.0)]
    for same, winner in ((False, 0), (True, None)):
        found = compare_lifts(NAMES, *sides, same_estimator=same)
        assert [p.winner for p in found.overall if p.figure.unit == "ms"] == [winner]


def test_larger_share_of_answers_is_better() -> None:
    old = [row(i, 1.0, answered=0.7 + 0.01 * i) for i in range(8)]
    new = [row(i, 1.0, answered=0.9 + 0.01 * i) for i in range(8)]
    share = next(p for p in compare_lifts(NAMES, old, new).overall if p.figure.name == "frames with an angle")
    assert (share.winner, share.wins) == (1, (0, 8, 0))


def test_lifts_without_a_partner_or_an_answer_are_left_out_and_counted() -> None:
    old = [row(1, 1.0), row(2, None), row(3, 1.0)]
    new = [row(1, 2.0), row(2, 2.0), row(4, 1.0)]
    found = compare_lifts(NAMES, old, new)
    assert found.alone == (("wrench, lift 3",), ("wrench, lift 4",))
    page = compare_page(found, simulated=False, about="two", notes=["lifts.jsonl: line 9 is damaged"])
    for part in ("that only old has.</b>wrench, lift 3", "wrench, lift 4", "line 9 is damaged"):
        assert part in page
    error = found.overall[0]
    assert (error.lifts, error.missing, error.winner) == (1, 1, None)  # one lift has no interval
    with pytest.raises(InputError, match="no lift in common"):
        compare_lifts(NAMES, old, [row(1, 1.0, "knife")])


@given(st.lists(st.tuples(st.floats(0, 50), st.floats(0, 50)), min_size=2, max_size=8))
def test_changing_sides_changes_the_sign(errors: list[tuple[float, float]]) -> None:
    pairs = [(row(i, a), row(i, b)) for i, (a, b) in enumerate(errors)]
    one, other = compare_figure(ERROR, pairs), compare_figure(ERROR, [(b, a) for a, b in pairs])
    assert one is not None
    assert other is not None
    assert one.difference == pytest.approx(-other.difference)
    assert one.wins == (other.wins[1], other.wins[0], other.wins[2])


@pytest.mark.heavy
def test_page_of_two_sessions_shows_both_curves_of_every_lift(drawn_trial: Any, tmp_path: Path) -> None:
    turns = (12.0, -20.0, 9.0, 15.0, -11.0)
    first = session_side(drawn_trial(tmp_path / "first", turns, (0.5,) * 5))
    second = session_side(drawn_trial(tmp_path / "second", turns, (2.0,) * 5))
    found = compare_lifts((first.name, second.name), first.lifts, second.lifts)
    page = compare_page(found, simulated=True, about="two sessions")
    charts = re.findall(r'aria-label="([^"]*: both estimates and the marker angle)"', page)
    assert len(charts) == len(turns)
    lift = next(svg for svg in re.findall(r"<svg.*?</svg>", page) if charts[0] in svg)
    assert all(f"stroke: {colour.css}" in lift for colour in (FIRST, SECOND, TRUTH))
    assert "first is better by" in page
    assert first.estimator == second.estimator == "slip, window 1"
    assert "SIMULATED" in page


def test_only_trials_are_compared(drawn_recording: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs --on SESSION"):
        session_side(Path("ellipse"))
    with pytest.raises(InputError, match="'record' session"):
        session_side(drawn_recording(tmp_path / "s"))


@pytest.mark.heavy
def test_lift_with_the_largest_difference_is_shown_first(drawn_trial: Any, tmp_path: Path) -> None:
    first = session_side(drawn_trial(tmp_path / "first", (12.0, -20.0), (0.5, 0.5)))
    second = session_side(drawn_trial(tmp_path / "second", (12.0, -20.0), (0.6, 3.0)))
    charts = lift_charts(compare_lifts(NAMES, first.lifts, second.lifts))
    shown = [[float(number) for number in re.findall(r"error ([0-9.]+)", chart.caption)] for chart in charts]
    apart = [abs(second - first) for first, second in shown]
    assert apart[0] > 1.0 > apart[1]


def test_true_turns_in_opposite_directions_do_not_cancel(drawn_trial: Any, tmp_path: Path) -> None:
    lifts = session_side(drawn_trial(tmp_path / "trial", (12.0, -20.0))).lifts
    (turn,) = (
        of
        for of in compare_lifts(NAMES, lifts, lifts).overall
        if of.figure.unit == "°" and not of.figure.of_turn
    )
    assert turn.first == pytest.approx(16.0, abs=0.5)


def test_lift_without_a_readable_recording_has_no_curves(drawn_trial: Any, tmp_path: Path) -> None:
    folder = drawn_trial(tmp_path / "trial", (12.0, -20.0))
    next((folder / "lifts").glob("*.mcap")).write_bytes(b"damaged")
    assert [lift.angles is None for lift in session_side(folder).lifts].count(True) == 1


def test_lifts_with_different_reactions_are_not_compared_by_their_error() -> None:
    found = compare_lifts(NAMES, rising(1.0, 6), rising(0.2, 6, react=ReactionKind.TIGHTEN))
    assert {p.figure.name for p in found.overall} == {"frames with an angle", "true turn, either way"}
    assert found.objects == {}
    assert verdict(found).startswith("No verdict: the sides react to slip differently.")
    assert [own.text.partition(" ±")[0] for own in found.apart] == [
        "old, without a reaction: mean error in B and C 1.25",
        "new, reaction 'tighten': mean error in B and C 0.45",
    ]
    page = compare_page(found, simulated=False, about="two")
    assert "Which side is closer" not in page
    assert "new, reaction" in page
    assert found.as_json()["separately"]


def test_lifts_with_the_same_reaction_are_compared() -> None:
    found = compare_lifts(NAMES, *(rising(first, 6, react=ReactionKind.STOP) for first in (1.0, 0.2)))
    assert found.apart == ()
    assert verdict(found).startswith("new is better by 0.80")
