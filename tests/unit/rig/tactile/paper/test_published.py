"""The published script as it is, faults included."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.tactile.paper.published import ANGLES, ScriptError, skeleton_angle


def authors_mask(real_data: Path, name: str) -> NDArray[np.uint8]:
    mask = cv2.imread(str(real_data / "aurova_figures" / name), cv2.IMREAD_GRAYSCALE)
    return np.where(mask > 127, 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "angle_deg", "tolerance_deg"),
    [("ellipse", 87.76, 0.01), ("pca", 86.91, 0.01), ("skeleton", 88.72, 0.05)],
)
def test_published_angles_are_reproduced(
    real_data: Path, name: str, angle_deg: float, tolerance_deg: float
) -> None:
    assert ANGLES[name](authors_mask(real_data, "digit_mask.png")) == pytest.approx(
        angle_deg, abs=tolerance_deg
    )


def test_published_angle_of_the_round_contact_is_reproduced(real_data: Path) -> None:
    angle_deg = skeleton_angle(authors_mask(real_data, "limitation_mask.png"))
    assert angle_deg == pytest.approx(37.42, abs=0.01)


@pytest.mark.parametrize("name", ANGLES)
def test_without_contour_there_is_no_angle_and_with_few_points_it_raises(name: str) -> None:
    mask = np.zeros((320, 256), np.uint8)
    assert ANGLES[name](mask) is None
    mask[100:102, 100:102] = 255
    with pytest.raises(ScriptError, match="5 points"):
        ANGLES[name](mask)
