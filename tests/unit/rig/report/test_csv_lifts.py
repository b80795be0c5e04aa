"""Reports of CSV tables: the paper's curves, and tables of other tools."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from drivers.errors import InputError
from rig.report.curves_page import read_table, read_tables
from rig.report.write import write_report

pytestmark = pytest.mark.usefixtures("quick_pages")
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


@pytest.mark.heavy
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
        assert lift.re.mean_deg == pytest.approx(float(row["mean_abs_diff_deg"]), abs=0.006)
        # read off by eye there, means of the last 0.3 s here
        assert lift.final_truth_deg == pytest.approx(float(row["aruco_final_deg"]), abs=1.0)
        assert lift.onset_truth_s is not None
    page = write_report([folder], tmp_path / "old.html").path.read_text()
    assert page.count("<svg") == 10 + 4
    assert "23.09 ± 16.03" in page


def test_phases_are_found_from_the_reference_and_times_count_from_the_first_row(tmp_path: Path) -> None:
    path = ramp(tmp_path / "lift.csv")
    lift = read_table(path)
    assert lift.begins_s["B"] == pytest.approx(1.05, abs=0.02)
    assert lift.begins_s["C"] == pytest.approx(1.95, abs=0.03)
    assert lift.re.mean_deg == pytest.approx(1.0, abs=1e-6)
    lines = path.read_text().splitlines()
    later = [f"{float(t) + 946684809.0:.3f},{rest}" for t, rest in (line.split(",", 1) for line in lines[1:])]
    absolute = read_table(table(tmp_path / "absolute.csv", lines[0], later))
    assert absolute.onset_truth_s == pytest.approx(lift.onset_truth_s, abs=1e-3)


def test_held_lift_has_no_phases_and_counts_as_a_whole(tmp_path: Path) -> None:
    lift = read_table(table(tmp_path / "held.csv", HEAD, [f"{0.1 * i:.1f},0.2,0.0" for i in range(30)]))
    assert lift.begins_s == {}
    assert lift.within("B").all()
    assert lift.re.mean_deg == pytest.approx(0.2)


def test_column_names_separators_and_refusals_of_other_tools_are_read(tmp_path: Path) -> None:
    for head, comma in (
        ("time_s,pred_deg,aruco_deg", ","),
        ("t_s,angle_deg,marker_deg", ";"),
        (" T_S ,Estimate_Deg,TRUTH_DEG", ","),
    ):
        assert read_table(ramp(tmp_path / "lift.csv", head=head, comma=comma)).re is not None
    rows = ["# a comment", "0.0,,0.0", "0.1,nan,0.0", "0.2,2.0,0.0", "0.3,2.0,", "0.4"]
    lift = read_table(table(tmp_path / "lift.csv", HEAD, rows))
    assert np.isnan(lift.estimate.angle_deg).sum() == 3
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
    assert not math.isnan(read_table(path).truth.angle_deg[0])


@pytest.mark.heavy
def test_a_lift_whose_sigma_does_not_cover_its_errors_is_named(tmp_path: Path) -> None:
    for name, sigma_deg in (("fine", 1.0), ("overrated", 0.1)):
        rows = [f"{0.02 * i:.2f},{0.1 * i + 0.6:.2f},{0.1 * i:.2f},{sigma_deg}" for i in range(200)]
        table(tmp_path / f"{name}.csv", "t_s,estimate_deg,truth_deg,sigma_deg", rows)
    page = write_report([tmp_path], tmp_path / "page.html").path.read_text()
    assert "More than 30% of the frames are beyond 2 sigma in overrated (100%)." in page
    assert "fine (" not in page


def wrapped(angle: np.ndarray, period: float) -> np.ndarray:
    return (angle + period / 2) % period - period / 2


@pytest.mark.parametrize(
    ("sign", "both", "offset"), [(1, False, 0.0), (-1, True, -360.0), (1, True, 7.0), (-1, False, 7.0)]
)
def test_wrapped_truth_gives_the_errors_of_the_plain_one(
    tmp_path: Path, sign: int, both: bool, offset: float, caplog: pytest.LogCaptureFixture
) -> None:
    truth = sign * TRUTH_DEG
    seen = wrapped(truth, 360.0)
    estimate = truth + seen[0] - truth[0] + 0.3  # as the first sample was wrapped
    if both:
        estimate = wrapped(estimate, 360.0)
    columns = zip(TIMES_S, estimate, seen, strict=True)
    lift = read_table(table(tmp_path / "x.csv", HEAD, [f"{t:.4f},{e:.4f},{g:.4f}" for t, e, g in columns]))
    assert lift.re.mean_deg == pytest.approx(0.3, abs=1e-3)
    assert "the true angle is wrapped: 1 step of more than 90 degrees" in lift.notes[0]
    score = rig.score(rig.Angles(TIMES_S, estimate + offset), rig.Angles(TIMES_S, seen + offset))
    assert score.mean_deg == pytest.approx(0.3, abs=1e-6)
    assert "the true angle is wrapped" in caplog.text


GAPPY = wrapped(5.0 * np.arange(120.0), 360.0)
GAPPY[[35, 36, 37, 50]] = np.nan
AXIS = 60.0 + np.clip(40.0 * (TIMES_S - 1.0), 0.0, 70.0)
FLIPPED = np.where(np.arange(120) > 60, TRUTH_DEG + 180.0, TRUTH_DEG)
IN_A_GAP, JUMP = (0.0, 0.02, 0.42, 0.44), np.array([0.0, 0.0, 40.0, 41.0])
UNWRAPPED = "is wrapped: 1 step of more than 90 degrees (first at 0.420 s), unwrapped"
KEPT = "may be wrapped: 1 step of more than 90 degrees (first at {:.3f} s), kept"


@pytest.mark.parametrize(
    ("times_s", "estimate", "truth", "largest_deg", "note"),
    [
        (TIMES_S, AXIS, wrapped(AXIS, 180.0), 0.0, "the true angle is wrapped"),
        (TIMES_S, 5.0 * np.arange(120.0), GAPPY, 0.0, "the true angle is wrapped"),
        (TIMES_S, FLIPPED, TRUTH_DEG, 180.0, ""),
        (IN_A_GAP, JUMP, JUMP - [0.0, 0.0, 180.0, 180.0], 0.0, UNWRAPPED),
        (IN_A_GAP, JUMP, JUMP - [0.0, 0.0, 360.0, 360.0], 0.0, UNWRAPPED),
        *(
            ((0.0, 0.02, 0.02 + gap_s, 0.04 + gap_s), (0.0, 0.0, turn - 1.0, turn), (0.0, 0.0, turn, turn),
             1.0, KEPT.format(0.02 + gap_s))
            for turn, gap_s in ((95.0, 0.5), (-170.0, 0.9), (360.0, 2.0))
        ),
    ],
    ids=["axis", "gaps", "wrong estimate", "half turn", "full turn", "95 deg", "-170 deg", "360 deg"],
)  # fmt: skip
def test_steps_that_no_object_can_turn_are_unwrapped_and_others_kept_with_a_note(
    times_s: Any, estimate: Any, truth: Any, largest_deg: float, note: str, caplog: pytest.LogCaptureFixture
) -> None:
    score = rig.score(rig.Angles(times_s, estimate), rig.Angles(times_s, truth))
    assert score.max_deg == pytest.approx(largest_deg, abs=1e-9)
    assert note in caplog.text
    assert note or not caplog.text
