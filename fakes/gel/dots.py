"""Markers printed on a simulated gel: a grid of dark dots that move with the gel's surface.

In the contact the surface sticks to the object, rotates and shifts with it. Around the contact the motion
decreases with distance. The rotation of the gel is limited; beyond the limit the object slides over the gel
and the markers stay behind. Size and limit are those in real recordings of a GelSight Mini: dots of 12 px at
a pitch of 26 px and 0.058 mm per px, which move by up to about 1 mm. On a contact of 5 mm radius this is a
rotation of about 10 degrees.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

PITCH_MM, DIAMETER_MM = 1.5, 0.7
TWIST_LIMIT_DEG = 10.0
_JITTER_MM = 0.04
_REACH_MM = 1.5
"""Distance from the contact at which the gel's motion has fallen to 1/e."""
_INK = 0.85
"""Fraction of the light that a dot absorbs."""
_SHIFT = 4
"""Fractional bits of the coordinates for cv2.circle: sixteenths of a pixel."""


@dataclass(frozen=True, slots=True)
class Shear:
    """Motion of the gel's surface in the contact since the first touch.

    twist_deg: rotation about pivot_mm, counter-clockwise as seen. drag_mm: shift. pivot_mm and drag_mm: x
    right, y down in mm; pivot_mm from the image centre.
    """

    twist_deg: float = 0.0
    pivot_mm: tuple[float, float] = (0.0, 0.0)
    drag_mm: tuple[float, float] = (0.0, 0.0)


def shear_of(turned_deg: float, pivot_mm: tuple[float, float], slid_mm: tuple[float, float]) -> Shear:
    """Return the motion of a gel under an object that has turned and slid.

    The gel follows small rotations completely and large ones up to a limit: its rotation is the limit times
    tanh(rotation / limit). It follows the same fraction of the slide. The remainder is slip.
    """
    twist = TWIST_LIMIT_DEG * math.tanh(turned_deg / TWIST_LIMIT_DEG)
    share = twist / turned_deg if abs(turned_deg) > 1e-9 else 1.0
    return Shear(twist, pivot_mm, (share * slid_mm[0], share * slid_mm[1]))


class MarkerPrint:
    """The markers of one unit. shape: (rows, columns) of its images. seed: of the dots' position errors."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float], seed: int) -> None:
        self.shape, self.mm_per_px, rng = shape, mm_per_px, np.random.default_rng((seed, 43))
        half = [0.5 * n * mm for n, mm in zip(shape[::-1], mm_per_px, strict=True)]
        x, y = (np.arange(-round(h / PITCH_MM), round(h / PITCH_MM) + 1) * PITCH_MM for h in half)
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self._places_mm = grid + rng.uniform(-0.3, 0.3, 2) + rng.normal(0.0, _JITTER_MM, grid.shape)

    def light_left(self, shear: Shear | None, touching: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """Return the transmitted fraction of light, (H, W, 1). touching: (H, W), true in the contact."""
        places = self._places_mm
        if shear is not None and touching is not None and touching.any():
            places = places + self._displacements_mm(shear, touching)
        ink = np.zeros(self.shape, np.uint8)
        radius = round(0.5 * DIAMETER_MM / self.mm_per_px[0] * (1 << _SHIFT))
        for column, row in np.rint(self._pixels(places) * (1 << _SHIFT)).astype(int).tolist():
            cv2.circle(ink, (column, row), radius, 255, cv2.FILLED, cv2.LINE_AA, _SHIFT)
        ink = cv2.GaussianBlur(ink, (0, 0), 0.8)
        return (1.0 - (_INK / 255.0) * ink.astype(np.float32))[..., None]

    def _displacements_mm(self, shear: Shear, touching: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the displacement of each marker, (N, 2) mm."""
        apart_px = cv2.distanceTransform((~touching).astype(np.uint8), cv2.DIST_L2, 5)
        columns, rows = np.rint(self._pixels(self._places_mm)).astype(int).T
        rows, columns = rows.clip(0, self.shape[0] - 1), columns.clip(0, self.shape[1] - 1)
        share = np.exp(-apart_px[rows, columns] * self.mm_per_px[0] / _REACH_MM)
        turn = math.radians(shear.twist_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        # with y down, a counter-clockwise rotation as seen maps (1, 0) to (cos, -sin)
        rays = self._places_mm - shear.pivot_mm
        return share[:, None] * (rays @ np.array([[cos - 1.0, -sin], [sin, cos - 1.0]]) + shear.drag_mm)

    def _pixels(self, places_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        middle = 0.5 * (np.array(self.shape[::-1]) - 1.0)
        return places_mm / np.array(self.mm_per_px) + middle
