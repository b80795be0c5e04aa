"""Tables of counts: no range from fewer than five values."""

from collections.abc import Callable

import pytest

from rig.report.trial_page import onset_table
from rig.sessions.records import Lift


@pytest.mark.parametrize(("lifts", "ends"), [(4, ["-", "-"]), (5, ["+12", "+48"])])
def test_range_of_onset_delays_needs_five_lifts(
    lift_row: Callable[..., Lift], lifts: int, ends: list[str]
) -> None:
    rows = [
        lift_row(n, onset_truth_s=0.3, onset_estimate_s=0.31 + 0.01 * n, onset_alarm_s=None)
        for n in range(lifts)
    ]
    table = onset_table(rows)
    assert table is not None
    estimated, event = table.rows
    assert estimated[1] == f"{lifts} of {lifts}"
    assert estimated[3:5] == ends
    assert event[2:5] == ["-", "-", "-"]
