"""RE and MARE as the paper and the contract define them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.results.metrics import Floats, hold_last, mare_of, mean_interval, over_lifts, summarize
from rig.sessions.records import ErrorSummary


def test_errors_of_a_lift_have_mean_deviation_and_maximum() -> None:
    summary = summarize(np.array([1.0, 1.0, 2.0, 2.0, 14.0]))
    assert summary is not None
    assert (summary.mean_deg, summary.std_deg**2, summary.max_deg) == pytest.approx((4.0, 25.2, 14.0))
    assert summary.frames == 5
    assert summarize(np.array([])) is None


def errors(*means_deg: float | None) -> list[ErrorSummary | None]:
    """Lifts with these mean errors; None for a refused lift."""
    return [None if mean is None else ErrorSummary(mean, mean / 2, 2 * mean, 100) for mean in means_deg]


def test_mare_is_a_mean_over_lifts_beside_which_refused_ones_are_counted() -> None:
    few = mare_of(errors(1.0, 3.0))
    assert few is not None
    assert (few.mean_deg, few.std_deg, few.lifts) == (2.0, 1.0, 2)
    assert mare_of([]) is None
    assert (over_lifts(0, 1), over_lifts(1, 0)) == ("over 0 of 1 lift, 1 refused", "over 1 lift")
    result = mare_of(errors(1.0, None, 3.0, 2.0, 1.5, 2.5))
    assert result is not None
    assert (result.lifts, result.refused) == (5, 1)
    assert result.text.endswith("] over 5 of 6 lifts, 1 refused")
    assert mare_of(errors(None, None)) is None


def test_fewer_than_five_lifts_have_no_interval() -> None:
    for lifts in range(1, 5):
        result = mare_of(errors(*(0.13 + 0.1 * i for i in range(lifts))))
        assert result is not None
        assert result.low_deg is result.high_deg is result.ends_deg is None
        assert "[" not in result.text
    assert mare_of(errors(0.1, 0.2, 0.3, 0.4, 0.5)).ends_deg is not None  # type: ignore[union-attr]


@given(st.lists(st.floats(0.0, 90.0), min_size=5, max_size=30))
def test_interval_contains_the_mean_and_no_negative_error(means: list[float]) -> None:
    result = mare_of(errors(*means))
    assert result is not None
    assert result.low_deg is not None
    assert result.high_deg is not None
    assert 0.0 <= result.low_deg <= result.mean_deg + 1e-9
    assert result.mean_deg <= result.high_deg + 1e-9


def interval(values: Floats) -> tuple[float, float]:
    low, high = mean_interval(values)
    assert low is not None
    assert high is not None
    return low, high


def test_interval_reaches_further_towards_the_long_tail() -> None:
    low, high = interval(np.array([1.0, 1.1, 0.9, 1.0, 6.0]))
    assert high - 2.0 > 1.5 * (2.0 - low)
    assert interval(-np.array([1.0, 1.1, 0.9, 1.0, 6.0])) == pytest.approx((-high, -low))


@pytest.mark.heavy
@pytest.mark.parametrize("lifts", [5, 10, 20])
@pytest.mark.parametrize(
    ("spread", "least", "most"), [(0.3, 0.93, 0.975), (0.5, 0.92, 0.97), (0.8, 0.89, 0.96)]
)
def test_interval_covers_the_true_mean_of_skewed_errors(
    lifts: int, spread: float, least: float, most: float
) -> None:
    """Log-normal errors; the percentile bootstrap covers 76 to 86 % with a spread of 0.8."""
    rng = np.random.default_rng(38)
    true = np.exp(spread**2 / 2)
    samples = rng.lognormal(0.0, spread, (2000, lifts))
    covered = np.mean([low <= true <= high for low, high in map(interval, samples)])
    assert least <= covered <= most


@pytest.mark.heavy
@pytest.mark.parametrize("lifts", [5, 10, 20])
def test_no_winner_is_named_between_equal_sides_more_than_once_in_twenty(lifts: int) -> None:
    rng = np.random.default_rng(38)
    samples = rng.lognormal(0.0, 0.8, (2000, lifts)) - rng.lognormal(0.0, 0.8, (2000, lifts))
    assert np.mean([low > 0.0 or high < 0.0 for low, high in map(interval, samples)]) <= 0.05


def test_refused_frames_hold_the_last_angle() -> None:
    assert hold_last([None, 2.0, None, 5.0]).tolist() == [0.0, 2.0, 2.0, 5.0]
