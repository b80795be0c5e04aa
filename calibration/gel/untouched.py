"""What photographs of presses show where nothing touches the gel: background, noise and JPEG compression."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image

Array = NDArray[np.floating]
Circle = tuple[float, float, float]
"""x, y and radius of a contact, px of the image."""

ENOUGH_FRAMES = 8
"""Number of untouched frames from which the presses are not needed for the background."""
_UNTOUCHED = 2.2
"""Beyond this, in radii of the circle of its contact, a press leaves the gel as it is."""
_NOISE_FRAMES, _NOISE_SMOOTH_PX = 12, 8.0
"""Number of stored noise frames; broader structure than the second value is light, not noise."""
_JPEG_QUALITIES = range(50, 97)
_JPEG_DIP = 0.8
"""Compressing a picture again with its own quality changes it by less than this share of the next quality."""


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """A photograph of a pressed ball, and the circle of its contact."""

    id: str
    image: Image
    circle: Circle
    radius_mm: float


def jpeg_quality(image: Image) -> int | None:
    """Quality of the JPEG compression that a picture shows; None if it shows none.

    A picture that was compressed at a quality hardly changes when it is compressed so again.
    """
    errors = [_recompression_error(image, quality) for quality in _JPEG_QUALITIES]
    drop = np.array(errors[1:-1]) / np.maximum(np.minimum(errors[:-2], errors[2:]), 1e-3)
    found = int(np.argmin(drop))
    return _JPEG_QUALITIES[found + 1] if drop[found] < _JPEG_DIP else None


def _recompression_error(image: Image, quality: int) -> float:
    _, data = cv2.imencode(".jpg", image[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality))
    again = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.float32)
    return float(np.sqrt(((again - image) ** 2).mean()))


def background_and_noise(
    presses: Sequence[Pressed], background: Image, untouched: Sequence[Image]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Median background (H, W, 3), and the noise (N, H, W, 3) of some frames, from pixels without contact."""
    frames = [np.asarray(frame, np.float32) for frame in (background, *untouched)]
    free = [np.ones(background.shape[:2], bool) for _ in frames]
    rows, columns = np.indices(background.shape[:2])
    for press in () if len(untouched) >= ENOUGH_FRAMES else presses:
        x, y, radius = press.circle
        frames.append(press.image.astype(np.float32))
        free.append(np.hypot(columns - x, rows - y) > _UNTOUCHED * radius)
    level = np.array([np.median((f - frames[0])[m], axis=0) for f, m in zip(frames, free, strict=True)])
    still = np.stack(frames) - level[:, None, None].astype(np.float32)
    still[~np.stack(free)] = np.nan
    # the median, because light that a contact takes away far from it counts as untouched in some presses
    mean = np.nanmedian(still, axis=0).astype(np.float32)
    noise = [np.where(np.isnan(f), 0.0, f - mean).astype(np.float32) for f in still]
    fine = [f - cv2.GaussianBlur(f, (0, 0), _NOISE_SMOOTH_PX) for f in noise]
    return mean, np.stack([_filled(i, fine, free) for i in range(min(_NOISE_FRAMES, len(fine)))])


def _filled(number: int, noise: Sequence[Array], free: Sequence[NDArray[np.bool_]]) -> NDArray[np.float32]:
    """Noise of a frame; where that has its contact, the noise of the next frames that have none there."""
    whole, missing = noise[number].copy(), ~free[number]
    for step in range(1, len(noise)):
        other = (number + step) % len(noise)
        now = missing & free[other]
        whole[now], missing = noise[other][now], missing & ~now
    return np.asarray(whole, np.float32)
