"""Images that do not show the gel: a transfer that broke off, a line that lost bytes.

Both are known of DIGITs at 640 x 480 and of a USB bus under load. They are told apart from what an
elastomer under fixed LEDs can show, whose background neither jumps along the image nor goes flat.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import DeviceError
from drivers.types import Image

BANDS = 4
"""Bytes may be lost half-way through an image, so its columns are judged in four groups."""
MAX_SHIFTED = 30
"""So many shifted images in a row mean that the stream will not right itself."""
_STEP_PX = 8
_DEAD_SHARE = 0.1
_GREEN_OVER = 60
_FLAT = 16
_LEAST_CHANGE = 1.5
_LEAST_SHIFT_PX = 3
_MOST_REST = 0.1
_SEAM_OVER = 1.4
"""Lower than a seam without contact would allow: an object's edges are as steep, and JPEG blurs a seam."""


class GlitchCheck:
    """Judges the images of one stream, each (H, W, 3) uint8 RGB and upright, against the last good.

    The raw lines of a DIGIT run along its upright image's columns.
    """

    def __init__(self) -> None:
        self._good: NDArray[np.float32] | None = None
        self._shifted = 0

    def reopened(self) -> None:
        """Note that the stream was opened anew: it has to be right now, by the same last good image."""
        self._shifted = 0

    def flaw(self, image: Image) -> str | None:
        """Return "green" or "shifted", or None for a good image.

        Raises `DeviceError` when so many are shifted in a row that the stream must be opened anew.
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
    """Whether at least a tenth of the image's columns were never filled.

    An empty YUV buffer (all zero) shows as a flat green, (0, 135, 0) by ITU-R BT.601.
    """
    sample = image[::_STEP_PX, ::_STEP_PX].astype(np.int16)
    flat = (np.ptp(sample, axis=0) <= _FLAT).all(axis=1)
    red, green, blue = sample.mean(axis=0).T
    dead = flat & (green - np.maximum(red, blue) > _GREEN_OVER)
    return bool(dead.mean() >= _DEAD_SHARE)


def shifted(good: NDArray[np.float32], seen: NDArray[np.float32]) -> bool:
    """Whether a profile (H, 4, 3) is a good one shifted circularly along its first axis, in any band.

    Three things have to be so: it differs much from the good one; moved back, nearly nothing of
    that is left; and where the ends met, there is a step the good one has nowhere.
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
    """The circular shift with the largest correlation, over all colours."""
    spectrum = np.fft.rfft(seen, axis=0) * np.conj(np.fft.rfft(good, axis=0))
    return int(np.fft.irfft(spectrum.sum(axis=1), n=len(good)).argmax())


def _profile(image: Image) -> NDArray[np.float32]:
    """Mean colour of each row within each group of columns, (H, 4, 3)."""
    small = cv2.resize(image, (BANDS, image.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)
