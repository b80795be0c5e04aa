"""The fine texture of a contact: strength and direction of its lines, edges and marks.

The bulge of the gel under an object is broad, does not rotate, and gets its colours from the LEDs. The lines
and marks of the object are fine and rotate with it. The fine structure of a frame is its relative difference
minus the local mean. The structure tensor, summed over the colours, gives strength and direction of the
change, independent of the colours of the LEDs and of the sign of the change (Bigun and Granlund, ICCV 1987).
The strength is invariant under rotation. The direction is a complex number with twice the angle; a rotation
by d multiplies it by exp(-2 i d).
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.channel import Channel
from rig.tactile.slip.compiled import compiled
from rig.tactile.slip.height import Field

# Pixels per work pixel, if the resolution of the sensor allows it.
FINENESS = 2
# Standard deviations in pixels of that resolution: the fine structure is the difference to a blur by FINE_PX;
# noise is reduced by NOISE_PX; the structure tensor is averaged over NEIGHBOURS_PX.
FINE_PX, NOISE_PX, NEIGHBOURS_PX = 4.0, 1.0, 0.8
# Changes below this multiple of the image's median are noise. The strength of larger ones is their root, so
# that one edge does not outweigh all lines.
NOISE_MEDIANS = 1.8
# Width of the border that blurs affect; the structure there does not rotate.
MARGIN_PX = 10
# Number of the strongest points that describe a texture, and their reach around the contact, work pixels.
MOST_POINTS, FEWEST_POINTS, REACH_PX = 600, 30, 6


class TextureField:
    """The texture of a frame.

    difference: (h, w, 3), relative, with `scale` pixels per work pixel. counts: (h, w), weight of the texture
    of each pixel (`rig.tactile.slip.turning`), None for equal weights. planes: (h, w, 3) float32, real and
    imaginary part of the direction, and strength.
    """

    def __init__(self, difference: Field, scale: int, counts: Field | None = None) -> None:
        self.scale, self.counts = scale, counts
        self.planes = structure(difference, scale / FINENESS)
        if counts is not None:
            self.planes *= counts[..., None]

    @property
    def middle_px(self) -> complex:
        """Position of the middle of the first work pixel in the pixels of this field."""
        return (self.scale - 1) / 2.0 * (1 + 1j)


def fine_scale(shape: tuple[int, ...], size: tuple[int, int]) -> int:
    """Return the number of pixels per work pixel. size: width and height of the work copy."""
    return max(1, min(FINENESS, shape[1] // size[0], shape[0] // size[1]))


@dataclass(frozen=True, slots=True, eq=False)
class TextureKey:
    """The texture of a contact to which later frames are aligned.

    points_px: (N,) complex64, work pixels from the keyframe's center. template: (3, N), see `TextureField`,
    times `unit`, which makes its energy 1. squares: (N,), its squared lengths. jacobian: (3, 3, N) for
    rotation (rad), x and y (work pixels). counts, scale: those of its `TextureField`.
    """

    points_px: NDArray[np.complex64]
    template: NDArray[np.float32]
    unit: float
    squares: NDArray[np.float32]
    jacobian: NDArray[np.float32]
    counts: Field | None = None
    scale: int = 1

    def turning_at(self, places_px: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the weight of the slopes at places (N,) of the keyframe's image, in work pixels.

        It is the square of the weight of the texture there, so it is low where the texture rests.
        """
        if self.counts is None:
            return np.ones(len(places_px), np.float32)
        rows = (places_px.imag * self.scale).astype(np.intp)
        columns = (places_px.real * self.scale).astype(np.intp)
        return np.square(self.counts[rows, columns])

    def counted_from(self, moved_px: complex) -> "TextureKey":
        """Return this texture with its points relative to a center moved by some work pixels."""
        jacobian = self.jacobian.copy()
        # A rotation about another point equals a rotation about this point and a shift.
        jacobian[0] += moved_px.real * jacobian[2] - moved_px.imag * jacobian[1]
        points = self.points_px - np.complex64(moved_px)
        return replace(self, points_px=points, jacobian=jacobian)

    def within(self, field: TextureField, center_px: complex) -> Channel:
        """Return this texture together with a frame to align."""
        return Channel(
            field.planes,
            self.points_px,
            center_px,
            self.template,
            self.squares,
            self.jacobian,
            turns=2.0,
            unit=self.unit,
            scale=float(field.scale),
            middle=field.middle_px,
        )


def make_texture_key(field: TextureField, mask: Image, center_px: complex) -> TextureKey | None:
    """Select the strongest points in and around a contact, mask (h, w); return None if there are too few."""
    chosen = _strongest(field.planes, mask)
    if len(chosen) < FEWEST_POINTS:
        return None
    rows, columns = np.unravel_index(chosen, field.planes.shape[:2])
    places = columns + 1j * rows - (field.scale - 1) / 2.0 * (1 + 1j)
    points = (places / field.scale - center_px).astype(np.complex64)
    plain = field.planes[rows, columns].T
    unit = 1.0 / math.sqrt(float((plain * plain).sum()))
    template = np.ascontiguousarray(plain * np.float32(unit))
    along_x, along_y = (
        np.asarray(cv2.Scharr(field.planes, cv2.CV_32F, *axis, scale=unit * field.scale / 32))[
            rows, columns
        ].T
        for axis in ((1, 0), (0, 1))
    )
    # A small rotation by d moves a point z to z - i d z, and multiplies a direction by exp(-2 i d).
    turned = along_y * points.real - along_x * points.imag
    turned[0] += 2.0 * template[1]
    turned[1] -= 2.0 * template[0]
    jacobian = np.ascontiguousarray(np.stack([turned, -along_x, -along_y]), np.float32)
    squares = (template * template).sum(0)
    return TextureKey(points, template, unit, squares, jacobian, field.counts, field.scale)


def richness(field: TextureField, mask: Image) -> float:
    """Return the root energy of the strongest points in and around a contact, mask (h, w)."""
    strongest = field.planes.reshape(-1, 3)[_strongest(field.planes, mask)]
    return float(np.sqrt(np.square(strongest).sum()))


def structure(difference: Field, scale: float) -> Field:
    """Return direction and strength (h, w, 3) of the fine structure of a relative difference (h, w, 3).

    scale: factor for the widths above.
    """
    fine = cv2.subtract(difference, _broad(difference, FINE_PX * scale))
    fine = cv2.GaussianBlur(fine, (0, 0), NOISE_PX * scale)
    along_x, along_y = (
        np.asarray(cv2.Scharr(fine, cv2.CV_32F, *axis, scale=1 / 32), np.float32) for axis in ((1, 0), (0, 1))
    )
    tensor = cv2.GaussianBlur(summed_tensor(along_x, along_y), (0, 0), NEIGHBOURS_PX * scale)
    tensor = np.asarray(tensor, np.float32)
    changes = np.sqrt(np.maximum(tensor[..., 2], np.float32(1e-12)))
    least = float(NOISE_MEDIANS * np.median(changes))
    return beyond_noise(tensor, changes, least, round(MARGIN_PX * scale))


@compiled
def summed_tensor(along_x: Field, along_y: Field) -> Field:
    """Return the structure tensor, its three parts, summed over the colours of two gradients (h, w, 3)."""
    parts = np.empty_like(along_x)
    for row in range(parts.shape[0]):
        for column in range(parts.shape[1]):
            xx, yy, xy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(3):
                x, y = along_x[row, column, k], along_y[row, column, k]
                xx, yy, xy = xx + x * x, yy + y * y, xy + x * y
            parts[row, column, 0], parts[row, column, 1] = xx - yy, xy + xy
            parts[row, column, 2] = xx + yy
    return parts


@compiled
def beyond_noise(tensor: Field, changes: Field, least: float, margin: int) -> Field:
    """Return direction and strength (h, w, 3); 0 where changes (h, w) are not larger than the smallest."""
    planes = np.zeros_like(tensor)
    for row in range(margin, planes.shape[0] - margin):
        for column in range(margin, planes.shape[1] - margin):
            strength = changes[row, column] - least
            if strength > 0.0:
                share = math.sqrt(strength * math.sqrt(strength)) / changes[row, column] ** 2
                for k in range(3):
                    planes[row, column, k] = tensor[row, column, k] * share
    return planes


def _strongest(planes: Field, mask: Image) -> NDArray[np.intp]:
    """Return the indices of the strongest pixels in and around a contact, row by row."""
    reach = cv2.dilate(mask, np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), np.uint8))
    height, width = planes.shape[:2]
    strength = planes[..., 2] * cv2.resize(reach, (width, height), interpolation=cv2.INTER_NEAREST)
    strength = strength.reshape(-1)
    present = np.flatnonzero(strength)
    least = max(0, len(present) - MOST_POINTS)
    # Only of non-zero pixels, because a partition of many equal numbers takes twenty times as long.
    return present[np.argpartition(strength[present], least)[least:]] if least else present


def _broad(difference: Field, sigma_px: float) -> Field:
    """Return a strongly blurred image. At a quarter of the size the blur takes a sixth of the time."""
    height, width = difference.shape[:2]
    small = cv2.resize(difference, (-(-width // 4), -(-height // 4)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma_px / 4.0)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
