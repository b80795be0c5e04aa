"""Detect images that do not show the gel: a transfer that was aborted, or lines with lost bytes.

Both are reported for DIGITs at 640 x 480 and for a loaded USB bus. The checks cannot reject what an elastomer
under fixed LEDs shows: its background has neither a step along the image nor a constant colour.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import DeviceError
from drivers.types import Image

BANDS = 4
"""Bytes may be lost half-way through an image, so its columns are checked in four groups."""
MAX_SHIFTED = 30
"""After this many shifted images in a row the stream does not recover without reopening."""
_STEP_PX = 8
"""Spacing of the rows and columns that are checked for green."""
_DEAD_SHARE = 0.1
"""Fraction of empty columns from which an image is green."""
_GREEN_OVER = 60
"""Grey levels by which green exceeds red and blue in an empty column; it is 135 in an empty buffer."""
_FLAT = 16
"""Largest range of grey levels along an empty column, which is constant except for JPEG artefacts."""
_LEAST_CHANGE = 1.5
"""Mean change of a profile, grey levels, below which no shift is searched."""
_LEAST_SHIFT_PX = 3
"""Smallest shift that is searched."""
_MOST_REST = 0.1
"""Largest squared difference after shifting back, relative to the one before."""
_SEAM_OVER = 1.4
"""Least step at the seam of a shift, relative to the 90 % quantile of all steps. It is low, because the edges
of an object are as steep, and JPEG blurs a seam."""


class GlitchCheck:
    """Checks the images of one stream, each (H, W, 3) uint8 RGB and upright, against the last good image.

    A raw line of a DIGIT is a column of its upright image.
    """

    def __init__(self) -> None:
        self._good: NDArray[np.float32] | None = None
        self._shifted = 0

    def reopened(self) -> None:
        """Note that the stream was reopened. The last good image is kept as the reference."""
        self._shifted = 0

    def flaw(self, image: Image) -> str | None:
        """Return "green" or "shifted", or None for a good image.

        Raises `DeviceError` after MAX_SHIFTED shifted images in a row: the stream must then be reopened.
        """
        if is_green(image):
            return "green"
        profile = _profile(image)
        if self._good is not None and self._good.shape == profile.shape and shifted(self._good, profile):
            self._shifted += 1
            if self._shifted >= MAX_SHIFTED:
                raise DeviceError(f"{MAX_SHIFTED} images in a row are shifted; use 320 x 240 px")
            return "shifted"
        self._good, self._shifted = profile, 0
        return None


def is_green(image: Image) -> bool:
    """Whether at least a tenth of the image's columns are an empty buffer.

    An empty YUV buffer (all zero) is displayed as a constant green, (0, 135, 0) by ITU-R BT.601.
    """
    sample = image[::_STEP_PX, ::_STEP_PX].astype(np.int16)
    flat = (np.ptp(sample, axis=0) <= _FLAT).all(axis=1)
    red, green, blue = sample.mean(axis=0).T
    dead = flat & (green - np.maximum(red, blue) > _GREEN_OVER)
    return bool(dead.mean() >= _DEAD_SHARE)


def shifted(good: NDArray[np.float32], seen: NDArray[np.float32]) -> bool:
    """Whether a profile (H, 4, 3) is a circular shift of the good one along its first axis, in any band.

    Three conditions: it differs from the good profile; after shifting it back, the difference is nearly zero;
    and at the seam it has a step that the good profile has nowhere.
    """
    change = np.abs(seen - good).mean(axis=(0, 2))
    return any(_is_shift(good[:, band], seen[:, band]) for band in np.flatnonzero(change > _LEAST_CHANGE))


def _is_shift(good: NDArray[np.float32], seen: NDArray[np.float32]) -> bool:
    rows = len(good)
    shift = _best_shift(good, seen)
    if min(shift, rows - shift) < _LEAST_SHIFT_PX:
        return False
    before = float(np.square(seen - good).mean())
    after = float(np.square(seen - np.roll(good, shift, axis=0)).mean())
    steps = np.abs(np.diff(seen, axis=0)).sum(axis=1)
    seam = float(steps[max(shift - 2, 0) : shift + 1].max())
    return after < _MOST_REST * before and seam > _SEAM_OVER * float(np.quantile(steps, 0.9))


def _best_shift(good: NDArray[np.float32], seen: NDArray[np.float32]) -> int:
    """Return the circular shift in px with the largest correlation, summed over the colours."""
    spectrum = np.fft.rfft(seen, axis=0) * np.conj(np.fft.rfft(good, axis=0))
    return int(np.fft.irfft(spectrum.sum(axis=1), n=len(good)).argmax())


def _profile(image: Image) -> NDArray[np.float32]:
    """Return the mean colour of each row in each group of columns, (H, 4, 3)."""
    small = cv2.resize(image, (BANDS, image.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)
