"""Draw the texture of the simulated object's front, with edges accurate to a fraction of a texel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

QUIET_ZONE = 0.25
"""Width of the white margin of paper around a marker, as a fraction of the marker's side."""
_PAPER_RGB, _INK_RGB = (225, 225, 225), (25, 25, 25)


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A texture to draw on; a texel that an edge crosses is painted in proportion to the covered area.

    rgba: (H, W, 4) float32, 0 to 255, premultiplied. top_left_m: (x, z) of its corner. density: texels per m.
    """

    rgba: NDArray[np.float32]
    top_left_m: NDArray[np.float64]
    density: float

    @classmethod
    def blank(
        cls, top_left_m: NDArray[np.float64], bottom_right_m: NDArray[np.float64], density: float
    ) -> "Canvas":
        """Return a transparent canvas over a rectangle of the plane, with `density` texels per m."""
        columns, rows = np.ceil(np.abs(bottom_right_m - top_left_m) * density).astype(int)
        return cls(np.zeros((rows, columns, 4), np.float32), top_left_m, density)

    @property
    def texel_T_plane(self) -> NDArray[np.float64]:  # noqa: N802
        """Matrix (3, 3) from plane coordinates (x, z, 1) in m to texels, whose centres are integers."""
        d, (x, z) = self.density, self.top_left_m
        return np.array([[d, 0.0, -d * x - 0.5], [0.0, -d, d * z - 0.5], [0.0, 0.0, 1.0]])

    def fill(
        self, low_m: NDArray[np.float64], high_m: NDArray[np.float64], rgb: tuple[int, int, int]
    ) -> None:
        """Paint a rectangle. low_m, high_m: (x, z) of its corners."""
        across, down = self._cells(low_m, high_m, 1)
        self._paint(down.T @ across, rgb)

    def print_marker(self, ink: NDArray[np.float32], centre_m: NDArray[np.float64], side_m: float) -> None:
        """Paint a marker on its paper. ink: (n, n), 1 for a black module."""
        reach = side_m * (0.5 + QUIET_ZONE)
        self.fill(centre_m - reach, centre_m + reach, _PAPER_RGB)
        across, down = self._cells(centre_m - side_m / 2, centre_m + side_m / 2, len(ink))
        self._paint(down.T @ ink @ across, _INK_RGB)

    def _cells(
        self, low_m: NDArray[np.float64], high_m: NDArray[np.float64], count: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the fraction of each texel column (count, W) and row (count, H) in `count` equal cells."""
        rows, columns = self.rgba.shape[:2]
        left, right = (np.array([low_m[0], high_m[0]]) - self.top_left_m[0]) * self.density
        top, bottom = (self.top_left_m[1] - np.array([high_m[1], low_m[1]])) * self.density
        return _coverage(left, right, count, columns), _coverage(top, bottom, count, rows)

    def _paint(self, share: NDArray[np.floating], rgb: tuple[int, int, int]) -> None:
        self.rgba[...] += share[..., None] * (np.array([*rgb, 255], np.float32) - self.rgba)


def _coverage(start: float, end: float, count: int, length: int) -> NDArray[np.float32]:
    edges = np.linspace(start, end, count + 1)[:, None]
    texel = np.arange(length)[None, :]
    return np.clip(np.minimum(texel + 1, edges[1:]) - np.maximum(texel, edges[:-1]), 0.0, 1.0).astype(
        np.float32
    )
