"""The frames of a recording that show the untouched gel.

Most recordings begin with an untouched gel: its frames are alike, later ones differ. Otherwise the image
that most frames share may be the gel at rest. Either is only used if it is plainer than the frames that
differ from it, where they differ: a contact adds edges, so a background with a contact in it is refused.
"""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.dots import plain_of
from rig.tactile.contact.gate import ContactGate, Region
from rig.tactile.contact.relative import RelativeDifference, work_size

LEAST_FRAMES = 3
"""Fewer alike frames are no rest: a moving contact has two."""
FIRM_FRAMES = 5
"""As many alike frames in a row are no coincidence."""
LEAST_SHARE = 0.2
"""The most frequent image has at least this share of the frames: of a contact that moves, few are alike."""
OPENING_FRAMES = 30
"""More frames do not reduce the noise of their mean visibly (8 bits), and light drifts meanwhile."""
ONSET_FRAMES = 5
"""Frames before the first visible contact that may show its beginning: 80 ms at 60 Hz."""
CANDIDATES = 20
"""Frames, evenly spread, that are tried as the image that most frames share."""
SLOPE_PX = 1.0
"""Blur before slopes are measured, in pixels of the reduced copy."""
DARK = 10.0
"""Grey levels added before a logarithm, so that noise in dark pixels does not dominate."""
FLAT = 1e-6
"""Added to slopes, so that a frame of one colour has a logarithm."""
DECISIVE = 0.03
"""Least difference of the logarithms of two slopes that distinguishes a contact from a gel at rest. On the 24
clips of rotation_clips the untouched opening has -0.74 to -0.002; clips that are cut so that they begin in
contact have -0.02 to 0.06."""


class Comparison:
    """Compares frames with one background. background: (H, W, 3) uint8 RGB."""

    def __init__(self, background: Image) -> None:
        self._plain = plain_of(background)
        self._light = RelativeDifference(self._plain(background), work_size(background.shape, 1.0))

    def region(self, image: Image) -> Region | None:
        """Return where a frame differs as a contact does; None if it does not."""
        return ContactGate().find(self._light.of(self._reduced(image)))

    def slopes(self, image: Image) -> NDArray[np.float32]:
        """Return the slopes (h, w) of the logarithm of a frame's reduced copy."""
        logarithm = cv2.GaussianBlur(np.log(self._reduced(image).astype(np.float32) + DARK), (0, 0), SLOPE_PX)
        right, down = np.gradient(logarithm, axis=1), np.gradient(logarithm, axis=0)
        return np.asarray(np.hypot(right, down).mean(axis=2) + FLAT, np.float32)

    def _reduced(self, image: Image) -> Image:
        return self._light.reduced(self._plain(image))


def still_opening(images: Iterable[Image]) -> list[Image]:
    """Return the first frames as long as they are alike, without those that may show the onset of a contact.

    Empty if they are too few. At most `OPENING_FRAMES` are returned.
    """
    alike: list[Image] = []
    comparison: Comparison | None = None
    ended = False
    for image in images:
        if comparison is not None and comparison.region(image) is not None:
            ended = True
            break
        alike.append(image)
        if comparison is None and len(alike) == LEAST_FRAMES:
            comparison = Comparison(mean_background(alike))
            if any(comparison.region(one) is not None for one in alike):
                return []
        if len(alike) == OPENING_FRAMES + ONSET_FRAMES:
            break
    kept = alike[: max(len(alike) - ONSET_FRAMES, LEAST_FRAMES)] if ended else alike
    return kept[:OPENING_FRAMES] if len(kept) >= LEAST_FRAMES else []


def most_frequent(frames: Sequence[Image]) -> list[Image]:
    """Return the frames that are alike and the most numerous. frames: evenly spread over a recording."""
    largest: list[Image] = []
    for index in np.unique(np.linspace(0, len(frames) - 1, CANDIDATES).round().astype(int)):
        comparison = Comparison(frames[index])
        alike = [image for image in frames if comparison.region(image) is None]
        largest = max(largest, alike, key=len)
    return largest if len(largest) >= max(LEAST_FRAMES, LEAST_SHARE * len(frames)) else []


def untouched_frames(images: Iterable[Image], spread: Sequence[Image]) -> tuple[list[Image], bool]:
    """Return frames of the untouched gel, and whether they are the first ones; none if that is not certain.

    images: all frames in order. spread: frames evenly spread over them.
    """
    opening, frequent = still_opening(images), most_frequent(spread)
    if opening and frequent:
        beside = _roughness(opening, [_middle(frequent)])
        if beside is not None and beside > DECISIVE:
            opening = []
    most = 0.0 if len(opening) >= FIRM_FRAMES else -DECISIVE
    for frames, highest in ((opening, most), (frequent, -DECISIVE)):
        roughness = _roughness(frames, spread) if frames else None
        if roughness is not None and roughness < highest:
            return frames, frames is opening
    return [], False


def _roughness(alike: Sequence[Image], others: Sequence[Image]) -> float | None:
    """Return how much stronger the slopes of alike frames are than those of other frames, where these differ.

    Mean logarithm of the ratio; below 0 the others have more edges, as contacts add. None if none differs.
    """
    comparison = Comparison(mean_background(alike))
    own = comparison.slopes(_middle(alike))  # of a single frame: a mean has less noise than the others have
    ratios = [
        float(np.log(own[region.mask > 0].mean() / comparison.slopes(image)[region.mask > 0].mean()))
        for image in others
        if (region := comparison.region(image)) is not None
    ]
    return float(np.mean(ratios)) if ratios else None


def _middle(frames: Sequence[Image]) -> Image:
    return frames[len(frames) // 2]
