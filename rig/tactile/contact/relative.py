"""Compute the difference between a frame and the frame without contact, independent of the light.

In a DIGIT-like sensor most changes of the light multiply the image (dimmed LEDs, white balance, dark
corners); stray light adds to it. Therefore a frame is corrected by a gain and an offset per channel, and its
difference is divided by the background. All of this is done on a reduced copy.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.sample import check_frame

# Grey levels added to the background before the division, so that noise in dark corners is not a contact.
DARK_OFFSET = 20.0
# Gain and offset are fitted to the means of blocks with this side in px, because the noise of single pixels
# would bias them. The fit uses the fraction GAIN_TRUSTED of the blocks that fit best, because a wide contact
# can cover more than half of a fingertip. GAIN_ROUNDS is the number of refits.
GAIN_BLOCK_PX, GAIN_TRUSTED, GAIN_ROUNDS = 6, 0.4, 2
# Weight of the ridge term that pulls the offset towards zero.
OFFSET_RIDGE = 0.01
# Added to denominators against division by zero for a black background, grey levels squared.
NEGLIGIBLE = 1e-3
# From this grey level on a pixel of a reduced copy counts as saturated. Its light is at least as bright as
# seen, so it is not darker than the background.
SATURATED = 250
# A copy that is smaller by less than this factor is interpolated: means of areas take five times as long.
SLIGHTLY = 1.25
# Smallest gain: a darker frame counts as black and is not scaled up further.
DARKEST_GAIN = 0.02
# Standard deviation of the blur against noise of single pixels, in pixels of the reduced copy; side of its
# kernel.
NOISE_BLUR_PX, NOISE_BLUR_SIDE = 0.7, 5
CHANNELS = 3
# Long side of the reduced copy: a quarter of a DIGIT's frame, fine enough because the gel blurs by 0.2 mm.
WORK_LONG_SIDE_PX = 80

Light = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Gain and offset per channel of a frame against its background."""


class RelativeDifference:
    """Compares the frames of one sensor with its background.

    background: (H, W, 3) uint8 RGB, a frame without contact. size: (width, height) in px of the
    reduced copy.
    """

    def __init__(self, background: Image, size: tuple[int, int]) -> None:
        check_frame(background)
        self.size = size
        work = self.reduce(background).astype(np.float32)
        self._weight = np.asarray(1.0 / (work + DARK_OFFSET), np.float32)
        self._relative = np.asarray(work * self._weight, np.float32)
        self._sample = block_means(work)
        self._light_terms = np.concatenate([self._sample, self._sample**2])
        self._sample_weight = 1.0 / (self._sample + DARK_OFFSET)
        self._trusted = max(1, int(GAIN_TRUSTED * self._sample.shape[1]))

    @property
    def terms(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The factor of a frame's pixels, (h, w, 3), and the value subtracted then."""
        return self._weight, self._relative

    def reduce(self, image: Image) -> Image:
        """Return the reduced copy, (h, w, 3) uint8."""
        # OpenCV has a fast path for halving, which is several times faster than other reductions.
        while min(image.shape[0] / self.size[1], image.shape[1] / self.size[0]) >= 2.0 and _even(image):
            half = (image.shape[1] // 2, image.shape[0] // 2)
            image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
        if image.shape[1::-1] == self.size:
            return image
        slight = max(image.shape[0] / self.size[1], image.shape[1] / self.size[0]) < SLIGHTLY
        how = cv2.INTER_LINEAR if slight else cv2.INTER_AREA
        return np.asarray(cv2.resize(image, self.size, interpolation=how), np.uint8)

    def of(self, work: Image, light: Light | None = None) -> NDArray[np.float32]:
        """Return the relative difference of a reduced copy from the background, (h, w, 3) float32.

        light: gain and offset of the frame from `light_of`, also of a copy of another size; None to fit them.
        """
        gain, offset = light or self.light_of(work)
        # OpenCV takes an array of four values as a scalar per channel.
        lit = cv2.multiply(work, np.append(1.0 / gain, 1.0), dtype=cv2.CV_32F)
        lit = cv2.subtract(lit, np.append(offset / gain, 0.0), dtype=cv2.CV_32F)
        difference = np.asarray(cv2.subtract(cv2.multiply(lit, self._weight), self._relative), np.float32)
        np.maximum(difference, np.float32(0.0), out=difference, where=work >= SATURATED)
        return difference

    def light_of(self, work: Image) -> Light:
        """Return gain and offset per channel of a reduced copy against the background's light."""
        seen = block_means(work)
        seen_terms = np.concatenate([seen, seen * self._sample])
        gain = upper_median(((seen + 1.0) / (self._sample + 1.0)).T)
        offset = np.zeros(CHANNELS)
        for _ in range(GAIN_ROUNDS):
            misfit = np.abs(seen - gain[:, None] * self._sample - offset[:, None]) * self._sample_weight
            best = np.argpartition(misfit[0] + misfit[1] + misfit[2], self._trusted - 1)[: self._trusted]
            share = np.zeros(seen.shape[1])
            share[best] = 1.0 / self._trusted
            gain, offset = _line(self._light_terms @ share, seen_terms @ share)
        return np.maximum(gain, DARKEST_GAIN), offset


def _even(image: Image) -> bool:
    return image.shape[0] % 2 == 0 and image.shape[1] % 2 == 0


def smooth(difference: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a relative difference (h, w, 3) of the reduced copy without the noise of single pixels."""
    side = (NOISE_BLUR_SIDE, NOISE_BLUR_SIDE)
    return np.asarray(cv2.GaussianBlur(difference, side, NOISE_BLUR_PX), np.float32)


def block_means(work: NDArray[Any]) -> NDArray[np.float64]:
    """Return the means of blocks of pixels, (3, N)."""
    size = (max(work.shape[1] // GAIN_BLOCK_PX, 1), max(work.shape[0] // GAIN_BLOCK_PX, 1))
    blocks = cv2.resize(work.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.asarray(blocks).reshape(-1, 3).T, np.float64)


def _line(light: NDArray[np.float64], seen: NDArray[np.float64]) -> tuple[Any, Any]:
    """Fit seen = gain * light + offset per channel; the ridge term favours an offset of zero.

    light: (6,), means of the background's blocks and of their squares, per channel. seen: (6,), means of the
    frame's blocks and of their products with the background's, per channel.
    """
    mean_light, mean_seen = light[:CHANNELS], seen[:CHANNELS]
    pull = OFFSET_RIDGE * mean_light
    together = seen[CHANNELS:] + (pull - mean_light) * mean_seen + NEGLIGIBLE
    gain = together / (light[CHANNELS:] + (pull - mean_light) * mean_light + NEGLIGIBLE)
    return gain, mean_seen - gain * mean_light


def full_area(area_px: float, work: tuple[int, ...], frame: tuple[int, ...]) -> float:
    """Convert an area from pixels of a reduced copy (h, w) to pixels of the frame (H, W)."""
    full = float(frame[0] * frame[1])
    return min(area_px * (frame[1] / work[1] * (frame[0] / work[0])), full)


def upper_median(values: NDArray[Any]) -> NDArray[Any]:
    """Return the upper median of each column of (N, K); several times faster than np.median."""
    middle = len(values) // 2
    return np.partition(values, middle, axis=0)[middle]


def work_size(shape: tuple[int, ...], aspect: float) -> tuple[int, int]:
    """Return width and height of the reduced copy in px, such that its pixels are nearly square on the gel.

    shape: of the frame, (H, W, ...). aspect: width of a frame pixel on the gel divided by its height.
    """
    height, width = shape[:2]
    wanted = width * aspect / height
    longest = min(WORK_LONG_SIDE_PX, max(height, width))
    heights = range(max(8, int(0.9 * longest * min(1.0, 1.0 / wanted))), longest + 1)

    def misfit(rows: int) -> float:
        columns = round(rows * wanted)
        return abs(columns / rows / wanted - 1.0) + 0.0005 * (longest - max(rows, columns))

    best = min((h for h in heights if 8 <= round(h * wanted) <= longest), key=misfit, default=longest)
    return round(best * wanted), best
