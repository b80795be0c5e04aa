"""Estimate the direction of a contact's long axis, by the three methods that the paper compares.

Angles are image angles, theta = -atan2(dy, dx), counter-clockwise positive in the image. An axis has no
direction, so they are known modulo 180 degrees.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image

Contour = NDArray[np.float32] | NDArray[np.int32]

# Number of points that cv2.fitEllipse needs.
MIN_POINTS = 5
# Points whose standard deviation across their main direction is below this count as a line without area.
MIN_SPREAD_PX = 0.3
# A fit has failed if the ellipse's half axis exceeds this multiple of the extent of its points.
MAX_OVERSHOOT = 2.0
# Larger ellipses are drawn with this half axis, half the height of the paper's image. This limits the time
# for thinning on frames of larger cameras.
MAX_DRAWN_PX = 160.0
# Margin around the drawn ellipse, because thinning never removes the outermost pixels of an image.
MARGIN_PX = 2


@dataclass(frozen=True, slots=True)
class Axis:
    """A long axis. angle_deg: in (-90, 90]. elongation: long over short axis, 1 for a circle."""

    angle_deg: float
    elongation: float


AxisMethod = Callable[[Contour], Axis | None]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """A fitted ellipse: centre and half axes in px, angle_deg as in `Axis`."""

    center_px: tuple[float, float]
    long_px: float
    short_px: float
    angle_deg: float


def largest_contour(mask: Image) -> NDArray[np.int32] | None:
    """Return the contour of largest area in an (H, W) mask, (N, 1, 2) int32 x and y; None if empty."""
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return np.asarray(max(contours, key=cv2.contourArea), np.int32) if contours else None


def pca_axis(contour: Contour) -> Axis | None:
    """Return the first principal axis of the contour's points (paper: PCA).

    contour: (N, 1, 2) or (N, 2), px. Returns None for fewer than five points, a point or a line.
    """
    points = _points(contour)
    spread = None if points is None else _spread(points)
    if points is None or spread is None:
        return None
    xx, xy, yy = spread
    angle = -0.5 * math.degrees(math.atan2(2 * xy, xx - yy))
    return Axis(wrap(angle), _elongation(points))


def fit_ellipse(contour: Contour) -> Ellipse | None:
    """Fit an ellipse to a contour's points; None if they are too few or on a line."""
    found = _points(contour)
    if found is None or _spread(found) is None:
        return None
    points = found.astype(np.float32).reshape(-1, 1, 2)
    (x, y), (width, height), turn = cv2.fitEllipse(points)
    extent = float((found.max(axis=0) - found.min(axis=0)).max())
    sides = sorted((float(width) / 2, float(height) / 2))
    sound = (
        all(map(math.isfinite, (x, y, *sides, turn))) and 0 < sides[0] <= sides[1] < MAX_OVERSHOOT * extent
    )
    if not sound:
        return None
    # OpenCV's angle is that of `width`, clockwise; the long axis is `height` unless wider.
    angle = -(turn if width > height else turn + 90.0)
    return Ellipse((float(x), float(y)), sides[1], sides[0], wrap(angle))


def ellipse_axis(contour: Contour) -> Axis | None:
    """Return the long axis of the ellipse fitted to the contour (paper: ellipse fitting)."""
    ellipse = fit_ellipse(contour)
    return None if ellipse is None else Axis(ellipse.angle_deg, ellipse.long_px / ellipse.short_px)


def skeleton_axis(contour: Contour) -> Axis | None:
    """Return the direction of the thinned ellipse (paper: skeleton thinning, section III-A).

    The ellipse fitted to the contour is drawn filled and thinned to a line one pixel wide. A straight line is
    fitted to the result. Returns None if there is no ellipse, or if the skeleton is a single point.
    """
    ellipse = fit_ellipse(contour)
    if ellipse is None:
        return None
    pixels = cv2.findNonZero(thin(_draw(ellipse)))
    if pixels is None or len(pixels) < 2:
        return None
    dx, dy = cv2.fitLine(pixels, cv2.DIST_L2, 0, 0.01, 0.001).reshape(-1)[:2]
    return Axis(wrap(-math.degrees(math.atan2(dy, dx))), ellipse.long_px / ellipse.short_px)


def thin(mask: Image) -> Image:
    """Thin a mask to lines one pixel wide by the method of Guo and Hall (CACM 32 (3), 1989).

    mask: (H, W) uint8, 0 or 255; the result has the same format. Only the bounding box of the set pixels is
    thinned, with a margin of one pixel, because OpenCV never removes pixels on the edge of its input.
    """
    x, y, width, height = cv2.boundingRect(mask)
    part = np.s_[max(y - 1, 0) : y + height + 1, max(x - 1, 0) : x + width + 1]
    lines = np.zeros_like(mask)
    if width and height:
        lines[part] = cv2.ximgproc.thinning(
            np.ascontiguousarray(mask[part]), thinningType=cv2.ximgproc.THINNING_GUOHALL
        )
    return lines


def wrap(angle_deg: float) -> float:
    """Wrap an axis angle to (-90, 90]."""
    return 90.0 - (90.0 - angle_deg) % 180.0


def _draw(ellipse: Ellipse) -> Image:
    """Draw the filled ellipse in an image of its size, (H, W) uint8."""
    scale = min(1.0, MAX_DRAWN_PX / ellipse.long_px)
    long_px, short_px = ellipse.long_px * scale, ellipse.short_px * scale
    radius = math.ceil(long_px) + MARGIN_PX
    center = tuple(value % 1.0 + radius for value in ellipse.center_px)
    picture = np.zeros((2 * radius + 2, 2 * radius + 2), np.uint8)
    cv2.ellipse(picture, (center, (2 * long_px, 2 * short_px), -ellipse.angle_deg), 255, -1)
    return picture


def _spread(points: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """Return the covariances xx, xy, yy of points; None if they form a point or a line."""
    x, y = (points - points.mean(axis=0)).T
    xx, xy, yy = (float(u @ v) / (len(points) - 1) for u, v in ((x, x), (x, y), (y, y)))
    middle, half = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    return (xx, xy, yy) if middle - half >= MIN_SPREAD_PX**2 else None


def _elongation(points: NDArray[np.float64]) -> float:
    """Return the axis ratio of the ellipse that has the second moments of the enclosed area.

    The second moments of the points are not used: their ratio is nearer to 1 than that of the axes.
    """
    moments = cv2.moments(points.astype(np.float32).reshape(-1, 1, 2))
    middle = (moments["mu20"] + moments["mu02"]) / 2
    half = math.hypot((moments["mu20"] - moments["mu02"]) / 2, moments["mu11"])
    # An outline that crosses itself encloses areas of both signs, for which the ratio is not defined.
    return math.sqrt((middle + half) / (middle - half)) if middle > half else 1.0


def _points(contour: Contour) -> NDArray[np.float64] | None:
    points = np.asarray(contour, np.float64).reshape(-1, 2)
    return points if len(points) >= MIN_POINTS and bool(np.isfinite(points).all()) else None


METHODS: dict[str, AxisMethod] = {"skeleton": skeleton_axis, "ellipse": ellipse_axis, "pca": pca_axis}
