"""The published script as it is, faults included."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.tactile.paper.published import ANGLES, ScriptError, ScriptFilter, ellipse_angle, skeleton_angle

Draw = Callable[..., NDArray[np.uint8]]


def authors_mask(real_data: Path, name: str) -> NDArray[np.uint8]:
    mask = cv2.imread(str(real_data / "aurova_figures" / name), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    return np.where(mask > 127, 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "angle_deg", "tolerance_deg"),
    [("ellipse", 87.76, 0.01), ("pca", 86.91, 0.01), ("skeleton", 88.72, 0.05)],
)
def test_the_authors_printed_angles_come_out(
    real_data: Path, name: str, angle_deg: float, tolerance_deg: float
) -> None:
    assert ANGLES[name](authors_mask(real_data, "digit_mask.png")) == pytest.approx(
        angle_deg, abs=tolerance_deg
    )


def test_the_authors_printed_angle_of_the_round_contact_comes_out(real_data: Path) -> None:
    angle_deg = skeleton_angle(authors_mask(real_data, "limitation_mask.png"))
    assert angle_deg == pytest.approx(37.42, abs=0.01)


def test_angles_are_clockwise_positive(drawn_mask: Draw) -> None:
    mask = drawn_mask(-30, size=(256, 320))
    assert ellipse_angle(mask) == pytest.approx(30, abs=0.3)


@pytest.mark.parametrize("name", ANGLES)
def test_without_contour_there_is_no_angle_and_with_few_points_it_raises(name: str) -> None:
    mask = np.zeros((320, 256), np.uint8)
    assert ANGLES[name](mask) is None
    mask[100:102, 100:102] = 255
    with pytest.raises(ScriptError, match="5 points"):
        ANGLES[name](mask)


def test_the_window_answers_from_the_nth_angle_and_then_slides() -> None:
    script = ScriptFilter(3)
    given_deg = [10.0, 12.0, 14.0, 16.0, 22.0]
    assert [script.update(angle) for angle in given_deg] == pytest.approx([0, 0, 0, 2, 16 / 3])


def test_no_contact_leaves_the_window_as_it_is() -> None:
    script = ScriptFilter(2)
    assert [script.update(a) for a in (10.0, None, 20.0, None, 40.0)] == pytest.approx([0, 0, 0, 0, 15])
