"""Height and normals of a pressed gel, computed with the colour map of `rig calibrate tactile`."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.gradient_map import GradientMap, colour_change
from calibration.store import load
from drivers.errors import CalibrationError
from drivers.formats import reason
from drivers.types import Image
from rig.tactile.slip.height import relief

Field = NDArray[np.float32]
_STEP = 2
"""Every second pixel along x and y is integrated."""
_CONTACT_SLOPE = 0.08
"""Slope (mm/mm) from which the gel counts as dented: three times the rms of untouched gel on 31 presses."""
_SMOOTH_PX = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class GelMap:
    """A unit's map from colour change to slope, and its scale in mm per pixel along x and y."""

    map: GradientMap
    mm_per_px: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class GelShape:
    """The shape of a dented gel, at every second pixel of the image along x and y.

    depth_mm: (h, w), positive into the gel. normals: (h, w, 3), x right, y down, z out of the gel.
    """

    depth_mm: Field
    normals: Field


def read_gel_map(path: Path) -> GelMap:
    """Read the YAML file of `rig calibrate tactile`. Raises `CalibrationError` if it holds no colour map."""
    value = load(path, "tactile").value
    if "gradient_map" not in value:
        raise CalibrationError(
            f"{path}: holds no colour map; press balls with rig calibrate tactile --ball-mm"
        )
    try:
        weights = np.array(value["gradient_map"]["weights"], np.float64)
        shape = int(value["image_height"]), int(value["image_width"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: damaged ({reason(error)}); make it again") from error
    return GelMap(GradientMap(weights, shape), read_scale(path))


def read_scale(path: Path) -> tuple[float, float]:
    """Read mm per pixel along x and y from a file of `rig calibrate tactile`. Raises `CalibrationError`."""
    value = load(path, "tactile").value
    try:
        across, along = (float(v) for v in value["mm_per_px"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{path}: holds no mm_per_px; press balls with rig calibrate tactile"
        ) from error
    return across, along


def gel_shape(image: Image, background: Image, gel: GelMap) -> GelShape:
    """Reconstruct the shape of the gel from an image (H, W, 3) uint8 RGB.

    The colour map gives slopes, and a least squares fit to the slopes gives the depth, which is 0 far from a
    contact. Raises `CalibrationError` if the images do not have the calibrated size.
    """
    if image.shape[:2] != gel.map.shape:
        raise CalibrationError(
            f"the gel's map is for {gel.map.shape} images (rows, columns), not {image.shape}"
        )
    change = colour_change(image, background.astype(np.float32))
    rows, columns = np.mgrid[0 : image.shape[0] : _STEP, 0 : image.shape[1] : _STEP]
    places = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    slopes = gel.map.slopes(change[rows.ravel(), columns.ravel()], places).reshape(*rows.shape, 2)
    steep = cv2.GaussianBlur(np.hypot(slopes[..., 0], slopes[..., 1]), (0, 0), _SMOOTH_PX) > _CONTACT_SLOPE
    per_pixel = _STEP * (slopes[..., 0] * gel.mm_per_px[0] + 1j * slopes[..., 1] * gel.mm_per_px[1])
    depth = relief(per_pixel.astype(np.complex64), steep.astype(np.uint8))
    upward = np.concatenate([-slopes, np.ones((*rows.shape, 1))], axis=2)
    normals = upward / np.linalg.norm(upward, axis=2, keepdims=True)
    return GelShape(depth.astype(np.float32), normals.astype(np.float32))


def depth_picture(shape: GelShape) -> Image:
    """Draw the depth, (h, w, 3) uint8 RGB, from black (untouched) to white (deepest)."""
    deepest = max(float(shape.depth_mm.max()), 1e-6)
    grey = np.clip(shape.depth_mm / deepest * 255.0, 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)


def normals_picture(shape: GelShape) -> Image:
    """Draw the normals, (h, w, 3) uint8 RGB: x, y and z from -1 to 1 as red, green and blue."""
    return np.asarray(np.clip((shape.normals + 1.0) * 127.5, 0, 255), np.uint8)
