"""Segment the contact by image processing, without a network.

A frame is compared with the frame without contact of the same sensor, by the relative difference of
`rig.tactile.contact.relative`. Otsu's threshold splits its smoothed magnitude into contact and rest. Limits
on contrast and area decide whether the split shows a contact or only noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.relative import RelativeDifference, upper_median
from rig.tactile.sample import check_frame

# Long side of the reduced copy: half a DIGIT's frame, fine enough because the gel blurs outlines.
WORK_LONG_SIDE_PX = 160
# Standard deviations of the Gaussian blur of the signed difference (reduces noise) and of its magnitude
# (closes the gap between the lit and the shaded side of a contact), in work pixels.
NOISE_BLUR_PX = 1.0
SHAPE_BLUR_PX = 2.0
# Size of the ellipse for opening and closing, which remove streaks of light and fill rims.
MORPH_PX = 7
# Parts with at least this fraction of the largest part's area belong to the same contact, because only the
# edges of a flat face are visible. Smaller parts are mostly streaks of light.
PART_SHARE = 0.5
# A contact begins if the mean relative difference inside exceeds that outside by the first value, and ends
# below the second (hysteresis). Drift that gain and offset cannot correct stays below both.
CONTRAST_ENTER, CONTRAST_LEAVE = 0.035, 0.025
# The same limits in multiples of the frame's pixel noise; a split of pure noise stays below them.
NOISE_ENTER, NOISE_LEAVE = 2.0, 1.5
# Smallest area of a contact as a fraction of the frame: 1 % of a DIGIT is an edge contact 4 mm long.
AREA_ENTER, AREA_LEAVE = 0.01, 0.006


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """The contact in one frame of size (H, W).

    mask: (H, W) uint8, 0 or 255; None without contact. area_px: area of the mask, 0 without contact.
    contour: (N, 1, 2) float32, points about 1 px apart along its outline, x and y in pixels of the
    frame (0 is the centre of the first pixel); empty without contact.
    """

    mask: Image | None
    area_px: float
    contour: NDArray[np.float32]


NO_CONTACT = Contact(None, 0.0, np.empty((0, 1, 2), np.float32))


class ContactFinder:
    """Finds the contact in the frames of one sensor.

    background: (H, W, 3) uint8 RGB, a frame without contact. tightness: factor of the threshold, 0.1 to 10;
    above 1 the mask is smaller, below 1 larger. Frames are independent except for the hysteresis of the
    limits.
    """

    def __init__(self, background: Image, tightness: float = 1.0) -> None:
        check_frame(background)
        if not 0.1 <= tightness <= 10.0:
            raise InputError(f"tightness {tightness} is not between 0.1 and 10")
        self._shape = background.shape
        self._tightness = tightness
        height, width = background.shape[:2]
        scale = min(1.0, WORK_LONG_SIDE_PX / max(height, width))
        self._size = (max(1, round(width * scale)), max(1, round(height * scale)))
        self._light = RelativeDifference(background, self._size)
        self._kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (MORPH_PX, MORPH_PX))
        self._in_contact = False

    def find(self, image: Image) -> Contact:
        """Return the contact in an (H, W, 3) uint8 RGB frame. Raises `InputError` for another size."""
        check_frame(image, self._shape)
        energy, noise = self._energy(image)
        outline = self._outline(energy)
        self._in_contact = outline is not None and self._passes(outline, energy, noise)
        return self._contact(outline) if outline is not None and self._in_contact else NO_CONTACT

    def _energy(self, image: Image) -> tuple[NDArray[np.float32], float]:
        """Return the smoothed magnitude (h, w) of the relative difference, and its pixel noise."""
        raw = self._light.of(self._light.reduce(image))
        smooth = cv2.GaussianBlur(raw, (0, 0), NOISE_BLUR_PX)
        noise = 1.4826 * float(upper_median(np.abs(raw[::8, ::8] - smooth[::8, ::8]).reshape(-1, 1))[0])
        squares = cv2.transform(cv2.multiply(smooth, smooth), np.ones((1, 3), np.float32))
        return np.asarray(cv2.GaussianBlur(cv2.sqrt(squares), (0, 0), SHAPE_BLUR_PX), np.float32), noise

    def _outline(self, energy: NDArray[np.float32]) -> NDArray[np.int32] | None:
        """Return the convex hull of the large parts above the threshold, in work pixels; None without any."""
        peak = float(energy.max())
        if peak <= 0.0:
            return None
        levels = cv2.convertScaleAbs(energy, alpha=255.0 / peak)
        level, _ = cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        _, split = cv2.threshold(levels, min(level * self._tightness, 254.0), 255, cv2.THRESH_BINARY)
        split = cv2.morphologyEx(split, cv2.MORPH_OPEN, self._kernel)
        split = cv2.morphologyEx(split, cv2.MORPH_CLOSE, self._kernel)
        parts, _ = cv2.findContours(split, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        if not parts:
            return None
        least = PART_SHARE * max(map(cv2.contourArea, parts))
        large = np.concatenate([part for part in parts if cv2.contourArea(part) >= least])
        return np.asarray(cv2.convexHull(large), np.int32)

    def _passes(self, outline: NDArray[np.int32], energy: NDArray[np.float32], noise: float) -> bool:
        """Whether area and contrast of the split reach the limits of a contact."""
        inside = np.zeros(energy.shape, np.uint8)
        cv2.fillConvexPoly(inside, outline, 255)
        area = cv2.countNonZero(inside) / inside.size
        contrast = cv2.mean(energy, inside)[0] - cv2.mean(energy, cv2.bitwise_not(inside))[0]
        if self._in_contact:
            return area >= AREA_LEAVE and contrast >= max(CONTRAST_LEAVE, NOISE_LEAVE * noise)
        return area >= AREA_ENTER and contrast >= max(CONTRAST_ENTER, NOISE_ENTER * noise)

    def _contact(self, outline: NDArray[np.int32]) -> Contact:
        """Return the contact of an outline in work pixels, converted to pixels of the frame."""
        height, width = self._shape[:2]
        factor = np.array([width / self._size[0], height / self._size[1]], np.float32)
        corners = (outline.reshape(-1, 2) + np.float32(0.5)) * factor - np.float32(0.5)
        mask = np.zeros((height, width), np.uint8)
        # fillConvexPoly takes fixed-point corners: 4 fractional bits are a sixteenth of a pixel.
        cv2.fillConvexPoly(mask, np.rint(corners * 16).astype(np.int32), 255, shift=4)
        return Contact(mask, float(cv2.countNonZero(mask)), _dense(corners))


def _dense(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return points about 1 px apart along a closed outline, (N, 1, 2) from corners (K, 2)."""
    closed = np.vstack([corners, corners[:1]])
    reach = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    steps = np.linspace(0.0, reach[-1], max(1, int(reach[-1])), endpoint=False)
    points = np.stack([np.interp(steps, reach, closed[:, 0]), np.interp(steps, reach, closed[:, 1])], axis=1)
    return points.astype(np.float32).reshape(-1, 1, 2)
