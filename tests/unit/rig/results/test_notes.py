"""Text about trials on the terminal."""

from collections.abc import Callable

import pytest

from rig.results.notes import lift_note
from rig.results.summary import summarize_trial
from rig.sessions.records import ErrorSummary, Lift

MakeRow = Callable[..., Lift]


def row(make: MakeRow, number: int, error_deg: float | None) -> Lift:
    error = None if error_deg is None else ErrorSummary(error_deg, 0.1, 2 * error_deg, 300)
    return make(number, object="t1", name="wrench", re=error, re_b=error, re_held=error)


@pytest.mark.parametrize(
    ("states", "why"),
    [
        ({"unobservable": 200, "lost": 3}, "'unobservable': The contact looks the same"),
        ({"no_contact": 200, "tracking": 0}, "'no_contact': The fingertip detected no contact"),
        ({"lost": 200}, "'lost': The image changed more"),
    ],
)
def test_note_of_a_lift_without_an_answer_gives_the_reason(
    lift_row: MakeRow, states: dict[str, int], why: str
) -> None:
    lift = lift_row(1, re=None, re_b=None, answered=0.0, states=states)
    assert f"no answer, most frames are {why}" in lift_note(lift)


def test_answered_lift_without_marker_angle_is_not_called_unanswered(lift_row: MakeRow) -> None:
    note = lift_note(lift_row(1, re=None, re_b=None, answered=1.0))
    assert "no answer" not in note
    assert "no frame has both an estimate and a marker angle" in note


def test_json_has_no_interval_below_five_lifts_and_counts_refused_ones(lift_row: MakeRow) -> None:
    few = summarize_trial([row(lift_row, i, 0.1 * i) for i in range(1, 5)]).as_json()
    assert (few["mare_interval_deg"], few["lifts_refused"]) == (None, 0)
    lifts = [row(lift_row, i, 0.1 * i if i < 6 else None) for i in range(1, 8)]
    more = summarize_trial(lifts).as_json()
    assert isinstance(more["mare_interval_deg"], list)
    assert (more["lifts_accepted"], more["lifts_refused"]) == (7, 2)
    none = summarize_trial(lifts[5:]).as_json()
    assert (none["mare_deg"], none["mare_interval_deg"], none["lifts_refused"]) == (None, None, 2)
