"""Find the parts of a contact that a segmentation network has missed.

Networks miss contacts that look unlike those of the sensors in their training data: half an edge in a dark
corner of a real DIGIT, half of all balls on a GelSight. The difference from the frame without contact shows
them without training. A slope turns the gel surface towards one LED and away from the others, so a dent
changes two or three colour channels. A shadow changes only one channel. The gel also slopes around a dent,
but only over a short distance, the foot.

- A region where all channels changed clearly extends the contact if it is outside the foot, is connected to
  the contact, and has at least half the change of the contact.
- A large region where two channels changed clearly is a separate contact if the network found almost nothing
  in it.

On SIMULATED sensors, on which the networks were trained, both rules add nothing in 1,260 frames, and a false
contact in one of 400 other frames without contact.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.relative import upper_median

CLEARLY = 3.0
"""Threshold of a clear change, as a multiple of the median change outside the contact.

Noise and drifting light stay below."""
LEAST_CHANGE = 0.02
"""Lower bound of that median change, relative to the background."""
FOOT_SHARE = 0.05
"""Width of the foot around a contact as a fraction of the image width: 0.7 mm on the gel of a DIGIT."""
LEAST_STRENGTH = 0.5
"""Smallest change of a part that extends a contact, relative to the change of the contact.

The slope of the gel has 0.2 to 0.4 of that change where it extends beyond the foot."""
JOINED_SHARE, APART_SHARE = 0.003, 0.01
"""Smallest area of a part that extends a contact, and of a separate contact, as fractions of the image."""
OVERLOOKED_SHARE = 0.25
"""A region was missed if less than this fraction of it was found."""
_SMOOTH_PX, _SMOOTH_SIDE_PX = 1.0, 5
"""Standard deviation and side of the Gaussian blur of the changes."""


def overlooked_part(found: Image, difference: NDArray[np.float32]) -> Image | None:
    """Return the missed parts of contacts, (h, w) uint8 0 or 1; None if there are none.

    found: mask of the network, (h, w) uint8, 0 or 1. difference: (3, h, w) float32, relative difference from
    the background (`rig.tactile.contact.relative`).
    """
    changes = np.abs(difference)
    one, two, three = changes
    low, high = cv2.min(one, two), cv2.max(one, two)
    least, middle = cv2.min(low, three), cv2.max(low, cv2.min(high, three))
    reach = max(1, round(FOOT_SHARE * found.shape[1]))
    foot = _grow(found, reach)
    joined = _find_extension(found, foot, reach, _clear(found, least), changes)
    apart = _apart(found, foot, _clear(found, middle))
    return joined if apart is None else apart if joined is None else joined | apart


def _clear(found: Image, change: Any) -> Image:
    """Return the mask (h, w) uint8, 0 or 1, of clear changes. change: (h, w), of one channel."""
    smooth = np.asarray(cv2.GaussianBlur(change, (_SMOOTH_SIDE_PX, _SMOOTH_SIDE_PX), _SMOOTH_PX), np.float32)
    # an eighth of the pixels is sufficient for the median
    around = smooth[::4, ::2][found[::4, ::2] == 0]
    usual = float(upper_median(around)) if around.size else np.inf
    return np.asarray(smooth > CLEARLY * max(usual, LEAST_CHANGE), np.uint8)


def _find_extension(
    found: Image, foot: Image, reach: int, clear: Image, changes: NDArray[np.float32]
) -> Image | None:
    """Return the clearly changed parts that extend the contact, with the foot between; None without any."""
    further = clear & (1 - foot)
    if cv2.countNonZero(further) < JOINED_SHARE * found.size or not found.any():
        return None
    parts, large = _numbered_parts(further, JOINED_SHARE)
    beside = np.intersect1d(large, np.unique(parts[_grow(foot, 1) > 0]))
    change = changes.sum(axis=0)
    least = LEAST_STRENGTH * float(np.median(change[found > 0]))
    part = np.asarray(np.isin(parts, [n for n in beside if np.median(change[parts == n]) >= least]), np.uint8)
    return part | (_grow(part, reach) & foot) if part.any() else None


def _apart(found: Image, foot: Image, clear: Image) -> Image | None:
    """Return the large clearly changed regions that the network missed; None without any."""
    if cv2.countNonZero(clear & (1 - foot)) < (1.0 - OVERLOOKED_SHARE) * APART_SHARE * found.size:
        return None
    parts, large = _numbered_parts(clear, APART_SHARE)
    missed = [part for part in large if found[parts == part].mean() < OVERLOOKED_SHARE]
    return np.asarray(np.isin(parts, missed), np.uint8) if missed else None


def _numbered_parts(mask: Image, share: float) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Return the labels (h, w) of the mask's connected parts, and those labels whose part is large.

    share: smallest area of a large part as a fraction of the mask.
    """
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask)
    large = np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= share * mask.size) + 1
    return np.asarray(parts, np.int32), large


def _grow(mask: Image, reach: int) -> Image:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask, kernel), np.uint8)
