"""Reproduce the paper's published script with its faults, for comparison.

In the script, frames of any shape are stretched to 256 x 320, and angles are clockwise positive. The sign is
removed (`abs`) before averaging, and again after the reference is subtracted. The window reports angles from
the n-th frame with contact on. Source: the authors' online script for "Measuring object rotation via
visuo-tactile segmentation of grasping region" (RA-L 2023).
"""

import math
from collections import deque
from collections.abc import Callable

import cv2
import numpy as np

from drivers.types import Image
from rig.tactile.paper.axis import MIN_POINTS, largest_contour, thin

HEIGHT_PX, WIDTH_PX = 320, 256


class ScriptError(Exception):
    """Raised where the published script would end with an exception."""


def stretch(mask: Image) -> Image:
    """Resize a mask (H, W) to the script's (320, 256), 0 or 255."""
    resized = cv2.resize(mask, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
    return np.where(resized > 127, 255, 0).astype(np.uint8)


def skeleton_angle(mask: Image) -> float | None:
    """Return the script's angle in degrees for a mask (320, 256); None without a contour.

    Raises `ScriptError` as the script does, for fewer than five contour points or an ellipse without a
    skeleton in the image.
    """
    contour = _contour(mask)
    if contour is None:
        return None
    filled = np.zeros(mask.shape, np.uint8)
    try:
        cv2.ellipse(filled, cv2.fitEllipse(contour), 255, -1)
    except cv2.error as error:
        raise ScriptError(str(error)) from error
    lines, _ = cv2.findContours(thin(filled), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not lines:
        raise ScriptError("the ellipse has no skeleton in the image")
    dx, dy = cv2.fitLine(lines[0], cv2.DIST_L2, 0, 0.01, 0.001).reshape(-1)[:2]
    return math.degrees(math.atan2(dy, dx))


def ellipse_angle(mask: Image) -> float | None:
    """Return the angle of the fitted ellipse of a mask, deg; None and errors as for `skeleton_angle`."""
    contour = _contour(mask)
    if contour is None:
        return None
    return float(cv2.fitEllipse(contour)[2]) - 90.0


def pca_angle(mask: Image) -> float | None:
    """Return the angle of the contour points' first principal axis, deg; None as for `skeleton_angle`."""
    contour = _contour(mask)
    if contour is None:
        return None
    _, axes = cv2.PCACompute(contour.reshape(-1, 2).astype(np.float32), mean=np.empty(0, np.float32))
    return math.degrees(math.atan2(axes[0, 1], axes[0, 0]))


ScriptAngle = Callable[[Image], float | None]
ANGLES: dict[str, ScriptAngle] = {"skeleton": skeleton_angle, "ellipse": ellipse_angle, "pca": pca_angle}


class ScriptFilter:
    """The script's filter: a window of n angles, and a reference that is subtracted."""

    def __init__(self, window: int) -> None:
        self._window = window
        self._angles: deque[float] = deque()
        self._reference_deg: float | None = None

    def update(self, angle_deg: float | None) -> float:
        """Return the angle that the script publishes, deg: 0 without contact or before n angles."""
        if angle_deg is None:
            return 0.0
        self._angles.append(abs(angle_deg))
        if len(self._angles) < self._window:
            return 0.0
        mean = sum(self._angles) / len(self._angles)
        self._angles.popleft()
        if self._reference_deg is None:
            self._reference_deg = mean
        return abs(mean - self._reference_deg)


def _contour(mask: Image) -> np.ndarray | None:
    contour = largest_contour(mask)
    if contour is not None and len(contour) < MIN_POINTS:
        raise ScriptError(f"cv2.fitEllipse needs {MIN_POINTS} points, the contour has {len(contour)}")
    return contour
