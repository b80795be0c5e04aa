"""Bad data: every case is refused with the right reason, or answered right; and the table can tell."""

import numpy as np
import pytest

from drivers.errors import CalibrationError
from rig.benchmark.calibration import (
    degenerate_gel,
    degenerate_hand_eye,
    degenerate_images,
    degenerate_streams,
    degenerate_views,
)
from rig.benchmark.calibration.degenerate import Case, answered, refused, run_cases

CASES = [
    *degenerate_hand_eye.cases(),
    *degenerate_images.cases(),
    *degenerate_views.cases(),
    *degenerate_streams.cases(),
    *degenerate_gel.cases(),
]


@pytest.mark.parametrize("group", sorted({case.group for case in CASES}))
def test_bad_data_is_refused_or_right(group: str) -> None:
    once = [Case(c.group, c.name, c.run, c.reasons) for c in CASES if c.group == group]
    wrong = [(r.case.name, r.said) for r in run_cases(once, seed=1) if r.wrong]
    assert wrong == []


def test_the_table_tells_silence_crashes_and_wrong_reasons() -> None:
    def crash(_: np.random.Generator) -> None:
        raise ZeroDivisionError

    def typed(_: np.random.Generator) -> None:
        raise CalibrationError("too few samples")

    cases = [
        Case("g", "silent", lambda _: answered(2.0, 1.0)),
        Case("g", "nan", lambda _: answered(float("nan"), 1.0)),
        Case("g", "another reason", lambda _: refused("it rains"), ("parallel",)),
        Case("g", "crash", crash, ("parallel",)),  # type: ignore[arg-type]
        Case("g", "refused though right was asked", typed),  # type: ignore[arg-type]
        Case("g", "right", lambda _: answered(0.5, 1.0)),
        Case("g", "refused", typed, ("too few",), draws=3),  # type: ignore[arg-type]
    ]
    results = run_cases(cases)
    assert [r.wrong for r in results] == [1, 1, 1, 1, 1, 0, 0]
    assert (results[-1].refused, results[-2].right) == (3, 1)
