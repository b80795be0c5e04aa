"""Compiled passes over the pixels of planes (3, h, w): difference, gel marks, slopes, structure."""

import math

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.compiled import compiled

Field = NDArray[np.float32]
Image = NDArray[np.uint8]


@compiled
def subtract_light(
    colours: Image, corner: tuple[int, int], light: NDArray[np.float64], terms: tuple[Field, Field],
    table: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], Field], saturated: int, out: Field,
) -> None:  # fmt: skip
    """Compute the relative difference of a part of an image, with gel marks filled, into out.

    colours: of the part, (3, h, w), which begins at a corner, left and top. terms: see `RelativeDifference`,
    each (3, H, W). table: see `GelMarks.table`. saturated: from this grey level on a pixel is not darker than
    the background.
    """
    (left, top), (weight, relative), (marks, begins, rims, fill) = corner, terms, table
    height, width = out.shape[1], out.shape[2]
    for k in range(3):
        by, less = np.float32(1.0 / light[0, k]), np.float32(light[1, k] / light[0, k])
        for r in range(height):
            # Views of rows, because an index with an offset would be checked for being negative.
            seen, known, usual, into = (
                colours[k, r],
                weight[k, top + r, left:],
                relative[k, top + r, left:],
                out[k, r],
            )
            for c in range(width):
                off = (np.float32(seen[c]) * by - less) * known[c] - usual[c]
                into[c] = max(off, np.float32(0.0)) if seen[c] >= saturated else off
    for m in range(marks.shape[1]):
        r, c = marks[0, m] - top, marks[1, m] - left
        if r < 0 or c < 0 or r >= height or c >= width:
            continue
        one, two, three = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for j in range(begins[m], begins[m + 1]):
            y, x = min(max(rims[0, j] - top, 0), height - 1), min(max(rims[1, j] - left, 0), width - 1)
            one += fill[j] * out[0, y, x]
            two += fill[j] * out[1, y, x]
            three += fill[j] * out[2, y, x]
        out[0, r, c], out[1, r, c], out[2, r, c] = one, two, three


@compiled
def slopes_in(difference: Field, colours: Field, top: int, left: int, out: Field) -> None:
    """Compute the slopes of a part, out (h, w, 2), of a difference (H, W, 3) with a map (6, H, W)."""
    for r in range(out.shape[0]):
        seen, by = difference[top + r, left:], colours[:, top + r, left:]
        for c in range(out.shape[1]):
            one, two, three = seen[c, 0], seen[c, 1], seen[c, 2]
            out[r, c, 0] = by[0, c] * one + by[1, c] * two + by[2, c] * three
            out[r, c, 1] = by[3, c] * one + by[4, c] * two + by[5, c] * three


@compiled
def summed_tensor(fine: Field, parts: Field) -> None:
    """Compute the structure tensor, its three parts, summed over the colours, of fine (3, h, w)."""
    side, straight = np.float32(3.0 / 32.0), np.float32(10.0 / 32.0)
    parts[:] = np.float32(0.0)
    for r in range(1, fine.shape[1] - 1):
        for k in range(3):
            for c in range(1, fine.shape[2] - 1):
                a, b, d = fine[k, r - 1, c - 1], fine[k, r - 1, c], fine[k, r - 1, c + 1]
                e, f = fine[k, r, c - 1], fine[k, r, c + 1]
                g, h, i = fine[k, r + 1, c - 1], fine[k, r + 1, c], fine[k, r + 1, c + 1]
                x = side * (d - a + i - g) + straight * (f - e)
                y = side * (g - a + i - d) + straight * (h - b)
                parts[0, r, c] += x * x - y * y
                parts[1, r, c] += np.float32(2.0) * x * y
                parts[2, r, c] += x * x + y * y


@compiled
def beyond_noise(
    tensor: Field, least: float, margins: tuple[int, int, int, int], counts: Field, planes: Field
) -> None:
    """Compute direction and strength (3, h, w) times counts; 0 where changes are not larger than the least.

    margins: left, above, right, below; they are 0.
    """
    none, floor = np.float32(0.0), np.float32(least)
    planes[:] = none
    first, count = margins[0], max(planes.shape[2] - margins[0] - margins[2], 0)
    share = np.empty(count, np.float32)
    for r in range(margins[1], planes.shape[1] - margins[3]):
        squares, weights = tensor[2, r, first:], counts[r, first:]
        for c in range(count):
            strength = max(np.sqrt(max(squares[c], np.float32(1e-12))) - floor, none)
            share[c] = np.sqrt(strength * np.sqrt(strength)) / (squares[c] + np.float32(1e-12)) * weights[c]
        for k in range(3):
            seen, into = tensor[k, r, first:], planes[k, r, first:]
            for c in range(count):
                into[c] = seen[c] * share[c]


@compiled
def strongest_energy(planes: Field, reach: Image, scale: int, top: int, left: int, count: int) -> float:
    """Return the root energy of about `count` strongest pixels where reach, in work pixels, is not 0."""
    most = np.float32(1e-12)
    for r in range(planes.shape[1]):
        for c in range(planes.shape[2]):
            most = max(most, planes[2, r, c])
    many, energy = np.zeros(256, np.int64), np.zeros(256, np.float32)
    by = np.float32(255.0) / most
    for r in range(planes.shape[1]):
        for c in range(planes.shape[2]):
            strength = planes[2, r, c]
            if strength > np.float32(0.0) and reach[top + r // scale, left + c // scale]:
                level = min(int(strength * by), 255)
                many[level] += 1
                energy[level] += planes[0, r, c] ** 2 + planes[1, r, c] ** 2 + strength**2
    total, left_over = 0.0, count
    for level in range(255, -1, -1):
        if many[level] >= left_over:
            return math.sqrt(total + energy[level] * left_over / max(many[level], 1))
        total += energy[level]
        left_over -= many[level]
    return math.sqrt(total)
