"""Where the object touches the gel: a contact mask by plain image processing.

A frame is compared with the same sensor's frame without contact. The light of a DIGIT multiplies
(LEDs dim, white balance drifts), so the difference is taken relative to the background after a
gain per channel. Its smoothed magnitude is split by Otsu's threshold; a gate on contrast and area
decides whether the split shows a contact or only noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.relative import RelativeDifference, upper_median
from rig.tactile.sample import check_frame

# Long side of the copy that is looked at: half a DIGIT's, fine for outlines smeared by the gel.
WORK_LONG_SIDE_PX = 160
# Gaussian blur of the signed difference (averages noise) and of its magnitude (closes the gap
# between the lit and the shaded flank of a contact), in work pixels.
NOISE_BLUR_PX = 1.0
SHAPE_BLUR_PX = 2.0
# Opening and closing with an ellipse of this size: removes light streaks, fills rims.
MORPH_PX = 7
# A flat face shows by its edges alone: parts of this share of the largest one's area belong to the
# same contact. Smaller ones are mostly streaks of light.
PART_SHARE = 0.5
# A contact begins when inside and outside differ by this share of the background's light, and
# ends below the lower one; drift that a gain per channel cannot follow stays below both.
CONTRAST_ENTER, CONTRAST_LEAVE = 0.035, 0.025
# The same in multiples of the frame's own pixel noise: what a split of pure noise can reach.
NOISE_ENTER, NOISE_LEAVE = 2.0, 1.5
# Share of the frame a contact covers at least: 1 % of a DIGIT is a 4 mm long edge contact.
AREA_ENTER, AREA_LEAVE = 0.01, 0.006


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """The contact seen in one frame of (H, W).

    mask: (H, W) uint8, 0 or 255; None without contact. area_px: its area, 0 without contact.
    contour: (N, 1, 2) float32 points about 1 px apart along its outline, x and y in pixels of the
    frame (0 is the middle of the first pixel); empty without contact.
    """

    mask: Image | None
    area_px: float
    contour: NDArray[np.float32]


NO_CONTACT = Contact(None, 0.0, np.empty((0, 1, 2), np.float32))


class ContactFinder:
    """Finds the contact in the frames of one sensor.

    background: (H, W, 3) uint8 RGB, a frame without contact. tightness scales the threshold: above
    1 the mask keeps closer to the middle of the contact, below 1 it reaches further out. Frames
    are independent of one another but for the gate, which lets a contact begin later than end.
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
        """Return the smoothed magnitude of the relative difference, and the pixel noise in its unit."""
        raw = self._light.of(self._light.reduced(image))
        smooth = cv2.GaussianBlur(raw, (0, 0), NOISE_BLUR_PX)
        noise = 1.4826 * float(upper_median(np.abs(raw[::8, ::8] - smooth[::8, ::8]).reshape(-1, 1))[0])
        squares = cv2.transform(cv2.multiply(smooth, smooth), np.ones((1, 3), np.float32))
        return np.asarray(cv2.GaussianBlur(cv2.sqrt(squares), (0, 0), SHAPE_BLUR_PX), np.float32), noise

    def _outline(self, energy: NDArray[np.float32]) -> NDArray[np.int32] | None:
        """Return the convex outline of the large parts above the threshold, in work pixels."""
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
        """Whether the split shows a contact: enough area, enough contrast for light and for noise."""
        inside = np.zeros(energy.shape, np.uint8)
        cv2.fillConvexPoly(inside, outline, 255)
        area = cv2.countNonZero(inside) / inside.size
        contrast = cv2.mean(energy, inside)[0] - cv2.mean(energy, cv2.bitwise_not(inside))[0]
        if self._in_contact:
            return area >= AREA_LEAVE and contrast >= max(CONTRAST_LEAVE, NOISE_LEAVE * noise)
        return area >= AREA_ENTER and contrast >= max(CONTRAST_ENTER, NOISE_ENTER * noise)

    def _contact(self, outline: NDArray[np.int32]) -> Contact:
        """Bring the outline to the frame's own pixels."""
        height, width = self._shape[:2]
        factor = np.array([width / self._size[0], height / self._size[1]], np.float32)
        corners = (outline.reshape(-1, 2) + np.float32(0.5)) * factor - np.float32(0.5)
        mask = np.zeros((height, width), np.uint8)
        # fillConvexPoly reads fixed-point corners: 4 bits are a sixteenth of a pixel.
        cv2.fillConvexPoly(mask, np.rint(corners * 16).astype(np.int32), 255, shift=4)
        return Contact(mask, float(cv2.countNonZero(mask)), _dense(corners))


def _dense(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return points about 1 px apart along a closed outline, (N, 1, 2) from corners (K, 2)."""
    closed = np.vstack([corners, corners[:1]])
    reach = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    steps = np.linspace(0.0, reach[-1], max(1, int(reach[-1])), endpoint=False)
    points = np.stack([np.interp(steps, reach, closed[:, 0]), np.interp(steps, reach, closed[:, 1])], axis=1)
    return points.astype(np.float32).reshape(-1, 1, 2)
