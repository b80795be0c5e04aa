"""Decide whether the rotation of a round contact is observable, or its pattern an artefact of the map.

A smooth ball looks the same at every angle. But the map from colours to slopes is linear and a sensor is not,
so that a steep ball seems to have a pattern, which does not rotate with the ball. The size of this artefact
is visible in the field: a wrong map causes curl, but slopes of a height have none.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from drivers.types import Image
from rig.tactile.slip.gradient import HIGHEST_FREQUENCY
from rig.tactile.slip.height import Field, Gradient, padded, window
from rig.tactile.slip.parameters import SHAPE

RINGS = 12
# A contact is round if a smaller fraction of its energy is not rotationally symmetric: an oval with an axis
# ratio of 1.3 has 0.1, a smooth ball up to 0.12, most real contacts of other shapes 0.4 and more.
NOT_ROUND = 0.15
# Simulated smooth balls of 3 to 25 mm radius have a trace of 4.4 to 7.7, weak grain on them 6 to 18, ovals 40
# and more.
LEAST_TRACE = 8.0
# A map that errs makes a steep ball look unround. 31 real presses of a smooth ball of 8.8 mm have contrasts
# (see `Keyframe`) up to 2.2, traces up to 4.8 and 770 to 1,160 work pixels; first keyframes of labelled real
# clips have contrasts above 6. Wider contacts are less steep. Simulated contacts that still grow have 150 to
# 430 px, and get another keyframe when they have settled.
LEAST_SURE_CONTRAST, STEEP_PX = 3.0, range(500, 1500)


def trace_of_a_turn(
    points: NDArray[np.complex64], template: NDArray[np.float32], gradient: Gradient, mask: Image
) -> float:
    """Return the ratio of the asymmetric fraction of a round contact to its curl; inf for other contacts.

    points: (N,) from the contact's middle. template: (2, N), the sharpened slopes there. gradient: (h, w) of
    the frame. mask: (h, w) uint8, 1 in the contact.
    """
    unround = unround_share(points, template)
    return math.inf if unround >= NOT_ROUND else unround / max(curl_share(gradient, mask), 1e-9)


def like_a_ball(
    points: NDArray[np.complex64],
    template: NDArray[np.float32],
    gradient: Gradient,
    mask: Image,
    contrast: float,
) -> bool:
    """Return whether all that is unround about a new contact may come from errors of the map.

    contrast: see `Keyframe`. The other arguments are those of `trace_of_a_turn`.
    """
    if contrast >= LEAST_SURE_CONTRAST or np.count_nonzero(mask) not in STEEP_PX:
        return False
    return unround_share(points, template) < LEAST_TRACE * curl_share(gradient, mask)


def missed_rad(trace: float) -> float:
    """Return the standard deviation of a rotation that is missed completely or in part."""
    return SHAPE.missed_rad * (SHAPE.missed_trace / trace) ** SHAPE.missed_power


def unround_share(points: NDArray[np.complex64], template: NDArray[np.float32]) -> float:
    """Return the fraction of the energy of slopes (2, N) that varies on the rings around the middle."""
    slopes, distance = template[0] + 1j * template[1], np.abs(points)
    from_middle = slopes * points.conj() / np.maximum(distance, 1e-6)
    ring = (distance / max(float(distance.max()), 1e-6) * (RINGS - 0.5)).astype(int)
    many = np.maximum(np.bincount(ring, minlength=RINGS), 1)
    means = [np.bincount(ring, part, RINGS) / many for part in (from_middle.real, from_middle.imag)]
    rest = from_middle - (means[0] + 1j * means[1])[ring]
    return float((np.abs(rest) ** 2).sum() / max(float((np.abs(slopes) ** 2).sum()), 1e-20))


def curl_share(gradient: Gradient, mask: Image) -> float:
    """Return the fraction of curl in the energy of a field of slopes (h, w) around a contact, 0 to 1."""
    field = gradient * window(mask)
    spread = padded(np.stack([field.real, field.imag]), 1.0)
    along_x, along_y = np.asarray(fft.rfft2(spread), np.complex64)
    unit_x, unit_y, used = _directions(spread.shape[1], spread.shape[2])
    curl, whole = unit_x * along_y - unit_y * along_x, used * (_squares(along_x) + _squares(along_y))
    return float(_squares(curl).sum() / max(float(whole.sum()), 1e-20))


@lru_cache(maxsize=8)
def _directions(height: int, width: int) -> tuple[Field, Field, Field]:
    """Return the direction of each frequency of a real transform, x and y, and which are used, 0 or 1."""
    ky, kx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    length = np.hypot(kx, ky)
    used = (length > 0.0) & (length < HIGHEST_FREQUENCY)
    per_length = used / np.where(used, length, 1.0)
    unit_x, unit_y, shares = kx * per_length, ky * per_length, used.astype(np.float32)
    return unit_x.astype(np.float32), unit_y.astype(np.float32), shares


def _squares(values: Gradient) -> Field:
    return np.asarray(values.real**2 + values.imag**2, np.float32)
