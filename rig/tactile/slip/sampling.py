"""A frame's gradients as an alignment looks at them: sharpened, and read between pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.height import Box, Gradient, within

# What is broad in a contact's slopes is less to be trusted than what is fine: the gel gives way around
# the contact, the map is a little wrong, and an arc that slides along itself keeps its outline. So much
# of the mean over this many pixels around is taken off (standard deviation and reach of the window).
BROAD_PX, BROAD_REACH_PX, BROAD_SHARE = 2.0, 4, 0.6


def sharpened(gradient: Gradient) -> Gradient:
    """Return a gradient field (h, w) with its broad part made weaker."""
    pairs = np.ascontiguousarray(gradient).view(np.float32).reshape(*gradient.shape, 2)
    side = 2 * BROAD_REACH_PX + 1
    broad = cv2.GaussianBlur(pairs, (side, side), BROAD_PX)
    return cv2.scaleAdd(broad, -BROAD_SHARE, pairs).view(np.complex64)[..., 0]


class GradientField:
    """A frame's sharpened gradients inside its contact, read between pixels (bilinear).

    gradient: (h, w). mask: (h, w) uint8, 1 in the contact. box: where the gradient is not 0, all of it by
    default; it has room for the sharpening's reach around the contact.
    cv2.remap rounds places to 1/32 pixel, which keeps an alignment from settling below 0.03 degrees.
    """

    def __init__(self, gradient: Gradient, mask: Image, box: Box | None = None) -> None:
        self.mask = mask
        rows, self._columns = gradient.shape
        self._cells = (self._columns - 1, rows - 1)
        inside = within(box, gradient.shape)
        values = np.zeros(gradient.shape, np.complex64)
        values[inside] = sharpened(gradient[inside])
        self._values = values.reshape(-1)
        self._inside = mask.reshape(-1)
        self._planes: NDArray[np.float32] | None = None

    @property
    def planes(self) -> NDArray[np.float32]:
        """The gradients' x and y and the mask, (h, w, 3), for a rough look at many places."""
        if self._planes is None:
            pairs = self._values.view(np.float32).reshape(*self.mask.shape, 2)
            self._planes = np.dstack([pairs, self.mask.astype(np.float32)])
        return self._planes

    def at(self, places: NDArray[np.complex64]) -> tuple[NDArray[np.complex64], NDArray[np.bool_]]:
        """Return the gradients (N,) at places (N,), and which places lie inside the mask."""
        left, above = np.floor(places.real), np.floor(places.imag)
        x, y = places.real - left, places.imag - above
        column, row = left.astype(np.int32), above.astype(np.int32)
        index = row * self._columns + column
        corner, right, below, across = (
            self._values.take(index + step, mode="clip") for step in (0, 1, self._columns, self._columns + 1)
        )
        upper, lower = corner + x * (right - corner), below + x * (across - below)
        # As unsigned numbers, places left of or above the image are far beyond it.
        inside = (column.view(np.uint32) < self._cells[0]) & (row.view(np.uint32) < self._cells[1])
        inside &= self._inside.take(index, mode="clip") > 0
        return upper + y * (lower - upper), inside


def read(planes: NDArray[np.float32], places: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Return three planes (h, w, 3) at places (...), (..., 3), bilinear; 0 outside.

    Places are rounded to 1/32 pixel: enough where several motions are told apart, and three times as fast.
    """
    pairs = places.astype(np.complex64, copy=False).reshape(-1).view(np.float32)
    # A row costs less than half of a column; it has room for so many.
    pairs = pairs.reshape((1, -1, 2) if places.size < _LONGEST_ROW else (-1, 1, 2))
    found = cv2.remap(planes, pairs, _NO_SECOND_MAP, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float32).reshape(*places.shape, 3)


_LONGEST_ROW = 2**15 - 1
_NO_SECOND_MAP = np.empty(0, np.float32)
