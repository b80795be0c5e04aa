"""Shadows of a dent in a simulated gel, around it and behind it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fakes.gel.light import Light
from fakes.gel.variation import Variation

_SHIFT_PX = 5
_MOST_LOST = 0.6
_STREAK_MM = 12.0
"""Distance behind a contact at which a long shadow has faded to 1/e."""

DepthMap = NDArray[np.float32]


def shade(dent: DepthMap, light: Light, variation: Variation, px_mm: float) -> DepthMap:
    """Return the fraction of each colour's light that is lost, (3, h, w) float32, 0 to 0.6.

    dent: (h, w) mm. px_mm: size of its pixels. At the foot of a dent all colours lose light. Behind the dent,
    as seen from an LED, the colour of that LED loses light. Units with streaks also have long shadows in
    rays.
    """
    smooth = np.asarray(cv2.blur(dent, (9, 9)), np.float32)
    rim = np.maximum(smooth - dent, 0.0) * np.float32(variation.rim_per_mm)
    (rows, columns), lost = dent.shape, np.empty((3, *dent.shape), np.float32)
    ways = zip(light.towards_x, light.towards_y, strict=True)
    towards = [(float(x.mean()), float(y.mean())) for x, y in ways]
    px = _SHIFT_PX
    padded = cv2.copyMakeBorder(smooth, px, px, px, px, cv2.BORDER_REPLICATE)
    for colour, (x, y) in enumerate(towards):
        top, left = px + round(y * px), px + round(x * px)
        lost[colour] = padded[top : top + rows, left : left + columns]
    lost -= dent
    np.maximum(lost, 0.0, out=lost)
    lost *= np.float32(variation.shadow_per_mm)
    lost += rim
    if variation.streak_per_mm > 0.0:
        lost += np.stack([_streaks(smooth, dent, way, variation, px_mm) for way in towards])
    return np.minimum(lost, np.float32(_MOST_LOST), out=lost)


def _streaks(
    smooth: DepthMap, dent: DepthMap, towards: tuple[float, float], variation: Variation, px_mm: float
) -> DepthMap:
    """Return the light of one LED lost behind a dent, in streaks, as real glow is uneven across the beam."""
    behind = np.maximum(_long_shadow(smooth, towards, px_mm) - dent, 0.0)
    rng = np.random.default_rng(variation.light_seed or 0)
    rows, columns = dent.shape
    along = np.arange(columns)[None, :] * -towards[1] + np.arange(rows)[:, None] * towards[0]
    across = (along - along.min()).astype(np.float32)
    wave = np.asarray(cv2.GaussianBlur(rng.standard_normal((1, 400)).astype(np.float32), (0, 0), 3.0))
    pattern = cv2.remap(0.5 + wave / (4.0 * wave.std()), across, np.zeros_like(across), cv2.INTER_LINEAR)
    return np.asarray(np.float32(variation.streak_per_mm) * behind * np.clip(pattern, 0.0, 1.5), np.float32)


def _long_shadow(dent: DepthMap, towards: tuple[float, float], px_mm: float) -> DepthMap:
    """Return the largest depth (mm) between each pixel and its light, (h, w), fading with distance.

    towards: unit vector from the glow to the middle of the gel, x right and y down. In real frames a contact
    darkens the region between it and the glow of a colour, as if the light came from the other side.
    """
    shadow, step_px = dent, 1.0
    while step_px * px_mm < _STREAK_MM:
        shift = np.array([[1.0, 0.0, -towards[0] * step_px], [0.0, 1.0, -towards[1] * step_px]])
        moved = np.asarray(cv2.warpAffine(shadow, shift, dent.shape[::-1]), np.float32)
        shadow = np.maximum(shadow, moved * np.float32(np.exp(-step_px * px_mm / _STREAK_MM)))
        step_px *= 2.0
    return shadow
