"""Disturb the images of a clip, as noise, blur, codecs, light and lost frames do; functions with a seed."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.images import decode_stored, encode_jpeg
from drivers.types import Image
from fakes.studio.clips import Clip

Disturbance = Callable[[Clip, np.random.Generator], Clip]
LED_PATTERN = (1.0, -1.0, 0.5)
"""Relative error of red, green and blue for a fault of the LEDs."""
GAP_S = 0.25
"""Length of the gap in the stream."""


def nothing(clip: Clip, rng: np.random.Generator) -> Clip:
    """Return the clip unchanged."""
    return clip


def noise(sigma_grey: float) -> Disturbance:
    """Add white noise to every frame, in addition to the noise of the sensor.

    One noise field larger than the frame is shifted at random, which is much faster than new noise per frame.
    """

    def noisy(clip: Clip, rng: np.random.Generator) -> Clip:
        height, width = clip.background.shape[:2]
        field = rng.normal(0.0, sigma_grey, (height + 64, width + 64, 3)).astype(np.float32)

        def disturbed(image: Image) -> Image:
            down, across = rng.integers(0, 64, 2)
            return _grey(image + field[down : down + height, across : across + width])

        return replace(clip, frames=tuple(map(disturbed, clip.frames)))

    return noisy


def blur(sigma_px: float) -> Disturbance:
    """Blur frames and background."""
    return _each(lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8))


def jpeg(quality: int) -> Disturbance:
    """Encode and decode every frame as JPEG; the background is unchanged."""
    return _each(lambda image: decode_stored(encode_jpeg(image, quality)), background=False)


def resized(width: int, height: int) -> Disturbance:
    """Resize frames and background."""

    def change(image: Image) -> Image:
        way = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
        return np.asarray(cv2.resize(image, (width, height), interpolation=way), np.uint8)

    return _each(change)


def landscape(clip: Clip, rng: np.random.Generator) -> Clip:
    """Rotate frames and background by 90 degrees, as of a sensor mounted on its side."""
    lying = _each(lambda image: np.ascontiguousarray(np.rot90(image)))(clip, rng)
    return replace(lying, aspect=None if clip.aspect is None else 1.0 / clip.aspect)


def uncalibrated(clip: Clip, rng: np.random.Generator) -> Clip:
    """Remove the known aspect of the pixels."""
    return replace(clip, aspect=None)


def gains(error: float) -> Disturbance:
    """Scale the channels of all frames, but not of the background, by 1 + error * LED_PATTERN."""
    return _lit((1.0, 1.0), error)


def drift(error: float, pattern: Sequence[float] = LED_PATTERN) -> Disturbance:
    """Let the channels' gains drift from 1 to 1 + error * pattern over the clip."""
    return _lit((0.0, 1.0), error, pattern)


def offset(grey: float) -> Disturbance:
    """Add a constant to every frame, but not to the background, as stray light does."""
    return _lit((0.0, 0.0), grey=grey)


def dropped(clip: Clip, rng: np.random.Generator) -> Clip:
    """Drop half of the frames at random."""
    return _kept(clip, rng.random(len(clip.frames)) < 0.5)


def gap(clip: Clip, rng: np.random.Generator) -> Clip:
    """Drop the frames of a quarter of a second during the rotation."""
    times = np.array(clip.time_ns)
    begins = clip.moves_ns + to_ns(0.2)
    return _kept(clip, (times < begins) | (times >= begins + to_ns(GAP_S)))


def every(step: int) -> Disturbance:
    """Keep every Nth frame, as of a slower camera."""
    return lambda clip, rng: _kept(clip, np.arange(len(clip.frames)) % step == 0)


def duplicated(clip: Clip, rng: np.random.Generator) -> Clip:
    """Replace every third frame by a copy of the previous frame, at its own time."""
    frames = list(clip.frames)
    truth = clip.angle_deg.copy()
    for i in range(2, len(frames), 3):
        frames[i], truth[i] = frames[i - 1], truth[i - 1]
    return replace(clip, frames=tuple(frames), angle_deg=truth)


def torn(clip: Clip, rng: np.random.Generator) -> Clip:
    """Replace the lower part of every tenth frame by that of the frame three frames earlier."""
    frames = list(clip.frames)
    for i in range(5, len(frames), 10):
        cut = int(rng.integers(frames[i].shape[0] // 4, 3 * frames[i].shape[0] // 4))
        frames[i] = np.concatenate([clip.frames[i][:cut], clip.frames[i - 3][cut:]])
    return replace(clip, frames=tuple(frames))


def late(clip: Clip, rng: np.random.Generator) -> Clip:
    """Swap every tenth frame with the next one, as if it were delivered late."""
    order = np.arange(len(clip.frames))
    for i in range(5, len(order) - 1, 10):
        order[i], order[i + 1] = order[i + 1], order[i]
    return _in_order(clip, order)


def _each(change: Callable[[Image], Image], background: bool = True) -> Disturbance:
    """Return a disturbance that changes every frame, and the background if `background`."""
    return lambda clip, rng: replace(
        clip,
        background=change(clip.background) if background else clip.background,
        frames=tuple(change(frame) for frame in clip.frames),
    )


def _lit(
    share: tuple[float, float], error: float = 0.0, pattern: Sequence[float] = (0.0,) * 3, grey: float = 0.0
) -> Disturbance:
    """Return a disturbance of the light.

    share: fractions of the error at the first and the last frame, interpolated linearly. error, pattern: see
    `gains`. grey: constant to add.
    """

    def lit(clip: Clip, rng: np.random.Generator) -> Clip:
        shares = np.linspace(*share, len(clip.frames))
        frames = (
            _grey(
                frame * (1.0 + s * error * np.asarray(pattern, float)).astype(np.float32) + np.float32(grey)
            )
            for s, frame in zip(shares, clip.frames, strict=True)
        )
        return replace(clip, frames=tuple(frames))

    return lit


def _grey(values: NDArray[np.float32]) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _kept(clip: Clip, keep: NDArray[np.bool_]) -> Clip:
    return _in_order(clip, np.flatnonzero(keep))


def _in_order(clip: Clip, order: NDArray[np.intp]) -> Clip:
    return replace(
        clip,
        frames=tuple(clip.frames[i] for i in order),
        time_ns=tuple(clip.time_ns[i] for i in order),
        angle_deg=clip.angle_deg[order],
    )
