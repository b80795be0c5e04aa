"""Minimum, maximum, mean and standard deviation of features, added up episode by episode.

Added up, as a session's images do not fit into memory at once; LeRobot's own code for this needs torch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.types import Image

Floats = NDArray[np.float64]


@dataclass(slots=True)
class _Sums:
    low: Floats
    high: Floats
    total: Floats
    squares: Floats
    rows: int
    count: int
    shape: tuple[int, ...]


@dataclass(slots=True)
class FeatureStatistics:
    """Statistics by feature: vectors by component, images by channel, in parts of full scale."""

    _sums: dict[str, _Sums] = field(default_factory=dict)

    def add(self, name: str, values: Floats) -> None:
        """Add (N, K) values."""
        self._add(name, values, len(values), (values.shape[1],))

    def add_image(self, name: str, image: Image) -> None:
        """Add an (H, W, 3) uint8 image."""
        self._add(name, image.reshape(-1, 3) / 255.0, 1, (3, 1, 1))

    def as_json(self) -> dict[str, dict[str, Sequence[object]]]:
        """Return `min`, `max`, `mean`, `std` and `count` of each feature, as LeRobot lists them."""
        return {name: _as_json(sums) for name, sums in self._sums.items()}

    def _add(self, name: str, values: Floats, count: int, shape: tuple[int, ...]) -> None:
        low, high, total, squares = values.min(0), values.max(0), values.sum(0), (values**2).sum(0)
        known = self._sums.get(name)
        if known is None:
            self._sums[name] = _Sums(low, high, total, squares, len(values), count, shape)
            return
        known.low, known.high = np.minimum(known.low, low), np.maximum(known.high, high)
        known.total, known.squares = known.total + total, known.squares + squares
        known.rows, known.count = known.rows + len(values), known.count + count


def _as_json(sums: _Sums) -> dict[str, Sequence[object]]:
    mean = sums.total / sums.rows
    spread = np.sqrt(np.maximum(sums.squares / sums.rows - mean**2, 0.0))
    figures = {"min": sums.low, "max": sums.high, "mean": mean, "std": spread}
    return {**{key: v.reshape(sums.shape).tolist() for key, v in figures.items()}, "count": [sums.count]}
