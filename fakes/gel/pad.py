"""The gel pad of a simulated fingertip: computes its dent by an object's surface.

Image axes in mm: x right, y down, origin at the image centre. Angles are image angles,
counter-clockwise positive as seen. The geometry is computed at half the image's resolution.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fakes.gel.dots import Shear
from fakes.gel.variation import FAMILY, Look, Variation
from fakes.objects.surfaces import FAR_MM, GEL_DOME_RADIUS_MM, Bulge, Surface

HALF = 2
"""Image pixels per pixel of the geometry."""
_MIN_LAG_DEG = 1e-3
_TOUCHING_MM = 0.004
_MARKS_SHOW_MM = 0.15
"""Depth at which specks and scratches of the gel are fully visible."""

DepthMap = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Imprint:
    """An object's face pressed against the gel.

    angle_deg: image angle of the object's x axis. centre_mm: position of the surface's origin from the image
    centre (x right, y down). depth_mm: depth of that origin below the highest point of the undented gel.
    tilt: slope of the object's face against the gel along image x and y, mm/mm (positive recedes to the right
    and downwards). lag_deg: angle by which the gel around the contact trails behind the object. shear: motion
    of the gel's surface with the object, visible only by printed markers. bulge: a broad body behind the
    face, centred bulge_mm from the image centre, that does not turn; None without one.
    """

    surface: Surface
    angle_deg: float
    centre_mm: tuple[float, float] = (0.0, 0.0)
    depth_mm: float = 0.3
    tilt: tuple[float, float] = (0.0, 0.0)
    lag_deg: float = 0.0
    shear: Shear | None = None
    bulge: Bulge | None = None
    bulge_mm: tuple[float, float] = (0.0, 0.0)


class GelPad:
    """One unit's pad: image size in pixels, scale along x and y, convexity of its face, and its gel.

    look: of a real unit; its membrane then replaces that of the variation. A film of the variation that is
    wider than the family's then smooths the dent further. None for a simulated unit.
    """

    def __init__(
        self, shape: tuple[int, int], mm_per_px: tuple[float, float],
        dome_radius_mm: float = GEL_DOME_RADIUS_MM, variation: Variation = FAMILY, look: Look | None = None,
    ) -> None:  # fmt: skip
        self.shape, self.mm_per_px, self.variation, self.look = shape, mm_per_px, variation, look
        x_mm, y_mm = pixel_grid_mm(shape, mm_per_px, HALF)
        self._x_mm, self._y_mm = x_mm[None, :], y_mm[:, None]
        self._dome_mm = (self._x_mm**2 + self._y_mm**2) / np.float32(2.0 * dome_radius_mm)
        self._marks_mm = draw_marks(self._dome_mm.shape, HALF * mm_per_px[0], variation.marks_seed)

    def dent(self, imprint: Imprint) -> DepthMap:
        """Return the depth of the dented gel, mm, (H/2, W/2) float32, never negative.

        In the contact the gel follows the object. Around the contact the membrane slopes off over a few mm.
        It is dragged along by the object and may trail behind it.
        """
        gel = self.variation
        pressed = self._press(imprint, imprint.angle_deg)
        dragged = pressed
        if abs(imprint.lag_deg) > _MIN_LAG_DEG:
            dragged = self._press(imprint, imprint.angle_deg - imprint.lag_deg)
        if self.look is not None:
            dent = self.look.dent(pressed, dragged)
            smoother = gel.film_px > FAMILY.film_px
            return np.asarray(cv2.blur(dent, (gel.film_px - 2,) * 2), np.float32) if smoother else dent
        near = cv2.blur(cv2.blur(dragged, (gel.near_skirt_px,) * 2), (gel.near_skirt_px,) * 2)
        far = cv2.blur(cv2.blur(dragged, (gel.far_skirt_px,) * 2), (gel.far_skirt_px,) * 2)
        membrane = cv2.max(near * np.float32(gel.near_share), far * np.float32(gel.far_share))
        dent = np.asarray(cv2.blur(cv2.max(pressed, membrane), (gel.film_px,) * 2), np.float32)
        if self._marks_mm is None:
            return dent
        # specks and scratches of the gel never move, and only pressed gel shows them
        share = np.minimum(dent * np.float32(1.0 / _MARKS_SHOW_MM), np.float32(1.0))
        return np.asarray(dent + self._marks_mm * share, np.float32)

    def touching(self, imprint: Imprint) -> NDArray[np.bool_]:
        """Return the geometric contact, (H, W): true where object and gel touch."""
        height, width = self.shape
        depth = cv2.resize(self._penetration(imprint, imprint.angle_deg), (width, height))
        return np.asarray(depth > _TOUCHING_MM)

    def _press(self, imprint: Imprint, angle_deg: float) -> DepthMap:
        """Return the depth of the gel under the object, mm; flattened in the middle for some units."""
        pressed = np.maximum(self._penetration(imprint, angle_deg), 0.0)
        limit = np.float32(self.variation.flatten_mm)
        return pressed if limit == 0.0 else np.asarray(-limit * np.expm1(-pressed / limit), np.float32)

    def _penetration(self, imprint: Imprint, angle_deg: float) -> DepthMap:
        """Return the depth of the object's surface below the undented gel, mm; negative without contact."""
        depth = self._warp(imprint.surface, angle_deg, imprint.centre_mm)
        tx, ty = imprint.tilt
        cx, cy = imprint.centre_mm
        np.negative(depth, out=depth)
        depth -= self._dome_mm
        depth += np.float32(imprint.depth_mm + tx * cx) - np.float32(tx) * self._x_mm
        depth += np.float32(ty * cy) - np.float32(ty) * self._y_mm
        if imprint.bulge is not None:
            across, down = imprint.bulge_mm
            depth -= imprint.bulge.height(self._x_mm - np.float32(across), self._y_mm - np.float32(down))
        return depth

    def _warp(self, surface: Surface, angle_deg: float, centre_mm: tuple[float, float]) -> DepthMap:
        rows, columns = self._dome_mm.shape
        turn = np.deg2rad(angle_deg)
        cos, sin = np.cos(turn), np.sin(turn)
        # with y down, a counter-clockwise rotation as seen maps (1, 0) to (cos, -sin)
        to_object = np.array([[cos, -sin], [sin, cos]]) / surface.mm_per_px
        scale = np.diag([HALF * self.mm_per_px[0], HALF * self.mm_per_px[1]])
        first = np.array([self._x_mm[0, 0], self._y_mm[0, 0]], np.float64) - centre_mm
        middle = 0.5 * (np.array(surface.height_mm.shape[::-1]) - 1.0)
        # matrix (2, 3) from geometry pixel (column, row, 1) to surface pixel (column, row)
        to_surface = np.column_stack([to_object @ scale, to_object @ first + middle])
        warped = cv2.warpAffine(
            surface.height_mm, to_surface, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT, borderValue=FAR_MM,
        )  # fmt: skip
        return np.asarray(warped, np.float32)


def rotate(x: float, y_down: float, turn_rad: float) -> tuple[float, float]:
    """Rotate an image vector (x right, y down) counter-clockwise in the image."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return c * x + s * y_down, -s * x + c * y_down


def pixel_grid_mm(
    shape: tuple[int, int], mm_per_px: tuple[float, float], step_px: int
) -> tuple[DepthMap, DepthMap]:
    """Return x (of columns) and y (of rows) in mm of the centres of pixels of `step_px` image pixels."""
    rows, columns = shape
    x = (np.arange(0, columns, step_px) + 0.5 * (step_px - 1) - 0.5 * (columns - 1)) * mm_per_px[0]
    y = (np.arange(0, rows, step_px) + 0.5 * (step_px - 1) - 0.5 * (rows - 1)) * mm_per_px[1]
    return x.astype(np.float32), y.astype(np.float32)


def draw_marks(shape: tuple[int, ...], px_mm: float, seed: int | None) -> NDArray[np.float32] | None:
    """Return the depth of specks and scratches in the film, mm, (h, w) float32; None without a seed.

    Scratches are negative. shape, px_mm: shape of the geometry and size of its pixels.
    """
    if seed is None:
        return None
    rng = np.random.default_rng((seed, 59))
    marks = np.zeros(shape, np.float32)
    rows, columns = shape
    for _ in range(int(rng.integers(2, 14))):
        speck = np.zeros(shape, np.float32)
        speck[int(rng.integers(2, rows - 2)), int(rng.integers(2, columns - 2))] = 1.0
        wide_px = float(rng.uniform(0.12, 0.3)) / px_mm
        speck = cv2.GaussianBlur(speck, (0, 0), wide_px)
        marks += np.float32(rng.uniform(0.03, 0.09) / speck.max()) * speck
    for _ in range(int(rng.integers(0, 3))):
        scratch = np.zeros(shape, np.float32)
        start = rng.uniform(0.0, 1.0, 2) * (columns, rows)
        way = rng.uniform(0.0, 2.0 * np.pi)
        end = start + rng.uniform(2.0, 8.0) / px_mm * np.array([np.cos(way), np.sin(way)])
        cv2.line(scratch, start.astype(int).tolist(), end.astype(int).tolist(), 1.0, 1, cv2.LINE_AA)
        scratch = cv2.GaussianBlur(scratch, (0, 0), 0.15 / px_mm)
        marks -= np.float32(rng.uniform(0.015, 0.05)) * scratch / max(float(scratch.max()), 1e-6)
    return marks
