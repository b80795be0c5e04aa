"""True angles that are wrapped at half or whole turns are unwrapped, with a note."""

from pathlib import Path

import numpy as np
import pytest

import rig
from rig.report.curves_page import read_table, read_tables

TIMES_S = np.arange(120) / 30
TRUTH_DEG = 150.0 + np.clip(40.0 * (TIMES_S - 1.0), 0.0, 70.0)


def wrapped(angle: np.ndarray, period: float) -> np.ndarray:
    return (angle + period / 2) % period - period / 2


def table(path: Path, estimate: np.ndarray, truth: np.ndarray) -> Path:
    rows = "".join(f"{t:.4f},{e:.4f},{g:.4f}\n" for t, e, g in zip(TIMES_S, estimate, truth, strict=True))
    path.write_text(f"t_s,estimate_deg,truth_deg\n{rows}")
    return path


@pytest.mark.parametrize("offset", [0.0, -360.0, 7.0])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("both", [False, True])
def test_wrapped_truth_gives_the_errors_of_the_plain_one(
    tmp_path: Path, sign: int, both: bool, offset: float, caplog: pytest.LogCaptureFixture
) -> None:
    truth = sign * TRUTH_DEG
    start = wrapped(truth, 360.0)[0] - truth[0]  # how the first sample was wrapped
    estimate = truth + start + 0.3
    if both:
        estimate = wrapped(estimate, 360.0)
    lift = read_table(table(tmp_path / "x.csv", estimate, wrapped(truth, 360.0)))
    assert lift.errors is not None
    assert lift.errors.mean_deg == pytest.approx(0.3, abs=1e-3)
    assert "the true angle is wrapped: 1 steps of more than 90 degrees" in lift.notes[0]
    score = rig.score(
        rig.Angles(TIMES_S, estimate + offset), rig.Angles(TIMES_S, wrapped(truth, 360.0) + offset)
    )
    assert score.mean_deg == pytest.approx(0.3, abs=1e-6)
    assert "the true angle is wrapped" in caplog.text


def test_truth_of_an_axis_is_unwrapped_at_half_turns() -> None:
    truth = 60.0 + np.clip(40.0 * (TIMES_S - 1.0), 0.0, 70.0)
    score = rig.score(rig.Angles(TIMES_S, truth), rig.Angles(TIMES_S, wrapped(truth, 180.0)))
    assert score.mean_deg == pytest.approx(0.0, abs=1e-9)


def test_missing_samples_at_the_wrap_and_several_turns_are_unwrapped() -> None:
    truth = 5.0 * np.arange(120.0)
    seen = wrapped(truth, 360.0)
    seen[[35, 36, 37, 50]] = np.nan
    score = rig.score(rig.Angles(TIMES_S, truth), rig.Angles(TIMES_S, seen))
    assert score.mean_deg == pytest.approx(0.0, abs=1e-9)


def test_plain_angles_and_wrong_estimates_are_left_as_they_are() -> None:
    flipped = np.where(np.arange(120) > 60, TRUTH_DEG + 180.0, TRUTH_DEG)
    score = rig.score(rig.Angles(TIMES_S, flipped), rig.Angles(TIMES_S, TRUTH_DEG))
    assert score.max_deg == pytest.approx(180.0)


def test_field_case_has_the_errors_of_its_plain_twin(real_data: Path) -> None:
    curves = real_data / "field_cases" / "curves"
    plain, other = (read_table(curves / f"{name}.csv") for name in ("plain", "truth_wrapped"))
    assert plain.errors is not None
    assert other.errors is not None
    assert other.errors.mean_deg == pytest.approx(plain.errors.mean_deg, abs=0.01)
    assert any("unwrapped" in note for note in read_tables([curves]).notes)
