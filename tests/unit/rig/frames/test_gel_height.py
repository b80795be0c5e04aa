"""Depth and normals of a pressed gel by its colour map."""

from pathlib import Path

import numpy as np
import pytest

from calibration.gel.gradient_map import FLOOR_GREY, GradientMap
from calibration.store import CalibrationFile, save
from calibration.verdict import Assessment
from drivers.errors import CalibrationError
from rig.frames.estimates import shift_mm
from rig.frames.gel_height import GelMap, gel_shape, read_gel_map

SHAPE, MM_PER_PX, RADIUS_MM, DEEP_MM = (320, 240), (0.06, 0.06), 6.0, 0.5
BACKGROUND = np.full((*SHAPE, 3), 110, np.uint8)


def linear_map() -> GradientMap:
    """The x component of the normal is twice the change of red, the y component twice that of green."""
    from calibration.gel.gradient_map import features

    one = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    count = features(one, np.array([[120.0, 160.0]] * 2), SHAPE).shape[1]
    weights = np.zeros((count, 2))
    system = features(one, np.array([[120.0, 160.0]] * 2), SHAPE)
    for component in range(2):
        # in the middle of the gel only the terms of degree 1 without a place factor are as large
        weights[int(np.flatnonzero(np.abs(system[component]) > 0.09)[0]), component] = 2.0
    return GradientMap(weights, SHAPE)


def pressed() -> tuple[np.ndarray, np.ndarray]:
    """A picture of a smooth dent in the colours of the linear map, and its depth in mm."""
    y, x = np.indices(SHAPE, np.float64)
    x, y = (x - 119.5) * MM_PER_PX[0], (y - 159.5) * MM_PER_PX[1]
    depth = DEEP_MM * np.exp(-(x**2 + y**2) / (2.0 * 1.5**2))
    slopes = -depth[..., None] * np.stack([x, y], -1) / 1.5**2
    normals = -slopes / np.sqrt(1.0 + (slopes**2).sum(-1, keepdims=True))
    change = np.concatenate([normals / 2.0, np.zeros((*SHAPE, 1))], axis=2)
    image = (BACKGROUND + FLOOR_GREY) * np.exp(change) - FLOOR_GREY
    return np.rint(image).astype(np.uint8), depth


def test_depth_of_a_smooth_dent_is_found_in_mm() -> None:
    image, depth = pressed()
    found = gel_shape(image, BACKGROUND, GelMap(linear_map(), MM_PER_PX))
    assert found.depth_mm.shape == (160, 120)
    assert found.depth_mm.max() == pytest.approx(DEEP_MM, rel=0.1)
    assert np.abs(found.depth_mm - depth[::2, ::2]).mean() < 0.03
    assert np.allclose(np.linalg.norm(found.normals, axis=2), 1.0, atol=1e-5)
    assert found.normals[80, 80, 0] > 0.05 > -0.05 > found.normals[80, 40, 0]


def test_image_of_another_size_is_refused() -> None:
    with pytest.raises(CalibrationError, match="not \\(160, 120, 3\\)"):
        gel_shape(BACKGROUND[::2, ::2], BACKGROUND[::2, ::2], GelMap(linear_map(), MM_PER_PX))


def test_calibration_without_a_colour_map_is_rejected_with_advice(tmp_path: Path) -> None:
    path = tmp_path / "tactile-D1.yaml"
    value = {"image_height": 320, "image_width": 240, "mm_per_px": MM_PER_PX}
    save(
        CalibrationFile("tactile", {"tactile": "D1"}, value, Assessment(), "2026-01-01T00:00:00+00:00"), path
    )
    with pytest.raises(CalibrationError, match="holds no colour map; press balls"):
        read_gel_map(path)
    shown = {"gradient_map": {"weights": linear_map().weights}}
    save(
        CalibrationFile(
            "tactile", {"tactile": "D1"}, value | shown, Assessment(), "2026-01-01T00:00:00+00:00"
        ),
        path,
    )
    assert read_gel_map(path).mm_per_px == MM_PER_PX


def test_shift_is_scaled_along_x_and_y() -> None:
    assert shift_mm((10.0, -20.0), (0.05, 0.06)) == (0.5, -1.2)
    assert shift_mm(None, (0.05, 0.06)) == (None, None)
