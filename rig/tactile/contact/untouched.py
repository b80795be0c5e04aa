"""Find the frames of a recording that show the gel without contact.

Most recordings begin without contact: these frames are alike, and later ones differ. Otherwise the most
frequent image may be the gel without contact. Both candidates are checked: in the regions where other frames
differ, the candidate must have weaker edges, because a contact adds edges. So a background that contains a
contact is refused.
"""

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.dots import is_dotted, without_dots
from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.contact.relative import Light, RelativeDifference, work_size

LEAST_FRAMES = 3
"""Smallest number of alike frames: a moving contact can have two."""
FIRM_FRAMES = 5
"""Number of alike first frames from which on a weaker check of their edges is sufficient."""
LEAST_SHARE = 0.2
"""Smallest fraction of frames that show the most frequent image; of a moving contact, fewer are alike."""
OPENING_FRAMES = 30
"""Largest number of first frames: more do not reduce the noise of an 8-bit mean, and the light drifts."""
ONSET_FRAMES = 5
"""Frames before the first visible contact that may show its beginning: 80 ms at 60 Hz."""
CANDIDATES = 20
"""Number of evenly spread frames that are tried as the most frequent image."""
SLOPE_PX = 1.0
"""Standard deviation of the blur before image gradients are computed, in pixels of the reduced copy."""
DARK = 10.0
"""Grey levels added before the logarithm, so that noise in dark pixels does not dominate."""
LOGARITHM = np.log(np.arange(256) + DARK).astype(np.float32)
"""Logarithm of each grey level."""
FLAT = 1e-6
"""Added to gradients, so that the logarithm exists for a frame of one colour."""
DECISIVE = 0.03
"""Smallest difference of the log gradients that distinguishes a contact from a gel without contact. On the 24
clips of rotation_clips the first frames without contact have -0.74 to -0.002. Clips that are cut so that they
begin in contact have -0.02 to 0.06."""


class Comparison:
    """Compares frames with one background. background: (H, W, 3) uint8 RGB.

    A method that takes a frame also takes its reduced copy, see `reduce`.
    """

    def __init__(self, background: Image) -> None:
        width, height = self._size = work_size(background.shape, 1.0)
        # The dots are filled in a copy of at most twice the size of the reduced one, because this takes most
        # of the time.
        twice = (min(background.shape[1], 2 * width), min(background.shape[0], 2 * height))
        dotted = twice != self._size and is_dotted(background)
        self._dotted = RelativeDifference(background, twice) if dotted else None
        self._light = RelativeDifference(self._plain(background), self._size)

    def reduce(self, image: Image) -> Image:
        """Return the reduced copy of a frame, (h, w, 3) uint8, with its dots filled.

        A frame that is as small as the copy is returned unchanged.
        """
        return image if image.shape[1::-1] == self._size else self._light.reduce(self._plain(image))

    def light(self, image: Image) -> Light:
        """Return the light of a frame against that of the background."""
        return self._light.light_of(self.reduce(image))

    def region(self, image: Image, light: Light | None = None) -> Region | None:
        """Return the region where a frame differs from the background like a contact; None without any.

        light: of the frame, None to compute it.
        """
        return find_contact(self.difference(image, light))

    def difference(self, image: Image, light: Light | None = None) -> NDArray[np.float32]:
        """Return the relative difference of a frame's reduced copy from the background, (h, w, 3)."""
        return self._light.of(self.reduce(image), light)

    def edge_ratio(self, image: Image, slopes: NDArray[np.float32]) -> float | None:
        """Return the log ratio of the background's edges to those of a frame, where they differ.

        It is negative if the frame has the stronger edges, as a contact has. None if they do not differ.
        slopes: of the background, or of one of the frames whose mean it is.
        """
        work = self.reduce(image)
        region = self.region(work)
        return None if region is None else self.edge_ratio_in(region, work, slopes)

    def edge_ratio_in(self, region: Region, image: Image, slopes: NDArray[np.float32]) -> float:
        """Return the same for a region where they differ."""
        inside = region.mask > 0
        return float(np.log(slopes[inside].mean() / self.slopes(image)[inside].mean()))

    def slopes(self, image: Image) -> NDArray[np.float32]:
        """Return the gradient magnitude (h, w) of the logarithm of a frame's reduced copy."""
        logarithm = cv2.GaussianBlur(cv2.LUT(self.reduce(image), LOGARITHM), (0, 0), SLOPE_PX)
        right, down = (cv2.Sobel(logarithm, cv2.CV_32F, *way, ksize=1, scale=0.5) for way in ((1, 0), (0, 1)))
        size = cv2.magnitude(right.reshape(-1), down.reshape(-1)).reshape(right.shape)
        return np.asarray(cv2.transform(size, np.full((1, 3), 1.0 / 3.0, np.float32)) + FLAT, np.float32)

    def _plain(self, image: Image) -> Image:
        return image if self._dotted is None else without_dots(self._dotted.reduce(image))


def still_opening(images: Iterable[Image]) -> list[Image]:
    """Return the first frames that are alike, without those that may show the onset of a contact.

    The list is empty if there are too few, and has at most `OPENING_FRAMES` frames.
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
    """Return the largest group of frames that are alike. frames: evenly spread over a recording."""
    largest: list[Image] = []
    for index in np.unique(np.linspace(0, len(frames) - 1, CANDIDATES).round().astype(int)):
        comparison = Comparison(frames[index])
        alike = [image for image in frames if comparison.region(image) is None]
        largest = max(largest, alike, key=len)
    return largest if len(largest) >= max(LEAST_FRAMES, LEAST_SHARE * len(frames)) else []


def untouched_frames(images: Iterable[Image], spread: Sequence[Image]) -> tuple[list[Image], bool]:
    """Return frames without contact, and whether they are the first frames; an empty list if uncertain.

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
    """Return the mean logarithm of the gradients of alike frames over those of others, where they differ.

    A negative value means that the other frames have stronger edges, as contacts have. None if no other frame
    differs.
    """
    comparison = Comparison(mean_background(alike))
    own = comparison.slopes(_middle(alike))  # a single frame, because a mean would have less noise
    ratios = [ratio for image in others if (ratio := comparison.edge_ratio(image, own)) is not None]
    return float(np.mean(ratios)) if ratios else None


def _middle(frames: Sequence[Image]) -> Image:
    return frames[len(frames) // 2]
