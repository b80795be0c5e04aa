"""Find the dark dots printed on a gel, and fill them from their surroundings.

Some gels are printed with dots, called markers, that show the motion of the gel: small dark blobs at regular
distances. Ink absorbs light of every colour, so a dot is dark in all three channels; a slope of the gel is
dark in some channels and bright in others. Dots are not a contact, and they move with the gel. Therefore they
are detected in every frame, and an estimator for such a gel runs on the filled frames.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from drivers.types import ArmState, Image
from rig.tactile.sample import SlipSample, Stopwatch, TactileEstimator, check_frame

DOTS = "dots"
"""Name of the stage that fills the dots."""


class DotFreeEstimator(TactileEstimator):
    """Fills the dots of each frame, then passes the frame to another estimator.

    estimator: an estimator that was made with a background whose dots are filled.
    """

    def __init__(self, estimator: TactileEstimator) -> None:
        self._estimator = estimator

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB. Raises only `InputError`, for another shape or type."""
        watch = Stopwatch()
        plain = without_dots(image)
        watch.lap(DOTS)
        sample = self._estimator.update(plain, time_ns)
        return replace(sample, stage_s={**watch.stage_s, **sample.stage_s})

    def arm(self, state: ArmState) -> None:
        """Pass the state of the arm on."""
        self._estimator.arm(state)

    def gripped_further(self) -> None:
        """Notify the estimator that the fingers have closed further."""
        self._estimator.gripped_further()


# Side of the search window as a fraction of the frame's short side. Markers are narrower: on a GelSight Mini
# (320 x 240) they are 12 to 20 px wide and 26 to 45 px apart.
REACH_SHARE = 0.10
# A marker is darker than its surroundings by at least this fraction.
DARKER_SHARE = 0.25
# Smallest and largest area of a marker as fractions of the search window.
LEAST_AREA, MOST_AREA = 0.06, 0.8
# Lower bound of the surroundings in grey levels, for the relative darkness.
DARK_GREY = 12.0
# A gel counts as dotted if it has at least LEAST_DOTS spots on a regular grid. Dirt on a gel has fewer spots,
# or random positions. For random positions the distances to the nearest neighbour have a standard deviation
# of half their mean; IRREGULAR is the largest ratio accepted. Their mean, relative to the density, is 1 for
# random positions and 2 for a square grid (Clark and Evans 1954); SPREAD is the smallest value accepted.
LEAST_DOTS, IRREGULAR, SPREAD = 12, 0.3, 1.6
# Long side of the copy on which a gel is checked for dots.
CHECKED_PX = 640
# Dots have blurred edges. Therefore a margin around each dot is filled, too; its width is this fraction of
# the dot's width. A wider margin would remove more of the texture that turns.
MARGIN_SHARE, LEAST_MARGIN_PX = 0.15, 2
# The filling is smooth, so it is computed on a copy that is reduced by this factor.
REDUCED = 4

Points = NDArray[np.float64]


def find_dots(image: Image) -> Points:
    """Return the centres (N, 2) of the markers in an (H, W, 3) uint8 RGB frame: x to the right, y down, px.

    Markers on the edge of the frame are left out. Raises `InputError` for another shape or type.
    """
    check_frame(image)
    grey, around, side = _surroundings(image)
    darker = (around - grey) / np.maximum(around, DARK_GREY)
    spots = (darker > DARKER_SHARE).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
    weights = (darker * spots).ravel()
    rows, columns = np.indices(spots.shape)
    which = labels.ravel()
    total = np.maximum(np.bincount(which, weights, count), 1e-9)
    x = np.bincount(which, weights * columns.ravel(), count) / total
    y = np.bincount(which, weights * rows.ravel(), count) / total
    good = _complete(np.asarray(stats, np.int32), spots.shape, side)
    return np.column_stack([x, y])[good]


def without_markers(image: Image) -> Image:
    """Return the frame with all dark spots that are narrower than the search window removed, per channel."""
    check_frame(image)
    return np.asarray(cv2.morphologyEx(image, cv2.MORPH_CLOSE, _square(image)), np.uint8)


def is_dotted(background: Image) -> bool:
    """Whether a frame without contact, (H, W, 3) uint8 RGB, shows a gel with printed dots."""
    check_frame(background)
    longest = max(background.shape[:2])
    if longest > CHECKED_PX:
        size = [max(8, round(side * CHECKED_PX / longest)) for side in background.shape[1::-1]]
        background = np.asarray(cv2.resize(background, size, interpolation=cv2.INTER_AREA), np.uint8)
    dots = find_dots(background)
    if len(dots) < LEAST_DOTS:
        return False
    nearest = np.asarray(KDTree(dots).query(dots, k=2)[0])[:, 1]
    spread = 2.0 * nearest.mean() * np.sqrt(len(dots) / max(float(np.ptp(dots, axis=0).prod()), 1.0))
    return bool(nearest.std() < IRREGULAR * nearest.mean() and spread > SPREAD)


def without_dots(image: Image) -> Image:
    """Return the frame, (H, W, 3) uint8 RGB, with its dots filled from their surroundings.

    Dots on the edge of the frame are filled, too. Raises `InputError` for another shape or type.
    """
    check_frame(image)
    spots, side = _spots(image)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(spots, connectivity=8)
    labels, stats = np.asarray(labels, np.int32), np.asarray(stats, np.int32)
    small = (stats[:, 2] <= side) & (stats[:, 3] <= side)
    small[0] = False
    if not small.any():
        return image
    width_px = float(np.median(np.sqrt(stats[small, 4])))
    margin = max(LEAST_MARGIN_PX, round(MARGIN_SHARE * width_px))
    hidden = np.asarray(cv2.dilate(small[labels].astype(np.uint8), _disc(margin)), np.uint8)
    return _fill(image, hidden, width_px + 2 * margin)


def _fill(image: Image, hidden: Image, width_px: float) -> Image:
    """Fill the masked pixels with a Gaussian-weighted mean of the others; its sigma is half of `width_px`.

    hidden: (H, W) uint8, 1 in pixels to fill. width_px: width of a dot with its margin.
    """
    height, width = hidden.shape
    size = (max(1, width // REDUCED), max(1, height // REDUCED))
    kept = cv2.resize(cv2.copyTo(image, 1 - hidden), size, interpolation=cv2.INTER_AREA)
    share = cv2.resize((1 - hidden).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    sigma = max(0.5, 0.5 * width_px / REDUCED)
    near = cv2.GaussianBlur(kept.astype(np.float32), (0, 0), sigma)
    near /= np.maximum(cv2.GaussianBlur(share, (0, 0), sigma), 1e-3)[..., None]
    smooth = cv2.convertScaleAbs(cv2.resize(near, (width, height), interpolation=cv2.INTER_LINEAR))
    return np.asarray(cv2.copyTo(smooth, hidden, image.copy()), np.uint8)


def _spots(image: Image) -> tuple[NDArray[np.uint8], int]:
    """Return the mask (H, W), 0 or 1, of pixels darker than their surroundings, and the window's side, px."""
    grey, around, side = _surroundings(image)
    return ((around - grey) > DARKER_SHARE * np.maximum(around, DARK_GREY)).astype(np.uint8), side


def _surroundings(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Return the grey levels, the grey levels without markers, and the side of the search window, px.

    The grey level is that of the brightest channel: without a marker, coloured light leaves some channels
    dark, but never all three.
    """
    red, green, blue = cv2.split(image)
    bright = cv2.GaussianBlur(cv2.max(cv2.max(red, green), blue), (0, 0), 1.0)
    square = _square(image)
    around = cv2.blur(cv2.morphologyEx(bright, cv2.MORPH_CLOSE, square), square.shape[::-1])
    return bright.astype(np.float32), around.astype(np.float32), len(square)


def _square(image: Image) -> NDArray[np.uint8]:
    side = max(round(REACH_SHARE * min(image.shape[:2])), 3) | 1
    return np.ones((side, side), np.uint8)


def _complete(stats: NDArray[np.int32], shape: tuple[int, ...], side: int) -> NDArray[np.bool_]:
    """Return which components are complete markers: of a valid size, and not on the frame's edge.

    stats: of OpenCV, per label; label 0 is the background. side: of the search window, px.
    """
    left, top, width, height, area = stats.T
    inside = (left > 0) & (top > 0) & (left + width < shape[1]) & (top + height < shape[0])
    size = (area >= LEAST_AREA * side**2) & (area <= MOST_AREA * side**2)
    good = inside & size & (width <= side) & (height <= side)
    good[0] = False
    return good


def _disc(reach: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)), np.uint8)
