"""A template for an estimator: returns the long axis of the area that has changed since the background."""

import math

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.sample import SlipSample, State, TactileEstimator

CHANGED_GREY, LEAST_PX = 12, 60
ROUND = 0.15
"""Below this difference of the axes, as a fraction of their sum, the contact has no long axis."""


class MyEstimator(TactileEstimator):
    """Created with a frame without contact, (H, W, 3) uint8 RGB; then called once per frame, in order."""

    def __init__(self, background: Image) -> None:
        self._background = background
        self._last_deg: float | None = None

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Return the contact's image angle, counter-clockwise, unwrapped beyond 180 degrees."""
        change = cv2.absdiff(image, self._background).max(axis=2)
        mask = (cv2.medianBlur(change, 5) > CHANGED_GREY).astype(np.uint8)
        found = cv2.moments(mask, binaryImage=True)
        area_px = found["m00"]
        if area_px < LEAST_PX:
            return SlipSample(time_ns, State.NO_CONTACT)
        wide, high, both = found["mu20"], found["mu02"], 2 * found["mu11"]
        if math.hypot(wide - high, both) < ROUND * (wide + high):
            return SlipSample(time_ns, State.UNOBSERVABLE, contact_area_px=area_px)
        # y points down in an image, so the sign is inverted
        angle_deg = -math.degrees(0.5 * math.atan2(both, wide - high))
        if (
            self._last_deg is not None
        ):  # an axis is known modulo 180 degrees: take the one nearest to the last
            angle_deg += 180.0 * round((self._last_deg - angle_deg) / 180.0)
        self._last_deg = angle_deg
        return SlipSample(time_ns, State.TRACKING, angle_deg, contact_area_px=area_px)
