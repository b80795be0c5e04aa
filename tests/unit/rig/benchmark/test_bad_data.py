"""Bad motion and data in `rig benchmark calibration`: refused with the right reason, or answered right."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import CalibrationError
from rig.benchmark.calibration.bad_data import CASES, Answer, Case, bad_data_rows


@pytest.mark.parametrize("group", dict.fromkeys(case.group for case in CASES))
def test_bad_data_is_refused_or_answered_right(group: str) -> None:
    once = [replace(case, draws=1) for case in CASES if case.group == group]
    assert [(row.case, row.said) for row in bad_data_rows(1, once) if row.wrong] == []


def test_rows_count_silent_errors_crashes_and_wrong_reasons() -> None:
    def crash(_: np.random.Generator) -> Answer:
        raise ZeroDivisionError

    def too_few(_: np.random.Generator) -> Answer:
        raise CalibrationError("too few samples")

    rows = bad_data_rows(
        0,
        [
            Case("g", "silent", lambda _: (2.0, 1.0), draws=1),
            Case("g", "nan", lambda _: (float("nan"), 1.0), draws=1),
            Case("g", "another reason", lambda _: "it rains", ("parallel",), draws=1),
            Case("g", "crash", crash, ("parallel",), draws=1),
            Case("g", "refused, should be answered", too_few, draws=1),
            Case("g", "right", lambda _: (0.5, 1.0), draws=1),
            Case("g", "refused", too_few, ("too few",), draws=3),
        ],
    )
    assert [row.wrong for row in rows] == [1, 1, 1, 1, 1, 0, 0]
    assert (rows[-1].refused, rows[-2].right) == (3, 1)
