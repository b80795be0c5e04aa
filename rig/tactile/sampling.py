"""Reading a gradient field between pixels."""

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.relief import Field


class GradientField:
    """A frame's gradients, read between pixels (bilinear).

    cv2.remap rounds places to 1/32 pixel, which keeps an alignment from settling below 0.03 degrees.
    """

    def __init__(self, gradient: Field, mask: Image) -> None:
        self._size = (gradient.shape[1] - 2, gradient.shape[0] - 2)
        corner, right = gradient[:-1, :-1], gradient[:-1, 1:]
        below = gradient[1:, :-1] - corner
        across = gradient[1:, 1:] - right - below
        # value + x (right - value) + y (below - value) + x y (mixed difference)
        parts = (corner, right - corner, below, across)
        self._parts = np.concatenate(parts, axis=2).reshape(-1, 8)
        self._mask = np.ascontiguousarray(mask[:-1, :-1]).reshape(-1)

    def at(self, places: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the gradients (N, 2) at places (N, 2) x and y, and which lie inside the mask."""
        whole = np.floor(places).astype(np.int32)
        inside = np.clip(whole, 0, self._size)
        index = inside[:, 1] * (self._size[0] + 1) + inside[:, 0]
        parts = self._parts[index]
        x, y = (places - inside).T[:, :, None]
        values = parts[:, 0:2] + x * parts[:, 2:4] + y * (parts[:, 4:6] + x * parts[:, 6:8])
        return values, (self._mask[index] > 0) & (inside == whole).all(axis=1)
