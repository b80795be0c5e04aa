"""Angles from lines drawn by hand in two passes, and their sigma."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from rig.benchmark.clips.labelled import read_labels
from rig.labels.angle_lines import Line, angle_labels, labels_csv


def line(angle_deg: float, length_px: float = 100.0, middle: tuple[float, float] = (120.0, 160.0)) -> Line:
    """A line whose second end lies counter-clockwise of its first by an angle, as seen."""
    turn, reach = math.radians(angle_deg), length_px / 2
    x, y = reach * math.cos(turn), reach * math.sin(turn)
    return middle[0] - x, middle[1] + y, middle[0] + x, middle[1] - y


def passes(one: dict[int, float], two: dict[int, float]) -> list[dict[int, Line]]:
    return [{frame: line(angle) for frame, angle in each.items()} for each in (one, two)]


def test_angles_count_from_the_reference_counter_clockwise() -> None:
    labels = angle_labels(passes({5: 30, 9: 40, 12: 20}, {5: 31, 9: 43, 12: 21}), 5)
    assert [label.frame for label in labels] == [5, 9, 12]
    assert [label.angle_deg for label in labels] == pytest.approx([0, 11, -10])
    assert labels[0].sigma_deg == 0.0


def test_frames_without_both_lines_are_left_out() -> None:
    labels = angle_labels(passes({0: 0, 1: 5, 2: 9}, {0: 0, 2: 9, 3: 4}), 0)
    assert [label.frame for label in labels] == [0, 2]


SHORT = {0: line(0), 1: line(0, length_px=5)}


@pytest.mark.parametrize(
    ("drawn", "why"),
    [
        (passes({1: 5, 2: 9}, {1: 5, 2: 9}), "the reference frame 0"),
        (passes({0: 5}, {0: 5}), "and one other need a line"),
        (passes({0: 0, 1: 5}, {0: 0, 1: 184}), "frame 1: both passes differ by"),
        ([SHORT, SHORT], "frame 1: its line is shorter than 10 px"),
    ],
)
def test_lines_without_an_angle_are_rejected(drawn: list[dict[int, Line]], why: str) -> None:
    with pytest.raises(InputError, match=why):
        angle_labels(drawn, 0)


@given(st.lists(st.floats(-80, 80), min_size=2, max_size=12), st.floats(-180, 180), st.floats(-180, 180))
def test_labels_do_not_depend_on_the_direction_of_the_drawn_feature(
    turns: list[float], one_deg: float, two_deg: float
) -> None:
    total = [sum(turns[: i + 1]) for i in range(len(turns))]
    drawn = passes(*({i: start + turn for i, turn in enumerate(total)} for start in (one_deg, two_deg)))
    for label, turn in zip(angle_labels(drawn, 0), total, strict=True):
        assert label.angle_deg == pytest.approx(turn - total[0], abs=1e-6)


def test_benchmark_reads_the_written_labels(tmp_path: Path) -> None:
    file = tmp_path / "labels.csv"
    labels = angle_labels(passes({5: 30, 9: 40, 12: 20}, {5: 31, 9: 43, 12: 21}), 5)
    file.write_text(labels_csv(labels, 5))
    reference, read, _ = read_labels(file)
    assert reference == 5
    assert [(label.frame, label.angle_deg) for label in read] == [(9, 11.0), (12, -10.0)]
    sigmas = [label.sigma_deg for label in labels[1:]]
    assert [label.sigma_deg for label in read] == pytest.approx(sigmas, abs=0.005)
