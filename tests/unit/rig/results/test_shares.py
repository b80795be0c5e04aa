"""Shares of samples: percentage and interval, or the numbers of a few samples."""

import pytest

from rig.results.shares import share_of, wilson


@pytest.mark.parametrize(
    ("count", "of", "text"),
    [
        (0, 1, "0 of 1"),
        (4, 4, "4 of 4"),
        (0, 5, "0% [0, 43]"),
        (5, 5, "100% [57, 100]"),
        (14, 38, "37% [23, 53]"),
        (95, 120, "79% [71, 85]"),
    ],
)
def test_percentage_and_interval_are_shown_from_five_samples_on(count: int, of: int, text: str) -> None:
    share = share_of([True] * count + [False] * (of - count))
    assert str(share) == text
    assert float(share) == count / of  # type: ignore[arg-type]


def test_no_samples_have_no_share() -> None:
    assert share_of([]) is None


def test_interval_is_that_of_wilson() -> None:
    """Reference: Newcombe, Statistics in Medicine 17 (1998), table I, method 3."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)
