"""Reports of CSV tables: the paper's curves, and tables of other tools."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import rig
from drivers.errors import InputError
from rig.report.curves_page import read_table, read_tables
from rig.report.write import write_report

HEAD = "t_s,estimate_deg,truth_deg"
TIMES_S = np.arange(120) / 30
TRUTH_DEG = 150.0 + np.clip(40.0 * (TIMES_S - 1.0), 0.0, 70.0)


def table(path: Path, head: str, rows: list[str]) -> Path:
    path.write_text(head + "\n" + "\n".join(rows) + "\n")
    return path


def ramp(path: Path, error_deg: float = 1.0, head: str = HEAD, comma: str = ",") -> Path:
    times = np.arange(0.0, 4.0, 0.02)
    truth = 10.0 * np.clip(times - 1.0, 0.0, 1.0)
    rows = [f"{t:.3f}{comma}{a + error_deg:.4f}{comma}{a:.4f}" for t, a in zip(times, truth, strict=True)]
    return table(path, head.replace(",", comma), rows)


def test_ten_real_lifts_have_the_published_errors(real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "aurova_figures" / "curves"
    summary = (folder / "summary.csv").read_text().splitlines()
    known = {row["object"]: row for row in csv.DictReader(summary)}
    lifts, notes = read_tables([folder])
    assert len(lifts) == 10
    (note,) = notes
    assert "summary.csv" in note
    for lift in lifts:
        row = known[lift.name.replace(" ", "_")]
        assert lift.re is not None
        assert lift.re.mean_deg == pytest.approx(float(row["mean_abs_diff_deg"]), abs=0.006)
        # read off by eye there, means of the last 0.3 s here
        assert lift.final_truth_deg == pytest.approx(float(row["aruco_final_deg"]), abs=1.0)
        assert lift.curves.onset_truth_s is not None
    page = write_report([folder], tmp_path / "old.html").path.read_text()
    assert page.count("<svg") == 10 + 4
    assert "23.09 ± 16.03" in page


def test_phases_are_found_from_the_reference_angle(tmp_path: Path) -> None:
    lift = read_table(ramp(tmp_path / "lift.csv"))
    assert lift.curves.phases_s["B"] == pytest.approx(1.05, abs=0.02)
    assert lift.curves.phases_s["C"] == pytest.approx(1.95, abs=0.03)
    assert lift.re is not None
    assert lift.re.mean_deg == pytest.approx(1.0, abs=1e-6)


def test_times_count_from_the_first_row(tmp_path: Path) -> None:
    path = ramp(tmp_path / "lift.csv")
    relative = read_table(path)
    lines = path.read_text().splitlines()
    later = [f"{float(t) + 946684809.0:.3f},{rest}" for t, rest in (line.split(",", 1) for line in lines[1:])]
    absolute = read_table(table(tmp_path / "absolute.csv", lines[0], later))
    assert absolute.curves.onset_truth_s == pytest.approx(relative.curves.onset_truth_s, abs=1e-3)


def test_held_lift_has_no_phases_and_counts_as_a_whole(tmp_path: Path) -> None:
    rows = [f"{0.1 * i:.1f},0.2,0.0" for i in range(30)]
    lift = read_table(table(tmp_path / "held.csv", HEAD, rows))
    assert lift.curves.phases_s == {}
    assert lift.curves.within("B").all()
    assert lift.re is not None
    assert lift.re.mean_deg == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("head", "comma"),
    [
        ("time_s,pred_deg,aruco_deg", ","),
        ("t_s,angle_deg,marker_deg", ";"),
        (" T_S ,Estimate_Deg,TRUTH_DEG", ","),
    ],
)
def test_column_names_and_separators_of_other_tools_are_read(tmp_path: Path, head: str, comma: str) -> None:
    assert read_table(ramp(tmp_path / "lift.csv", head=head, comma=comma)).re is not None


def test_empty_and_nan_are_refusals(tmp_path: Path) -> None:
    rows = ["# a comment", "0.0,,0.0", "0.1,nan,0.0", "0.2,2.0,0.0", "0.3,2.0,", "0.4"]
    lift = read_table(table(tmp_path / "lift.csv", HEAD, rows))
    assert np.isnan(lift.curves.estimate.angle_deg).sum() == 3
    assert lift.re is not None
    assert lift.re.frames == 1


@pytest.mark.parametrize(
    ("head", "rows", "said"),
    [
        ("t_s,estimate_deg", ["0,1", "1,2"], "no column truth_deg"),
        (HEAD, ["0,1,2", "1,x,2"], "line 3: estimate_deg 'x' is not a number"),
        (HEAD, ["0,1,2", "0,1,2"], "times do not increase"),
        (HEAD, ["0,1,2"], "holds 1 row;"),
        (HEAD, ["0,1,2", "inf,1,2"], "t_s 'inf' is not a number"),
        (HEAD, ["0,1,2", "1e10,1,2"], "beyond 9e"),
        ("t_s;estimate_deg;truth_deg", ["0,5;1;2", "1,5;1;2"], "line 2: t_s '0,5' has a comma"),
    ],
)
def test_invalid_table_is_rejected_with_its_line(
    tmp_path: Path, head: str, rows: list[str], said: str
) -> None:
    with pytest.raises(InputError, match=said) as found:
        read_table(table(tmp_path / "lift.csv", head, rows))
    assert "lift.csv" in str(found.value)


def test_table_without_any_estimate_is_reported_as_such(tmp_path: Path) -> None:
    rows = [f"{i},{'nan'},0.0" for i in range(5)]
    path = table(tmp_path / "silent.csv", HEAD, rows)
    page = write_report([path], tmp_path / "page.html").path.read_text()
    assert "No error can be computed for silent" in page
    assert not math.isnan(read_table(path).curves.truth.angle_deg[0])


def test_a_lift_whose_sigma_does_not_cover_its_errors_is_named(tmp_path: Path) -> None:
    for name, sigma_deg in (("fine", 1.0), ("overrated", 0.1)):
        rows = [f"{0.02 * i:.2f},{0.1 * i + 0.6:.2f},{0.1 * i:.2f},{sigma_deg}" for i in range(200)]
        table(tmp_path / f"{name}.csv", "t_s,estimate_deg,truth_deg,sigma_deg", rows)
    page = write_report([tmp_path], tmp_path / "page.html").path.read_text()
    assert "More than 30% of the frames are beyond 2 sigma in overrated (100%)." in page
    assert "fine (" not in page


def wrapped(angle: np.ndarray, period: float) -> np.ndarray:
    return (angle + period / 2) % period - period / 2


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
    columns = zip(TIMES_S, estimate, wrapped(truth, 360.0), strict=True)
    lift = read_table(table(tmp_path / "x.csv", HEAD, [f"{t:.4f},{e:.4f},{g:.4f}" for t, e, g in columns]))
    assert lift.re is not None
    assert lift.re.mean_deg == pytest.approx(0.3, abs=1e-3)
    assert "the true angle is wrapped: 1 step of more than 90 degrees" in lift.curves.notes[0]
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


@pytest.mark.parametrize(("turn_deg", "gap_s"), [(95.0, 0.5), (-170.0, 0.9), (360.0, 2.0)])
def test_large_step_that_an_object_can_turn_in_a_gap_is_kept_with_a_note(
    turn_deg: float, gap_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    times_s = np.array([0.0, 0.02, 0.02 + gap_s, 0.04 + gap_s])
    turned = rig.Angles(times_s, np.array([0.0, 0.0, turn_deg, turn_deg]))
    assert rig.score(turned, turned).max_deg == 0.0
    score = rig.score(rig.Angles(times_s, np.array([0.0, 0.0, turn_deg - 1.0, turn_deg])), turned)
    assert score.max_deg == pytest.approx(1.0)
    assert (
        f"may be wrapped: 1 step of more than 90 degrees (first at {times_s[2]:.3f} s), kept" in caplog.text
    )


@pytest.mark.parametrize("period", [180.0, 360.0])
def test_large_step_that_no_object_can_turn_in_a_gap_is_unwrapped(
    period: float, caplog: pytest.LogCaptureFixture
) -> None:
    times_s = np.array([0.0, 0.02, 0.42, 0.44])
    truth = np.array([0.0, 0.0, 40.0, 41.0])
    seen = truth + np.array([0.0, 0.0, -period, -period])
    assert rig.score(rig.Angles(times_s, truth), rig.Angles(times_s, seen)).max_deg == pytest.approx(0.0)
    assert "is wrapped: 1 step of more than 90 degrees (first at 0.420 s), unwrapped" in caplog.text


def test_plain_angles_and_wrong_estimates_are_left_as_they_are() -> None:
    flipped = np.where(np.arange(120) > 60, TRUTH_DEG + 180.0, TRUTH_DEG)
    score = rig.score(rig.Angles(TIMES_S, flipped), rig.Angles(TIMES_S, TRUTH_DEG))
    assert score.max_deg == pytest.approx(180.0)


def test_field_case_has_the_errors_of_its_plain_twin(real_data: Path) -> None:
    curves = real_data / "field_cases" / "curves"
    plain, other = (read_table(curves / f"{name}.csv") for name in ("plain", "truth_wrapped"))
    assert plain.re is not None
    assert other.re is not None
    assert other.re.mean_deg == pytest.approx(plain.re.mean_deg, abs=0.01)
    assert any("unwrapped" in note for note in read_tables([curves])[1])
