"""The direction of a contour's long axis by the paper's methods, corrected and as published."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from rig.tactile.paper.axis import METHODS, AxisMethod, largest_contour, thin, wrap
from rig.tactile.paper.published import ANGLES, ScriptError, skeleton_angle

EACH_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
# The skeleton is a short line of whole pixels that leans towards their rows and diagonals, the
# more so the wider the ellipse.
TOLERANCE_DEG = {"skeleton_axis": 6.0, "ellipse_axis": 0.2, "pca_axis": 0.2}


def outline(
    angle_deg: float, half_axes: tuple[float, float], center: tuple[float, float] = (120, 160)
) -> NDArray[np.float32]:
    """Points on an ellipse in image coordinates, turned counter-clockwise as seen."""
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    along, across = half_axes[0] * np.cos(t), half_axes[1] * np.sin(t)
    turn = np.radians(angle_deg)
    x = center[0] + along * np.cos(turn) - across * np.sin(turn)
    y = center[1] - along * np.sin(turn) - across * np.cos(turn)
    return np.stack([x, y], axis=1).astype(np.float32).reshape(-1, 1, 2)


@EACH_METHOD
@given(angle_deg=st.floats(-360, 360), long_px=st.floats(75, 110), short_px=st.floats(8, 35))
def test_ellipse_angle_is_counter_clockwise_as_seen(
    method: AxisMethod, angle_deg: float, long_px: float, short_px: float
) -> None:
    axis = method(outline(angle_deg, (long_px, short_px)))
    assert abs(wrap(axis.angle_deg - angle_deg)) < TOLERANCE_DEG[method.__name__]
    assert -90 < axis.angle_deg <= 90


@EACH_METHOD
def test_ellipse_half_outside_the_image_keeps_its_axis(method: AxisMethod) -> None:
    axis = method(outline(-35, (90, 30), center=(-20.3, 5.8)))
    assert abs(wrap(axis.angle_deg + 35)) < TOLERANCE_DEG[method.__name__]


@EACH_METHOD
@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 1, 2), np.int32),
        np.array([[[3, 4]]], np.int32),
        np.array([[0, 0], [4, 0], [4, 4], [0, 4]], np.int32),
        np.full((40, 1, 2), 7, np.int32),
        np.stack([np.arange(50), np.arange(50)], axis=1).astype(np.int32),
        np.stack([np.full(50, 3.0), np.arange(50.0)], axis=1).astype(np.float32),
        np.full((9, 2), np.nan, np.float32),
        np.array([[0, 0], [1, 5], [2, np.inf], [3, 1], [4, 4], [9, 9]], np.float32),
    ],
    ids=["none", "point", "four", "same", "diagonal", "upright", "nan", "infinite"],
)
def test_contour_without_area_has_no_axis(
    method: AxisMethod, points: NDArray[np.int32] | NDArray[np.float32]
) -> None:
    assert method(points) is None


@EACH_METHOD
@given(points=hnp.arrays(np.int32, st.tuples(st.integers(0, 30), st.just(2)), elements=st.integers(-50, 400)))
def test_any_points_give_an_axis_or_none(method: AxisMethod, points: NDArray[np.int32]) -> None:
    axis = method(points)
    assert axis is None or (np.isfinite(axis.angle_deg) and axis.elongation >= 1.0)


def test_the_largest_contour_is_taken() -> None:
    mask = np.zeros((60, 60), np.uint8)
    mask[2:6, 2:6] = 255
    mask[20:50, 10:55] = 255
    contour = largest_contour(mask)
    assert contour is not None
    assert cv2.boundingRect(contour) == (10, 20, 45, 30)
    assert largest_contour(np.zeros((9, 9), np.uint8)) is None


def reference(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.ximgproc.thinning(mask, thinningType=cv2.ximgproc.THINNING_GUOHALL))


@given(
    st.tuples(st.floats(-20, 276), st.floats(-20, 340)),
    st.tuples(st.floats(1, 240), st.floats(1, 120)),
    st.floats(0, 180),
)
def test_thinning_matches_opencv_across_the_border(
    center: tuple[float, float], axes: tuple[float, float], angle_deg: float
) -> None:
    mask = np.zeros((320, 256), np.uint8)
    cv2.ellipse(mask, (center, axes, angle_deg), 255, -1)
    assert np.array_equal(thin(mask), reference(mask))


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
