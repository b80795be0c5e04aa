"""The fine texture of a contact: strength and direction of its lines, edges and marks.

The bulge of the gel under an object is broad, does not rotate, and gets its colours from the LEDs. The lines
and marks of the object are fine and rotate with it. The fine structure of a frame is its relative difference
minus the local mean. The structure tensor, summed over the colours, gives strength and direction of the
change, independent of the colours of the LEDs and of the sign of the change (Bigun and Granlund, ICCV 1987).
The strength is invariant under rotation. The direction is a complex number with twice the angle; a rotation
by d multiplies it by exp(-2 i d).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.height import Field
from rig.tactile.slip.loops import FIRST, SQUARE, WEIGHT
from rig.tactile.slip.pixels import beyond_noise, strongest_energy, summed_tensor

# Pixels per work pixel, if the resolution of the sensor allows it.
FINENESS = 2
# Standard deviations in pixels of that resolution: the fine structure is the difference to a blur by FINE_PX;
# noise is reduced by NOISE_PX; the structure tensor is averaged over NEIGHBOURS_PX.
FINE_PX, NOISE_PX, NEIGHBOURS_PX, BLUR_SIDE = 4.0, 1.0, 0.8, 5
# Changes below this multiple of the image's median are noise. The strength of larger ones is their power 3/4,
# so that one edge does not outweigh all lines.
NOISE_MEDIANS, MEDIAN_STEP = 1.8, 3
# Width of the border that blurs affect, of the image and of a part of it; the structure there is 0.
MARGIN_PX, PART_MARGIN_PX = 10, 4
# Number of the strongest points that describe a texture, and their reach around the contact, work pixels.
STRONGEST, FEWEST_POINTS, REACH_PX = 600, 30, 6
# Margin of the box of a texture around the contact, work pixels.
BOX_PX = REACH_PX + 3
_REACH = np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """The texture in a box.

    planes: (3, h, w), from (left, top), with `scale` pixels per work pixel. counts: (h, w), weights of the
    network. heavy: whether this frame has run the network or computed the noise floor.
    """

    planes: Field
    counts: Field
    left: int
    top: int
    scale: int
    heavy: bool = False

    @property
    def view(self) -> tuple[float, float, float]:
        """Pixels of planes per work pixel, and the offset in x and y."""
        middle = (self.scale - 1) / 2.0
        return float(self.scale), middle - self.left, middle - self.top

    def is_richer(self, than: float, mask: Image) -> bool:
        """Whether the richness exceeds a value; that of all texture in the box is computed faster."""
        return cv2.norm(self.planes.reshape(-1)) > than and self.richness(mask) > than

    def richness(self, mask: Image) -> float:
        """Return the root energy of the strongest texture in and around a contact."""
        reach = np.asarray(cv2.dilate(mask, _REACH), np.uint8)
        left, top = self.left // self.scale, self.top // self.scale
        return strongest_energy(self.planes, reach, self.scale, top, left, STRONGEST)


def fine_scale(shape: tuple[int, ...], size: tuple[int, int]) -> int:
    """Return the number of pixels per work pixel. size: width and height of the work copy."""
    return max(1, min(FINENESS, shape[1] // size[0], shape[0] // size[1]))


def strongest(
    texture: Texture, mask: Image, rows: Field, center_px: complex, spread: Callable[[int], NDArray[np.intp]]
) -> tuple[int, float] | None:
    """Fill the rows of a keyframe with the strongest texture in and around a contact, mask (h, w).

    Return number of points and unit; None if there is too little. spread: which of many points are used.
    """
    planes, scale = texture.planes, texture.scale
    chosen = _strongest(texture, mask)
    if len(chosen) < FEWEST_POINTS * (scale / FINENESS) ** 2:
        return None
    chosen = chosen[spread(len(chosen))]
    at = np.unravel_index(chosen, planes.shape[1:])
    _, right, down = texture.view
    x, y = (at[1] - right) / scale - center_px.real, (at[0] - down) / scale - center_px.imag
    plain, count = planes[:, *at], len(chosen)
    unit = 1.0 / math.sqrt(float((plain * plain).sum()))
    template = plain * np.float32(unit)
    along_x, along_y = along_both(planes, at, unit * scale)
    rows[0, :count], rows[1, :count], rows[SQUARE, :count] = x, y, (template * template).sum(0)
    rows[WEIGHT, :count] = 0.5
    rows[FIRST : FIRST + 3, :count] = template
    jacobian = rows[FIRST + 3 : FIRST + 12].reshape(3, 3, -1)[..., :count]
    # A small rotation by d moves a point z to z - i d z, and multiplies a direction by exp(-2 i d).
    jacobian[0] = along_y * x - along_x * y
    jacobian[0, 0] += 2.0 * template[1]
    jacobian[0, 1] -= 2.0 * template[0]
    jacobian[1], jacobian[2] = -along_x, -along_y
    return count, unit


def along_both(planes: Field, pixels: tuple[NDArray[np.intp], ...], scale: float) -> tuple[Field, Field]:
    """Return the change of planes (C, h, w) along x and y at pixels, (C, N)."""
    stacked = planes.reshape(-1, planes.shape[2])
    along_x, along_y = (
        np.asarray(cv2.Scharr(stacked, cv2.CV_32F, *axis, scale=scale / 32), np.float32)
        for axis in ((1, 0), (0, 1))
    )
    return along_x.reshape(planes.shape)[:, *pixels], along_y.reshape(planes.shape)[:, *pixels]


def tensor_of(difference: Field, clean: Field, scale: int) -> Field:
    """Return the structure tensor (3, h, w) of a relative difference (3, h, w).

    clean: the same part with one pixel per work pixel, (h, w, 3); its blur is the broad part.
    """
    count, height, width = difference.shape
    broad = cv2.GaussianBlur(clean, (9, 9), FINE_PX / FINENESS)
    small = np.ascontiguousarray(broad.transpose(2, 0, 1)).reshape(-1, clean.shape[1])
    wide = small if scale == 1 else cv2.resize(small, (width, count * height), interpolation=cv2.INTER_LINEAR)
    fine = cv2.subtract(difference.reshape(-1, width), wide)
    side = (BLUR_SIDE, BLUR_SIDE)
    fine = np.asarray(cv2.GaussianBlur(fine, side, NOISE_PX * scale / FINENESS, dst=fine), np.float32)
    parts = np.empty_like(difference)
    summed_tensor(fine.reshape(difference.shape), parts)
    flat = parts.reshape(-1, width)
    cv2.GaussianBlur(flat, side, NEIGHBOURS_PX * scale / FINENESS, dst=flat)
    return parts


def noise_floor(tensor: Field) -> float:
    """Return the change below which all is noise, from the tensor of a whole image."""
    squares = tensor[2, ::MEDIAN_STEP, ::MEDIAN_STEP].ravel()
    return NOISE_MEDIANS * math.sqrt(
        max(float(np.partition(squares, squares.size // 2)[squares.size // 2]), 1e-12)
    )


def structure(tensor: Field, floor: float, counts: Field, around: tuple[int, ...], scale: int) -> Texture:
    """Return direction and strength of a tensor, times the counts (h, w) of its pixels.

    around: distances from the sides of the image: left, top, right, bottom.
    """
    whole, part = round(MARGIN_PX * scale / FINENESS), round(PART_MARGIN_PX * scale / FINENESS)
    left, top, right, bottom = (max(part, whole - distance) for distance in around)
    planes = np.empty_like(tensor)
    beyond_noise(tensor, floor, (left, top, right, bottom), counts, planes)
    return Texture(planes, counts, around[0], around[1], scale)


def structure_of(difference: Field) -> Field:
    """Return direction and strength (h, w, 3) of a relative difference (h, w, 3).

    It has `FINENESS` pixels per work pixel.
    """
    height, width = difference.shape[:2]
    size = (width // FINENESS, height // FINENESS)
    clean = np.asarray(cv2.resize(difference, size, interpolation=cv2.INTER_AREA), np.float32)
    tensor = tensor_of(np.ascontiguousarray(difference.transpose(2, 0, 1)), clean, FINENESS)
    ones = np.ones((height, width), np.float32)
    return structure(tensor, noise_floor(tensor), ones, (0, 0, 0, 0), FINENESS).planes.transpose(1, 2, 0)


def _strongest(texture: Texture, mask: Image) -> NDArray[np.intp]:
    """Return the indices of the strongest pixels in and around a contact, row by row."""
    scale, (height, width) = texture.scale, texture.planes.shape[1:]
    left, top = texture.left // scale, texture.top // scale
    reach = cv2.dilate(mask, _REACH)[top : top + height // scale, left : left + width // scale]
    strength = texture.planes[2] * cv2.resize(reach, (width, height), interpolation=cv2.INTER_NEAREST)
    strength = strength.reshape(-1)
    present = np.flatnonzero(strength)
    least = max(0, len(present) - STRONGEST)
    # Only of non-zero pixels, because a partition of many equal numbers takes twenty times as long.
    return np.sort(present[np.argpartition(strength[present], least)[least:]]) if least else present
