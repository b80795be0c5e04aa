"""Reading a gradient field between pixels."""

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.relief import Gradient


class GradientField:
    """A frame's gradients, read between pixels (bilinear).

    cv2.remap rounds places to 1/32 pixel, which keeps an alignment from settling below 0.03 degrees.
    """

    def __init__(self, gradient: Gradient, mask: Image) -> None:
        rows, self._columns = gradient.shape
        self._cells = (self._columns - 1, rows - 1)
        self._values = gradient.reshape(-1)
        self._mask = mask.reshape(-1)

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
        inside &= self._mask.take(index, mode="clip") > 0
        return upper + y * (lower - upper), inside
