"""RE and MARE as the paper and the contract define them."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.results.metrics import hold_last, mare, summarize


def test_a_lift_is_its_mean_deviation_and_maximum() -> None:
    summary = summarize(np.array([1.0, 3.0]))
    assert summary is not None
    assert (summary.mean_deg, summary.std_deg, summary.max_deg, summary.frames) == (2.0, 1.0, 3.0, 2)
    assert summarize(np.array([])) is None


def test_mare_is_a_mean_over_lifts_not_over_frames() -> None:
    result = mare([1.0, 3.0], [0.5, 1.5])
    assert result is not None
    assert (result.mean_deg, result.std_deg, result.lifts) == (2.0, 1.0, 2)
    assert mare([], []) is None


@given(st.lists(st.floats(0.0, 90.0), min_size=2, max_size=30))
def test_the_interval_contains_the_mean(means: list[float]) -> None:
    result = mare(means, means)
    assert result is not None
    assert result.low_deg is not None
    assert result.high_deg is not None
    assert result.low_deg - 1e-9 <= result.mean_deg <= result.high_deg + 1e-9


def test_one_lift_has_no_interval() -> None:
    result = mare([1.0], [0.1])
    assert result is not None
    assert result.low_deg is None


def test_refusing_does_not_pay() -> None:
    assert hold_last([None, 2.0, None, 5.0]).tolist() == [0.0, 2.0, 2.0, 5.0]


def test_the_authors_real_curves_give_the_stated_differences(real_data: Path) -> None:
    """The same metric on curves of real lifts, digitised from the paper's plots."""
    folder = real_data / "aurova_figures" / "curves"
    with (folder / "summary.csv").open() as stream:
        stated = {row["object"]: float(row["mean_abs_diff_deg"]) for row in csv.DictReader(stream)}
    for name, expected in stated.items():
        curve = np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)
        errors = np.abs(curve["pred_deg"] - curve["aruco_gt_deg"])
        summary = summarize(errors[np.isfinite(errors)])
        assert summary is not None
        assert summary.mean_deg == pytest.approx(expected, abs=0.02)
