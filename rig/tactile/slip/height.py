"""Integrate the gradient of a dent to its height."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from drivers.types import Image

Field = NDArray[np.float32]
Gradient = NDArray[np.complex64]
"""(h, w): a surface gradient per pixel, along x (right) as real and along y (down) as imaginary part,
so that turning it counter-clockwise as seen by d multiplies it by exp(-i d)."""

Box = tuple[int, int, int, int]
"""x, y, width and height in work pixels."""

# The dent reaches beyond the contact: the gel slopes off over some mm around it (work pixels).
SKIRT_PX = 11
WINDOW_BLUR_PX = 2.0
# Margin of a contact's box for sharpening and interpolation (work pixels).
BOX_PX = 7


def within(box: Box) -> tuple[slice, slice]:
    """Return the rows and columns of a box."""
    left, top, width, height = box
    return slice(top, top + height), slice(left, left + width)


def contact_box(mask: Image, margin: int = BOX_PX) -> Box:
    """Return the box around a mask with room for sharpening, interpolation and slopes at its edge."""
    left, top, width, height = cv2.boundingRect(mask)
    right, bottom = min(left + width + margin, mask.shape[1]), min(top + height + margin, mask.shape[0])
    left, top = max(left - margin, 0), max(top - margin, 0)
    return left, top, right - left, bottom - top


def relief(gradient: Gradient, mask: Image, step: int = 1) -> Field:
    """Integrate a gradient (h, w) to a height (h, w) float32, zero on average outside the contact.

    mask: (h, w) uint8, 1 in the contact. The height whose gradient is nearest to the given one
    (least squares, by Fourier transform); a dent is positive inside. step: work pixels per pixel.
    """
    rows, columns = mask.shape
    dent = gradient * window(mask, step)
    spread = pad(np.stack([dent.real, dent.imag]), 0.5)
    spectrum = np.asarray(fft.rfft2(spread), np.complex64)
    across, down = _integrals(spread.shape[1], spread.shape[2])
    height = fft.irfft2(across * spectrum[0] + down * spectrum[1], s=spread.shape[1:])
    inside = np.asarray(height, np.float32)[:rows, :columns]
    outside = mask == 0
    return inside - (inside[outside].mean() if outside.any() else inside.min())


@lru_cache(maxsize=8)
def _integrals(height: int, width: int) -> tuple[Gradient, Gradient]:
    """Return the factors of the slopes' transforms, along x and y, that give that of the height."""
    ky = 2.0 * np.pi * np.fft.fftfreq(height)[:, None]
    kx = 2.0 * np.pi * np.fft.rfftfreq(width)[None]
    squares = kx * kx + ky * ky
    squares[0, 0] = 1.0
    return (-1j * kx / squares).astype(np.complex64), (-1j * ky / squares).astype(np.complex64)


def window(mask: Image, step: int = 1) -> Field:
    """Return a soft window (h, w), 1 over a contact and the sloping gel around it."""
    reach = 2 * (SKIRT_PX // step) + 1
    grown = cv2.dilate(mask, np.ones((reach, reach), np.uint8)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grown, (0, 0), WINDOW_BLUR_PX / step), np.float32)


def pad(fields: Field, share: float) -> Field:
    """Return fields (F, h, w) with a share of zeros added below and right; transforms are periodic."""
    count, rows, columns = fields.shape
    height, width = (int(fft.next_fast_len(n + int(n * share)) or n) for n in (rows, columns))
    spread = np.zeros((count, height, width), np.float32)
    spread[:, :rows, :columns] = fields
    return spread
