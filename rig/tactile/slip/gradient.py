"""Compute the surface gradient of the gel from colours, by a map learnt from the contact itself.

A slope of the gel makes each colour brighter or darker, depending on its direction to the LED of that colour.
The relative difference of a frame is therefore approximately a linear map of the surface gradient. The map
changes slowly over the gel, because the LEDs are near. The map of an uncalibrated sensor is unknown, but two
facts determine it from a single image of a contact:

- the result is the gradient of a height, so its field has no curl;
- the height is zero outside the dent, so integration by parts gives the first moments of the field:
  `sum g_i x_j = -delta_ij V`, where V is the volume of the dent.

The selected map has the least curl at unit volume (energy of the solenoidal part in Fourier space, with equal
weight of all scales). A ridge keeps it constant if the contact has little information. No LED positions, no
assumed colours and no press of a known ball are needed. Its scale is arbitrary.

If the look of the sensor was calibrated with presses of a ball, nothing is learnt from the contact: see
`CalibratedSlopes`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from calibration.gel.look import GelLook, change_by_slope
from drivers.errors import CalibrationError
from drivers.types import Image
from rig.tactile.contact.relative import DARK_OFFSET, upper_median
from rig.tactile.slip.height import Box, Field, Gradient, pad, relief, window
from rig.tactile.slip.pixels import slopes_in

# Highest spatial frequency that is used, cycles per work pixel; above it there is more noise than shape.
HIGHEST_FREQUENCY = 0.25
# Fewest pixels around the contact from which the drift of the light is computed.
FEWEST_AROUND = 30
# Ridge on the constant and on the varying part of the map, in units of the curl's scale.
RIDGE_CONSTANT, RIDGE_VARYING = 1e-3, 3e-3
# Ridge on the gradient of a grey change, which is equal in all channels.
RIDGE_GREY = 0.03
# Slope (mm/mm) at which the colours of a calibrated look are taken as linear; standard deviation of the slope
# in one correction; number of corrections. Set on SIMULATED dents in the look of DIGIT D20641, of 0.01 to 0.1
# and of 1 to 5. With 5 corrections a tenth less of the slopes is unexplained.
LINEAR_SLOPE, SLOPE_SIGMA, CORRECTIONS = 0.02, 0.02, 3
# Further blur against noise, in work pixels. Without it the error of three SIMULATED lifts of a broad flat
# object (spam) in that look is 3.3 instead of 1.4 degrees.
SMOOTHING_PX = 1.4
# The map is learnt at this fraction of the size.
HALF = 2
CHANNELS = 3
# 1, x and y times each channel.
FEATURES = 3 * CHANNELS


@dataclass(frozen=True, eq=False)
class LearntGradientMap:
    """A colour-to-gradient map that varies linearly over the sensor.

    planes: (3, h, w) complex64; the gradient is the sum over the channels of planes times the
    relative difference.
    """

    planes: NDArray[np.complex64]

    def apply(self, difference: Field) -> Gradient:
        """Return the gradient (h, w) of a relative difference (h, w, 3); its scale is arbitrary."""
        red, green, blue = self.planes
        return red * difference[..., 0] + green * difference[..., 1] + blue * difference[..., 2]

    def slopes(self, difference: Field, box: Box) -> Field:
        """Return the slopes along x and y in a box, (h, w, 2); their scale is arbitrary."""
        slopes = np.empty((box[3], box[2], 2), np.float32)
        slopes_in(difference, self._colours, box[1], box[0], slopes)
        return slopes

    def reduce(self, size: tuple[int, int]) -> "LearntGradientMap":
        """Return the map for smaller images, of a width and height; every Nth pixel is kept."""
        down, across = self.planes.shape[1] // size[1], self.planes.shape[2] // size[0]
        return LearntGradientMap(self.planes[:, : down * size[1] : down, : across * size[0] : across])

    @cached_property
    def _colours(self) -> Field:
        return np.concatenate([self.planes.real, self.planes.imag])


Learn = Callable[[Field, Image], LearntGradientMap | None]
"""Returns the map for a relative difference (h, w, 3) and a contact mask (h, w); None without a dent."""


class CalibratedSlopes:
    """Compute the slopes of a contact with the calibrated look of the sensor.

    The look renders the colours of a dent: they depend on slope and position, saturate, and lose light beside
    the dent. Slopes are estimated linearly from the colours and integrated to a depth, which is rendered. The
    colours that the rendering misses correct the slopes, several times. Integration removes the curl, so that
    places that show a slope help those that do not.

    look: with the size of `background`, (H, W, 3) uint8, a frame without contact. size: width and height of
    the work copy. Raises `CalibrationError` if the sizes differ.
    """

    def __init__(self, look: GelLook, background: Image, size: tuple[int, int]) -> None:
        if background.shape[:2] != look.shape:
            raise CalibrationError(
                f"the look of the gel is for images of {look.shape[::-1]} px, and the frames have "
                f"{background.shape[1::-1]}: calibrate the sensor at this size, or leave the look out"
            )
        work = cv2.resize(background, size, interpolation=cv2.INTER_AREA)
        # The look computes the geometry at half the size of its images.
        doubled = cv2.resize(background, (2 * size[0], 2 * size[1]), interpolation=cv2.INTER_AREA)
        self._look = look.with_background(np.asarray(doubled, np.float32))
        self._grey = np.asarray(work, np.float32) + np.float32(DARK_OFFSET)
        self._mm = tuple(2.0 * mm for mm in self._look.mm_per_px)
        response = change_by_slope(self._look, LINEAR_SLOPE) / LINEAR_SLOPE
        seen = np.einsum("hwci,cd->hwid", response, np.linalg.inv(look.noise.colours))
        across, down = np.moveaxis(
            np.linalg.solve(seen @ response + np.eye(2) / SLOPE_SIGMA**2, seen), (2, 3), (0, 1)
        )
        self._linear = LearntGradientMap((across + 1j * down).astype(np.complex64))
        ones = np.ones(work.shape[:2], np.complex64)
        self._map = LearntGradientMap(np.stack([ones, 1j * ones, 0 * ones]))

    def map(self, slopes: Field, mask: Image) -> LearntGradientMap:
        """Return the map from the result of `of` to a gradient, which is the same for all contacts."""
        return self._map

    def of(self, difference: Field, mask: Image) -> Field:
        """Return the slopes along x and y, mm/mm, and 0, (h, w, 3), of a relative difference (h, w, 3)."""
        reach = window(mask)[..., None]
        change = cv2.GaussianBlur(difference * self._grey, (0, 0), SMOOTHING_PX) * reach
        slopes = self._linear.apply(change)
        across, down = self._mm
        for _ in range(CORRECTIONS):
            per_pixel = (slopes.real * across + 1j * slopes.imag * down).astype(np.complex64)
            depth = np.maximum(relief(per_pixel, mask), np.float32(0.0))
            along_y, along_x = np.gradient(depth, down, across)
            missed = (change - self._look.change(depth)) * reach
            slopes = np.asarray(along_x + 1j * along_y + self._linear.apply(missed), np.complex64)
        return np.dstack([slopes.real, slopes.imag, np.zeros_like(slopes.real)]).astype(np.float32)


def learn_map(difference: Field, mask: Image) -> LearntGradientMap | None:
    """Learn the map from one contact; return None if the image contains no dent.

    difference: (h, w, 3) float32. mask: (h, w) uint8, 1 in the contact.
    """
    # At half the size there are all frequencies that are used.
    size = (max(1, mask.shape[1] // HALF), max(1, mask.shape[0] // HALF))
    across, down = _coordinates(mask.shape)
    parts = (
        np.asarray(cv2.resize(field, to, interpolation=cv2.INTER_AREA), np.float32)
        for field, to in ((_dent(difference, mask), size), (across, (size[0], 1)), (down, (1, size[1])))
    )
    features = _features(*parts)
    curl = _curl_form(features)
    small = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    volume = _volume_form(features, small)
    diagonal = np.diag(curl)
    scale = float(diagonal[:CHANNELS].sum() + diagonal[FEATURES : FEATURES + CHANNELS].sum())
    if not scale > 0.0:
        return None
    weights = np.linalg.solve(curl + _RIDGE * (scale / CHANNELS), volume)
    if not float(volume @ weights) > 0.0:
        return None
    coefficients = weights.reshape(2, 3, CHANNELS)
    coefficients /= np.linalg.norm(coefficients[:, 0])
    turned = (coefficients[0] + 1j * coefficients[1]).astype(np.complex64)
    constant, along_x, along_y = turned[..., None, None]
    return LearntGradientMap(constant + along_x * across + along_y * down)


def _ridge() -> NDArray[np.float64]:
    """Return the ridge of both gradient components, (2F, 2F), in units of the curl's scale."""
    ridge = np.repeat([RIDGE_CONSTANT, RIDGE_VARYING, RIDGE_VARYING], CHANNELS)
    grey = RIDGE_GREY * np.kron(np.eye(3), np.ones((CHANNELS, CHANNELS)))
    return np.asarray(np.kron(np.eye(2), np.diag(ridge) + grey), np.float64)


_RIDGE = _ridge()


def _dent(difference: Field, mask: Image) -> Field:
    """Return the difference inside the dent, without the drift of the light, which is measured around it."""
    reach = window(mask)
    around = (reach > 0.5) & (cv2.dilate(mask, np.ones((7, 7), np.uint8)) == 0)
    drift = upper_median(difference[around]) if around.sum() > FEWEST_AROUND else np.float32(0.0)
    return (difference - drift) * reach[..., None]


def _features(dent: Field, across: Field, down: Field) -> Field:
    """Return the channels, and the channels times x and times y, (F, h, w)."""
    planes = [np.asarray(plane, np.float32) for plane in cv2.split(dent)]
    return np.stack([*planes, *(p * across for p in planes), *(p * down for p in planes)])


def _coordinates(shape: tuple[int, ...]) -> tuple[Field, Field]:
    """Return x as a row and y as a column, from -1 to 1 over the longer side."""
    half = max(shape[:2]) / 2.0
    across = (np.arange(shape[1]) - (shape[1] - 1) / 2.0) / half
    down = (np.arange(shape[0]) - (shape[0] - 1) / 2.0) / half
    return across.astype(np.float32)[None, :], down.astype(np.float32)[:, None]


def _curl_form(features: Field) -> NDArray[np.float64]:
    """Return the (2F, 2F) quadratic form of the solenoidal energy of `a.features, b.features`."""
    spread = pad(features, 0.25)
    used, along_x, along_y = _frequencies(spread.shape[1], spread.shape[2])
    rows = np.asarray(fft.rfft(spread))[..., : used.shape[1]]
    chosen = np.asarray(fft.fft(rows, axis=1, overwrite_x=True), np.complex64)[:, used]
    curl = np.concatenate([-chosen * along_y, chosen * along_x])
    parts = np.concatenate([curl.real, curl.imag], axis=1)
    return (parts @ parts.T).astype(np.float64)


@lru_cache(maxsize=8)
def _frequencies(height: int, width: int) -> tuple[NDArray[np.bool_], Field, Field]:
    """Return which frequencies of a real transform are used, (height, columns), and their x and y.

    Both are divided by the length of the frequency; columns beyond the highest used one are left out. Each
    half of the plane represents the other, except for the column of zero frequency.
    """
    ky, kx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    kx = kx[:, : np.searchsorted(kx[0], HALF * HIGHEST_FREQUENCY)]
    length = np.hypot(kx, ky)
    used = (length > 0.0) & (length < HALF * HIGHEST_FREQUENCY)
    weight = np.where(kx == 0.0, 1.0, math.sqrt(2.0)) / np.where(used, length, 1.0)
    return used, (kx * weight)[used].astype(np.float32), (ky * weight)[used].astype(np.float32)


def _volume_form(features: Field, mask: Image) -> NDArray[np.float64]:
    """Return the (2F,) linear form of twice the dent's volume, by its first moments."""
    moments = cv2.moments(mask, True)
    x = np.arange(mask.shape[1]) - moments["m10"] / moments["m00"]
    y = np.arange(mask.shape[0]) - moments["m01"] / moments["m00"]
    along_x = features.sum(axis=1, dtype=np.float64) @ x
    along_y = features.sum(axis=2, dtype=np.float64) @ y
    return -np.concatenate([along_x, along_y])
