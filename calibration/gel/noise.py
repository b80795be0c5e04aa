"""The noise of a camera's frames: its covariance over colours and neighbouring pixels.

Cameras interpolate colours and store them at half resolution, so noise is correlated over some pixels,
differs between the pixels of a 2 x 2 cell, and is stronger in colour than in brightness. The covariance
of cells contains all of this. Fields with the same covariance are drawn in Fourier space.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Fields = NDArray[np.float32]

CELL_PX = 2
_REACH = 6
"""Cells over which noise is correlated at most. In frames of D20641 the correlation ends after 2 cells."""
_ROUNDING = 1.0 / 12.0
"""Variance of rounding to whole grey levels, which drawn frames get by their own rounding."""
_VALUES = CELL_PX * CELL_PX * 3


@dataclass(frozen=True, slots=True, eq=False)
class CameraNoise:
    """Stationary Gaussian noise.

    covariance: (2R + 1, 2R + 1, 12, 12) grey levels squared, between the values of a cell and those of the
    cell that lies -R to R rows and columns further. A cell has 2 x 2 pixels of R, G, B.
    """

    covariance: Array

    @property
    def colours(self) -> Array:
        """(3, 3) covariance of the channels of a pixel, grey levels squared."""
        of_a_cell = self.covariance[_REACH, _REACH].reshape(_VALUES // 3, 3, _VALUES // 3, 3)
        return np.asarray(np.einsum("pipj->ij", of_a_cell) * 3.0 / _VALUES)

    @property
    def sigma_grey(self) -> Array:
        """(3,) standard deviation per channel."""
        return np.sqrt(np.diagonal(self.colours))

    @classmethod
    def independent(cls, colours: Array) -> "CameraNoise":
        """Return noise that is independent between pixels. colours: (3, 3), see `colours`."""
        covariance = np.zeros((2 * _REACH + 1, 2 * _REACH + 1, _VALUES, _VALUES))
        covariance[_REACH, _REACH] = np.kron(np.eye(_VALUES // 3), colours)
        return cls(covariance)

    def scaled(self, factor: float) -> "CameraNoise":
        return replace(self, covariance=self.covariance * factor**2)

    def draw(self, shape: tuple[int, int], count: int, rng: np.random.Generator) -> Fields:
        """Draw fields of noise, (count, H, W, 3) grey levels, that are periodic apart from cut-off edges."""
        rows, columns = (-(-size // CELL_PX) for size in shape)
        lags, periodic = np.arange(-_REACH, _REACH + 1), np.zeros((rows, columns, _VALUES, _VALUES))
        # tapered over the farther half, so that cutting the covariance off leaves no ripples in the spectrum
        taper = np.cos(np.pi * np.maximum(np.abs(lags) / (_REACH + 1) - 0.5, 0.0)) ** 2
        tapered = self.covariance * (taper[:, None] * taper)[..., None, None]
        np.add.at(periodic, (lags[:, None] % rows, lags % columns), tapered)
        power, directions = np.linalg.eigh(np.fft.rfft2(periodic, axes=(0, 1)).conj())
        # the square root of the spectrum, (rows, columns / 2 + 1, 12, 12)
        factor = directions * np.sqrt(np.maximum(power, 0.0))[..., None, :]
        fields = np.empty((count, CELL_PX * rows, CELL_PX * columns, 3), np.float32)
        for field in fields:
            white = np.fft.rfft2(rng.standard_normal((rows, columns, _VALUES)), axes=(0, 1))
            coloured = np.einsum("hwij,hwj->hwi", factor, white)
            cells = np.fft.irfft2(coloured, (rows, columns), axes=(0, 1))
            split = cells.reshape(rows, columns, CELL_PX, CELL_PX, 3).transpose(0, 2, 1, 3, 4)
            field[:] = split.reshape(field.shape)
        return fields[:, : shape[0], : shape[1]]


def measure_noise(frames: Sequence[Array], free: Sequence[NDArray[np.bool_]]) -> CameraNoise:
    """Measure the noise of frames of whole grey levels, without their rounding.

    frames: (H, W, 3), minus their mean. free: (H, W), true at pixels without contact.
    """
    span = range(-_REACH, _REACH + 1)
    pairs = [(down, across) for down in range(_REACH + 1) for across in span if (down, across) >= (0, 0)]
    covariance = np.zeros((len(span), len(span), _VALUES, _VALUES))
    counts = dict.fromkeys(pairs, 0)
    for frame, where in zip(frames, free, strict=True):
        used = _cells(np.repeat(where[..., None], 3, axis=2).astype(np.float32)).min(axis=2)
        cells = _cells(np.asarray(frame, np.float32)) * used[..., None]
        for down, across in pairs:
            # cells that have a neighbour at the offset, and these neighbours
            rows, columns = used.shape
            first = slice(0, rows - down), slice(max(0, -across), columns - max(0, across))
            second = slice(down, rows), slice(max(0, across), columns + min(0, across))
            product = cells[first].reshape(-1, _VALUES).T @ cells[second].reshape(-1, _VALUES)
            covariance[_REACH + down, _REACH + across] += product
            counts[down, across] += int((used[first] * used[second]).sum())
    for (down, across), count in counts.items():
        covariance[_REACH + down, _REACH + across] /= max(count, 1)
        covariance[_REACH - down, _REACH - across] = covariance[_REACH + down, _REACH + across].T
    covariance[_REACH, _REACH] -= _ROUNDING * np.eye(_VALUES)
    return CameraNoise(covariance)


def _cells(image: Fields) -> Fields:
    """Return the cells (h, w, 12) of an image (H, W, 3), without an odd last row or column."""
    rows, columns = image.shape[0] // CELL_PX, image.shape[1] // CELL_PX
    whole = image[: CELL_PX * rows, : CELL_PX * columns]
    split = whole.reshape(rows, CELL_PX, columns, CELL_PX, 3).transpose(0, 2, 1, 3, 4)
    return split.reshape(rows, columns, _VALUES)
