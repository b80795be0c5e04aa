"""Guo-Hall thinning, bit for bit what `cv2.ximgproc.thinning(..., THINNING_GUOHALL)` gives.

The whole picture is one Python integer, a pixel a bit, so that a shift reaches a neighbour of all
pixels at once and one logical operation decides for all of them. Pixels are named as in the
paper: p2 north, then clockwise to p9 north-west. Source: Z. Guo, R. W. Hall, "Parallel thinning
with two-subiteration algorithms", Communications of the ACM 32 (3), 1989.

Kept beside OpenCV's for its speed: an ellipse of 120 x 30 px in 240 x 320 takes 0.5 ms here and 18 ms
there, the same in a picture that just holds it 0.6 and 2 ms (minimum of 15 runs, one thread);
`rig benchmark estimators` times both.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image

# cv2.ximgproc.thinning divides its input by 255 and rounds: from here up a pixel counts as set.
SET_FROM = 128
# Steps between two crops: each crop costs about as much as one step of a wide contact.
STEPS_PER_CROP = 10


def thin(mask: Image) -> Image:
    """Thin the set pixels (128 and above) of a mask to lines one pixel wide.

    mask: (H, W) uint8. Returns (H, W) uint8, 0 or 255. As in OpenCV, pixels on the outer rows and
    columns of the picture are never removed. Raises `InputError` for another shape or type.
    """
    if mask.ndim != 2 or mask.dtype != np.uint8:
        raise InputError(f"thinning takes a (H, W) uint8 mask, got {mask.shape} {mask.dtype}")
    binary = np.asarray(mask >= SET_FROM, dtype=np.uint8)
    if not binary.any():
        return binary
    border = _border(binary.shape)
    changed = True
    while changed:
        # What is left shrinks from step to step; cropping anew halves the work of a wide contact.
        x, y, width, height = cv2.boundingRect(binary)
        window = np.s_[y : y + height, x : x + width]
        grid = _Grid(height, width)
        bits, changed = _thin_bits(grid.pack(binary[window]), grid.pack(border[window]), grid.stride)
        binary[window] = grid.unpack(bits)
    return binary * np.uint8(255)


@dataclass(frozen=True, slots=True)
class _Grid:
    """How a picture lies in an integer: bit = row * stride + column, an empty column between rows."""

    height: int
    width: int

    @property
    def stride(self) -> int:
        """Bits per row: whole bytes, with at least one empty bit, so that no neighbour wraps."""
        return (self.width // 8 + 1) * 8

    def pack(self, binary: NDArray[np.uint8]) -> int:
        """Turn (height, width) of zeros and others into an integer."""
        rows = np.zeros((self.height, self.stride), np.uint8)
        rows[:, : self.width] = binary
        return int.from_bytes(np.packbits(rows, bitorder="little").tobytes(), "little")

    def unpack(self, bits: int) -> NDArray[np.uint8]:
        """Turn an integer back into (height, width) of 0 and 1."""
        data = bits.to_bytes(self.height * self.stride // 8, "little")
        flat = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
        return flat.reshape(self.height, self.stride)[:, : self.width]


def _border(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    border = np.ones(shape, np.uint8)
    border[1:-1, 1:-1] = 0
    return border


def _thin_bits(image: int, keep: int, stride: int) -> tuple[int, bool]:
    """Repeat the two half steps a few times; also return whether the last step removed anything."""
    for _ in range(STEPS_PER_CROP):
        before = image
        for second in (False, True):
            removable = _removable(image, stride, second)
            image ^= removable ^ (removable & keep)
        if image == before:
            return image, False
    return image, True


def _removable(image: int, stride: int, second: bool) -> int:
    """Return the set pixels that one half step removes, as bits.

    A pixel goes when C = 1 (one run of neighbours), 2 <= min(N1, N2) <= 3 and m = 0. Differences
    are written (a | b) ^ b for "a and not b": no negative integers, which are slow.
    """
    north, south = image << stride, image >> stride
    p2, p3, p4, p5 = north, north >> 1, image >> 1, south >> 1
    p6, p7, p8, p9 = south, south << 1, image << 1, north << 1
    p34, p56, p78, p92 = p3 | p4, p5 | p6, p7 | p8, p9 | p2
    p23, p45, p67, p89 = p2 | p3, p4 | p5, p6 | p7, p8 | p9
    m = ((p67 | image ^ (image & p9)) & p8) if not second else ((p23 | image ^ (image & p5)) & p4)
    a, b = (p34 | p2) ^ p2, (p56 | p4) ^ p4
    c, d = (p78 | p6) ^ p6, (p92 | p8) ^ p8
    # Exactly one of four: an odd number, but not three, which would fill one of the two pairs.
    paired = (a & b) | (c & d) | m
    n1_low, n1_high, n2_low, n2_high = p92 & p34, p56 & p78, p23 & p45, p67 & p89
    candidates = (
        image
        & (a ^ b ^ c ^ d)
        & (n1_low | n1_high | ((p92 | p34) & (p56 | p78)))
        & (n2_low | n2_high | ((p23 | p45) & (p67 | p89)))
    )
    excluded = paired | (n1_low & n1_high & n2_low & n2_high)
    return candidates ^ (candidates & excluded)
