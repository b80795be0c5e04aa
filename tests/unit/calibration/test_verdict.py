"""Verdicts: every number that was compared is kept with its limits."""

import numpy as np
import pytest

from calibration.verdict import Check, Verdict, floor, limit

OFFSET = "known to {value:.1f} ms only: wiggle faster"


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(0.5, Verdict.GOOD), (2.0, Verdict.WEAK), (9.0, Verdict.REFUSED), (np.nan, Verdict.REFUSED)],
)
def test_limit_keeps_the_number_its_limits_and_the_result(value: float, verdict: Verdict) -> None:
    found = limit(value, 1.0, 5.0, OFFSET)
    assert found.checks == (Check(f"known to {value:.1f} ms", "at most 1", "at most 5", verdict),)
    assert found.verdict is verdict
    assert bool(found.reasons) == (verdict is not Verdict.GOOD)


def test_checks_are_joined_in_order_and_may_have_their_own_words() -> None:
    found = floor(12, 10, 5, "{value} samples; 15 are good") + limit(
        0.2, 0.4, np.inf, "errors are alike ({value:.2f}; noise: 0)", "correlation: {value:.2f}"
    )
    assert [(check.what, check.good, check.usable) for check in found.checks] == [
        ("12 samples", "at least 10", "at least 5"),
        ("correlation: 0.20", "at most 0.4", "any"),
    ]
    assert found.verdict is Verdict.GOOD
