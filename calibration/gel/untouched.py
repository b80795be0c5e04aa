"""What photographs of presses show where nothing touches the gel: background, noise and JPEG compression."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.noise import CameraNoise, measure_noise
from drivers.types import Image

Array = NDArray[np.floating]
Circle = tuple[float, float, float]
"""x, y and radius of a contact, px of the image."""

ENOUGH_FRAMES = 8
"""Number of untouched frames from which the presses are not needed for the background."""
_UNTOUCHED = 2.2
"""Beyond this, in radii of the circle of its contact, a press leaves the gel as it is."""
_LIGHT_PX = 8.0
"""Standard deviation of a blur; broader structure is light, not noise."""
_NOISE_PX = 2.0
"""Standard deviation of a blur that removes most of a camera's noise."""
_MEDIAN_VARIANCE = np.pi / 2.0
"""Variance of the median of N normal values, times N, over their variance."""
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
) -> tuple[NDArray[np.float32], CameraNoise]:
    """Median background (H, W, 3), and the noise of single frames, from pixels without contact."""
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
    mean = _without_noise(np.nanmedian(still, axis=0).astype(np.float32), still, np.stack(free).sum(axis=0))
    noise = [_fine(np.where(np.isnan(f), 0.0, f - mean), m) for f, m in zip(still, free, strict=True)]
    return mean, measure_noise(noise, free)


def _without_noise(
    median: NDArray[np.float32], still: Array, count: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Remove from a median of few frames the noise that is left in it (Wiener filter); dust remains.

    still: (N, H, W, 3), NaN where a frame is not free. count: (H, W), frames that are free.
    """
    smooth = cv2.GaussianBlur(median, (0, 0), _NOISE_PX)
    scatter = np.nanmean((still[:, ::4, ::4] - median[::4, ::4]) ** 2, axis=(0, 1, 2))
    left = scatter * _MEDIAN_VARIANCE / np.maximum(count, 1)[..., None]
    local = cv2.GaussianBlur((median - smooth) ** 2, (0, 0), 2.0 * _NOISE_PX)
    kept = np.maximum(1.0 - left / np.maximum(local, 1e-6), 0.0)
    return np.asarray(smooth + kept * (median - smooth), np.float32)


def _fine(noise: Array, free: NDArray[np.bool_]) -> Array:
    """Noise of a frame (H, W, 3) without broad structure, which is light; 0 in contacts."""
    share = cv2.GaussianBlur(free.astype(np.float32), (0, 0), _LIGHT_PX)[..., None]
    broad = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), _LIGHT_PX) / np.maximum(share, 0.05)
    return np.asarray(np.where(free[..., None], noise - broad, 0.0), np.float32)
