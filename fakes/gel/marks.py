"""Specks and scratches of a worn gel: small relief that shows where the gel is pressed, and rests."""

import cv2
import numpy as np
from numpy.typing import NDArray


def draw_marks(shape: tuple[int, ...], px_mm: float, seed: int | None) -> NDArray[np.float32] | None:
    """Return how far marks dent the film, mm, (h, w) float32, negative for scratches; None without a seed.

    shape, px_mm: of the geometry.
    """
    if seed is None:
        return None
    rng = np.random.default_rng((seed, 59))
    marks = np.zeros(shape, np.float32)
    rows, columns = shape
    for _ in range(int(rng.integers(2, 14))):
        speck = np.zeros(shape, np.float32)
        speck[int(rng.integers(2, rows - 2)), int(rng.integers(2, columns - 2))] = 1.0
        wide_px = float(rng.uniform(0.12, 0.3)) / px_mm
        speck = cv2.GaussianBlur(speck, (0, 0), wide_px)
        marks += np.float32(rng.uniform(0.03, 0.09) / speck.max()) * speck
    for _ in range(int(rng.integers(0, 3))):
        scratch = np.zeros(shape, np.float32)
        start = rng.uniform(0.0, 1.0, 2) * (columns, rows)
        way = rng.uniform(0.0, 2.0 * np.pi)
        end = start + rng.uniform(2.0, 8.0) / px_mm * np.array([np.cos(way), np.sin(way)])
        cv2.line(scratch, start.astype(int).tolist(), end.astype(int).tolist(), 1.0, 1, cv2.LINE_AA)
        scratch = cv2.GaussianBlur(scratch, (0, 0), 0.15 / px_mm)
        marks -= np.float32(rng.uniform(0.015, 0.05)) * scratch / max(float(scratch.max()), 1e-6)
    return marks
