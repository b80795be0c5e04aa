"""Detect whether a frame shows a contact, and roughly where: the first and fastest stage.

Also when a contact counts as touch.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.settling import Levels

TOUCH_FRAMES = 2
"""Number of consecutive frames with contact that count as a touch."""


@dataclass(slots=True)
class TouchDebounce:
    """Counts the consecutive frames of one fingertip that show contact."""

    frames: int = 0

    def update(self, contact: bool) -> None:
        """Process the contact of the next frame."""
        self.frames = self.frames + 1 if contact else 0

    @property
    def sure(self) -> bool:
        """Whether the last `TOUCH_FRAMES` frames all showed contact."""
        return self.frames >= TOUCH_FRAMES


# Standard deviation of the blur of the squared difference, in work pixels: a contact is wider than noise.
ENERGY_BLUR_PX = 1.5
# The strength is the difference that this fraction of the frame's pixels exceeds.
STRENGTH_SHARE = 0.01
# A contact has at least this strength, and at least this multiple of the floor. Drift that gain and offset
# cannot correct stays below both.
LEAST_STRENGTH, LEAST_FLOORS = 0.04, 3.5
# The floor is the difference below which this fraction of the pixels is: even a wide contact leaves them
# free.
FLOOR_SHARE = 0.2
# The region ends where the difference falls to this fraction of the strength.
EDGE_SHARE = 0.25
# Parts with at least this fraction of the largest part's area belong to the contact; smaller ones are specks.
PART_SHARE = 0.2
LEAST_AREA_PX = 12
# At a key frame a video codec changes the whole image slightly (relative difference up to 0.02). A region
# that covers more than WIDE_SHARE of the frame is a contact only if its mean difference exceeds the second
# value.
WIDE_SHARE, LEAST_WIDE_STRENGTH = 0.5, 0.022
# Strength and floor are computed from every third pixel, counted row by row.
LEVEL_STEP = 3


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The region where a frame differs from its background.

    mask: (h, w) uint8, 1 inside the convex hull of the large parts. area_px: its area in work pixels.
    strength: mean relative difference inside.
    """

    mask: Image
    area_px: int
    strength: float

    @property
    def levels(self) -> Levels:
        """Area and strength, from which `Settling` detects whether the contact still grows."""
        return self.area_px, self.strength


def find_contact(difference: NDArray[np.float32]) -> Region | None:
    """Return the contact region of a relative difference (h, w, 3), None without contact."""
    squares = cv2.transform(cv2.multiply(difference, difference), np.ones((1, 3), np.float32))
    energy = np.asarray(cv2.sqrt(cv2.GaussianBlur(squares, (0, 0), ENERGY_BLUR_PX)), np.float32)
    levels = energy.reshape(-1)[::LEVEL_STEP]
    floor_at, strength_at = int(FLOOR_SHARE * levels.size), int((1.0 - STRENGTH_SHARE) * levels.size)
    ordered = np.partition(levels, (floor_at, strength_at))
    floor, strength = float(ordered[floor_at]), float(ordered[strength_at])
    if strength < max(LEAST_STRENGTH, LEAST_FLOORS * floor):
        return None
    split = (energy > EDGE_SHARE * strength).astype(np.uint8)
    split = cv2.morphologyEx(split, cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    parts, _ = cv2.findContours(split, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not parts:
        return None
    areas = [cv2.contourArea(part) for part in parts]
    large = [part for part, area in zip(parts, areas, strict=True) if area >= PART_SHARE * max(areas)]
    mask = np.zeros(energy.shape, np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.concatenate(large)), 1)
    area = int(cv2.countNonZero(mask))
    mean = cv2.mean(energy, mask)[0]
    if area < LEAST_AREA_PX or (area > WIDE_SHARE * mask.size and mean < LEAST_WIDE_STRENGTH):
        return None
    return Region(mask, area, mean)
