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
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from drivers.types import Image
from rig.tactile.contact.relative import upper_median
from rig.tactile.slip.height import Box, Field, Gradient, padded, window, within

# Highest spatial frequency that is used, cycles per work pixel; above it there is more noise than shape.
HIGHEST_FREQUENCY = 0.25
# Fewest pixels around the contact from which the drift of the light is computed.
FEWEST_AROUND = 30
# Ridge on the constant and on the varying part of the map, in units of the curl's scale.
RIDGE_CONSTANT, RIDGE_VARYING = 1e-3, 3e-3
# Ridge on the gradient of a grey change, which is equal in all channels.
RIDGE_GREY = 0.03
CHANNELS = 3
# 1, x and y times each channel.
FEATURES = 3 * CHANNELS


@dataclass(frozen=True, slots=True, eq=False)
class LearntGradientMap:
    """A colour-to-gradient map that varies linearly over the sensor.

    planes: (3, h, w) complex64; the gradient is the sum over the channels of planes times the
    relative difference.
    """

    planes: NDArray[np.complex64]

    def apply(self, difference: Field, box: Box | None = None) -> Gradient:
        """Return the gradient (h, w) of a relative difference (h, w, 3); its scale is arbitrary.

        box: the gradient is computed only there, and is 0 elsewhere.
        """
        gradient = np.zeros(difference.shape[:2], np.complex64)
        inside = within(box, gradient.shape)
        red, green, blue = self.planes[:, *inside]
        seen = difference[inside]
        gradient[inside] = red * seen[..., 0] + green * seen[..., 1] + blue * seen[..., 2]
        return gradient


def learn_map(difference: Field, mask: Image) -> LearntGradientMap | None:
    """Learn the map from one contact; return None if the image contains no dent.

    difference: (h, w, 3) float32. mask: (h, w) uint8, 1 in the contact.
    """
    features = _features(_dent(difference, mask))
    curl, volume = _curl_form(features), _volume_form(features, mask)
    diagonal = np.diag(curl)
    scale = float(diagonal[:CHANNELS].sum() + diagonal[FEATURES : FEATURES + CHANNELS].sum())
    if not scale > 0.0:
        return None
    weights = np.linalg.solve(curl + _RIDGE * (scale / CHANNELS), volume)
    if not float(volume @ weights) > 0.0:
        return None
    coefficients = weights.reshape(2, 3, CHANNELS)
    coefficients /= np.linalg.norm(coefficients[:, 0])
    across, down = _coordinates(mask.shape)
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


def _features(dent: Field) -> Field:
    """Return the channels, and the channels times x and times y, (F, h, w)."""
    across, down = _coordinates(dent.shape)
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
    spread = padded(features, 0.25)
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
    kx = kx[:, : np.searchsorted(kx[0], HIGHEST_FREQUENCY)]
    length = np.hypot(kx, ky)
    used = (length > 0.0) & (length < HIGHEST_FREQUENCY)
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
