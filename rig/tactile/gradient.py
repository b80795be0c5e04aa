"""From colours to the gel's surface gradient, by a map learnt from the contact itself.

A slope of the gel brightens or darkens each colour by how far it faces that colour's LED, so the
relative difference of a frame is about a linear map of the surface gradient, and the map changes
slowly over the gel because the LEDs are near. Nobody knows the map of a sensor that was never
calibrated, but two facts pin it down from a single picture of a contact:

- what is wanted is the gradient of a height, so its field has no curl;
- the height is zero outside the dent, so by parts the first moments of the field are
  `sum g_i x_j = -delta_ij V`, with V the volume of the dent.

The map is the one with least curl (all scales alike: the energy of the field's solenoidal part in
Fourier space) at unit volume, with a ridge that keeps it plain where the contact says little. It
needs no LED positions, no assumed colours and no press of a known ball. Its scale is arbitrary.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from drivers.types import Image

# The dent reaches beyond the contact: the gel slopes off over some mm around it.
SKIRT_PX = 11
WINDOW_BLUR_PX = 2.0
# Spatial frequencies used, cycles per work pixel: above, there is more noise than shape.
HIGHEST_FREQUENCY = 0.25
# Ridge on the constant and on the varying part of the map, in units of the curl's scale.
RIDGE_CONSTANT, RIDGE_VARYING = 1e-3, 1e-2
# Ridge on what the map makes of a grey change, the same in all channels.
RIDGE_GREY = 0.03
CHANNELS = 3
# 1, x and y times each channel.
FEATURES = 3 * CHANNELS

Field = NDArray[np.float32]
Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class GradientMap:
    """A colour-to-gradient map that varies linearly over the sensor.

    planes: (2, 3, h, w) float32; the gradient along x (right) and y (down) is the sum over the
    channels of planes times the relative difference.
    """

    planes: Field

    def apply(self, difference: Field, box: Box | None = None) -> Field:
        """Return the gradient (h, w, 2) of a relative difference (h, w, 3); its scale is arbitrary.

        box: x, y, width and height in px; only there it is worked out, elsewhere it is 0.
        """
        gradient = np.zeros((*difference.shape[:2], 2), np.float32)
        left, top, width, height = box or (0, 0, difference.shape[1], difference.shape[0])
        inside = np.s_[top : top + height, left : left + width]
        red, green, blue = cv2.split(difference[inside])
        for axis, planes in enumerate(self.planes[:, :, *inside]):
            gradient[*inside, axis] = planes[0] * red + planes[1] * green + planes[2] * blue
        return gradient


def learn_map(difference: Field, mask: Image) -> GradientMap | None:
    """Learn the map from one contact; None where the picture holds no dent to learn from.

    difference: (h, w, 3) float32. mask: (h, w) uint8, 1 in the contact.
    """
    dent = _windowed(difference, mask)
    across, down = _coordinates(dent.shape[:2])
    planes = [np.ascontiguousarray(plane) for plane in cv2.split(dent)]
    features = np.stack([*planes, *(p * across for p in planes), *(p * down for p in planes)])
    curl = _curl_form(features)
    volume = _volume_form(features, mask)
    scale = np.trace(curl[:CHANNELS, :CHANNELS]) + np.trace(
        curl[FEATURES : FEATURES + CHANNELS, FEATURES : FEATURES + CHANNELS]
    )
    ridge = np.full(FEATURES, RIDGE_VARYING)
    ridge[:CHANNELS] = RIDGE_CONSTANT
    if not scale > 0.0:
        return None
    penalty = np.diag(ridge) + RIDGE_GREY * np.kron(np.eye(3), np.ones((CHANNELS, CHANNELS)))
    weights = np.linalg.solve(curl + np.kron(np.eye(2), penalty) * scale / CHANNELS, volume)
    total = float(volume @ weights)
    if not total > 0.0:
        return None
    coefficients = (weights / total).reshape(2, 3, CHANNELS)
    basis = np.stack([np.ones_like(across + down), across + 0 * down, 0 * across + down])
    field = np.einsum("kbc,bhw->kchw", coefficients, basis)
    size = float(np.sqrt(np.mean(np.sum(field[:, :, field.shape[2] // 2, field.shape[3] // 2] ** 2))))
    return GradientMap((field / size).astype(np.float32))


def relief(gradient: Field, mask: Image) -> Field:
    """Integrate a gradient (h, w, 2) to a height (h, w) float32, zero on average outside the contact.

    mask: (h, w) uint8, 1 in the contact. The sign is that of a dent: positive inside.
    """
    field = gradient * _window(mask)[..., None]
    rows, columns = mask.shape
    padded = np.zeros((fft.next_fast_len(rows + rows // 2), fft.next_fast_len(columns + columns // 2), 2))
    padded[:rows, :columns] = field
    spectrum = fft.rfft2(padded.astype(np.float32), axes=(0, 1))
    ky = 2.0 * np.pi * np.fft.fftfreq(padded.shape[0])[:, None]
    kx = 2.0 * np.pi * np.fft.rfftfreq(padded.shape[1])[None]
    squares = kx * kx + ky * ky
    squares[0, 0] = 1.0
    height = fft.irfft2(-1j * (kx * spectrum[..., 0] + ky * spectrum[..., 1]) / squares, s=padded.shape[:2])
    height = np.asarray(height[:rows, :columns], np.float32)
    outside = mask == 0
    return height - (height[outside].mean() if outside.any() else height.min())


def _window(mask: Image) -> Field:
    reach = 2 * SKIRT_PX + 1
    grown = cv2.dilate(mask, np.ones((reach, reach), np.uint8)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grown, (0, 0), WINDOW_BLUR_PX), np.float32)


def _windowed(difference: Field, mask: Image) -> Field:
    """Take the dent out of the frame: what lies around it is the light's drift, not slope."""
    window = _window(mask)
    around = (window > 0.5) & (cv2.dilate(mask, np.ones((7, 7), np.uint8)) == 0)
    drift = np.median(difference[around], axis=0) if around.sum() > 30 else np.zeros(3)
    return (difference - drift.astype(np.float32)) * window[..., None]


def _coordinates(shape: tuple[int, ...]) -> tuple[Field, Field]:
    """Return x as a row and y as a column, from -1 to 1 over the longer side."""
    half = max(shape) / 2.0
    across = (np.arange(shape[1]) - (shape[1] - 1) / 2.0) / half
    down = (np.arange(shape[0]) - (shape[0] - 1) / 2.0) / half
    return across.astype(np.float32)[None, :], down.astype(np.float32)[:, None]


def _curl_form(features: Field) -> NDArray[np.float64]:
    """Return the (2F, 2F) quadratic form of the solenoidal energy of `a.features, b.features`."""
    count, rows, columns = features.shape
    padded = np.zeros(
        (count, fft.next_fast_len(rows + rows // 4), fft.next_fast_len(columns + columns // 4)), np.float32
    )
    padded[:, :rows, :columns] = features
    spectrum = fft.rfft2(padded)
    ky = np.fft.fftfreq(padded.shape[1])[:, None]
    kx = np.fft.rfftfreq(padded.shape[2])[None]
    length = np.hypot(kx, ky)
    used = (length > 0.0) & (length < HIGHEST_FREQUENCY)
    # Half of the plane stands for the other half, but for the column of zero frequency.
    weight = np.sqrt(np.where(kx == 0.0, 1.0, 2.0))[:, :].repeat(len(ky), 0)[used] / length[used]
    along_x, along_y = (np.broadcast_to(k, used.shape)[used] * weight for k in (kx, ky))
    chosen = spectrum[:, used]
    turned = np.concatenate([-chosen * along_y, chosen * along_x])
    parts = np.concatenate([turned.real, turned.imag], axis=1)
    return (parts @ parts.T).astype(np.float64)


def _volume_form(features: Field, mask: Image) -> NDArray[np.float64]:
    """Return the (2F,) linear form of twice the dent's volume, by its first moments."""
    moments = cv2.moments(mask, True)
    x = np.arange(mask.shape[1]) - moments["m10"] / moments["m00"]
    y = np.arange(mask.shape[0]) - moments["m01"] / moments["m00"]
    along_x = features.sum(axis=1, dtype=np.float64) @ x
    along_y = features.sum(axis=2, dtype=np.float64) @ y
    return -np.concatenate([along_x, along_y])
