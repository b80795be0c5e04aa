"""What a segmentation network overlooks of a contact, and the frame shows all the same.

Networks leave out what looks unlike the sensors they learnt from: half an edge in a dark corner of a
real DIGIT, half of all balls on a GelSight. How a frame differs from the frame without contact tells of
it without learning. A slope turns the gel towards one LED and away from the others, so a dent changes
all colours or two of them; a shadow takes away one, and the gel's own slope round a dent is short.

- Where all colours changed clearly, further out than that slope, joined to what was found and no weaker
  than half of it, the contact goes on; a slope that reaches far falls off.
- A large region where two colours changed clearly, of which next to nothing was found, is a contact.

On simulated sensors, which the networks know, both do nothing in any of 1,260 frames; of 400 others that
show no contact, one gets one.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.relative import upper_median

CLEARLY = 3.0
"""Times the median change outside the contact; noise and a light that drifts stay below."""
LEAST_CHANGE = 0.02
"""Of the background's light; below it the surroundings count as still."""
FOOT_SHARE = 0.05
"""Reach of the gel's own slope round a contact, of the image's width: 0.7 mm of a DIGIT's gel."""
LEAST_STRENGTH = 0.5
"""Of the change in the contact; the gel's slope had 0.2 to 0.4 of it where it reached beyond the foot."""
JOINED_SHARE, APART_SHARE = 0.003, 0.01
"""Of the image: smaller parts are specks, joined to a contact or by themselves."""
OVERLOOKED_SHARE = 0.25
"""A region of which less was found than this was overlooked."""
_SMOOTH_PX, _SMOOTH_SIDE_PX = 1.0, 5


def overlooked_part(found: Image, difference: NDArray[np.float32]) -> Image | None:
    """Return what belongs to contacts beside what was found, (h, w) uint8 0 or 1; None for nothing.

    found: (h, w) uint8, 0 or 1. difference: (3, h, w) float32, relative (`rig.tactile.contact.relative`).
    """
    changes = np.abs(difference)
    one, two, three = changes
    low, high = cv2.min(one, two), cv2.max(one, two)
    least, middle = cv2.min(low, three), cv2.max(low, cv2.min(high, three))
    reach = max(1, round(FOOT_SHARE * found.shape[1]))
    foot = _grown(found, reach)
    joined = _joined(found, foot, reach, _clear(found, least), changes)
    apart = _apart(found, foot, _clear(found, middle))
    return joined if apart is None else apart if joined is None else joined | apart


def _clear(found: Image, change: Any) -> Image:
    """Where a change (h, w) stands out from that of the surroundings, (h, w) uint8 0 or 1."""
    smooth = np.asarray(cv2.GaussianBlur(change, (_SMOOTH_SIDE_PX, _SMOOTH_SIDE_PX), _SMOOTH_PX), np.float32)
    # an eighth of the pixels tells the median as well as all of them
    around = smooth[::4, ::2][found[::4, ::2] == 0]
    usual = float(upper_median(around)) if around.size else np.inf
    return np.asarray(smooth > CLEARLY * max(usual, LEAST_CHANGE), np.uint8)


def _joined(
    found: Image, foot: Image, reach: int, clear: Image, changes: NDArray[np.float32]
) -> Image | None:
    """Return the clear parts further out than the foot of what was found, with the foot between."""
    further = clear & (1 - foot)
    if cv2.countNonZero(further) < JOINED_SHARE * found.size or not found.any():
        return None
    parts, large = _numbered_parts(further, JOINED_SHARE)
    beside = np.intersect1d(large, np.unique(parts[_grown(foot, 1) > 0]))
    change = changes.sum(axis=0)
    least = LEAST_STRENGTH * float(np.median(change[found > 0]))
    part = np.asarray(np.isin(parts, [n for n in beside if np.median(change[parts == n]) >= least]), np.uint8)
    return part | (_grown(part, reach) & foot) if part.any() else None


def _apart(found: Image, foot: Image, clear: Image) -> Image | None:
    """Return the large clear regions that were overlooked; most of one is no foot of what was found."""
    if cv2.countNonZero(clear & (1 - foot)) < (1.0 - OVERLOOKED_SHARE) * APART_SHARE * found.size:
        return None
    parts, large = _numbered_parts(clear, APART_SHARE)
    missed = [part for part in large if found[parts == part].mean() < OVERLOOKED_SHARE]
    return np.asarray(np.isin(parts, missed), np.uint8) if missed else None


def _numbered_parts(mask: Image, share: float) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Return the mask's connected parts, numbered, and the numbers of those larger than a share of it."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask)
    large = np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= share * mask.size) + 1
    return np.asarray(parts, np.int32), large


def _grown(mask: Image, reach: int) -> Image:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return np.asarray(cv2.dilate(mask, kernel), np.uint8)
