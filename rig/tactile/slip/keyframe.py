"""A keyframe: the slopes, texture and curvature of a contact, to which later frames are aligned."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.gradient import LearntGradientMap
from rig.tactile.slip.height import Box, Field, contact_box, relief, within
from rig.tactile.slip.loops import (
    CURVED,
    FIRST,
    MOST_POINTS,
    PLAIN,
    ROWS,
    SLOPES,
    SQUARE,
    TEXTURE,
    WEIGHT,
    X,
    Y,
    self_loss,
)
from rig.tactile.slip.parameters import ALIGNMENT, SIGMA
from rig.tactile.slip.slopes import CURVATURE, slope_planes
from rig.tactile.slip.texture import Texture, along_both, strongest

# Keyframes use the part of the dent that is deeper than DEPTH_SHARE of this quantile of the depth: the gel
# around it does not depend on the object alone.
SHALLOWER_SHARE, DEPTH_SHARE = 0.95, 0.25
BORDER_PX, MIN_POINTS = 2, 24
# Every Nth pixel of the contact is used for its depth, because the relief is smooth.
COARSE = 2
# The points are in an order in which every one of these parts is a sample of all.
PARTS = 3
# A keyframe's own loss of agreement is that of a rotation by this.
PROBE_RAD = math.radians(10.0)
# A contact with a larger fraction at the border of the image is cut by it. Of smooth balls (SIMULATED), those
# that look oblong or textured have 5 % and more.
CUT_SHARE = 0.04
_AROUND = np.ones((3, 3), np.uint8)
_INNER = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A frame from which a keyframe is made.

    difference: (h, w, 3), relative, or slopes of `CalibratedSlopes`. mask: (h, w) uint8, 1 in the contact.
    """

    difference: Field
    mask: Image
    texture: Texture

    def turning_at(self, pixels: Pixels) -> NDArray[np.float32]:
        """Return the weight of the slopes at rows and columns."""
        rows, columns = (self.texture.scale * at for at in pixels)
        counts = self.texture.counts[rows - self.texture.top, columns - self.texture.left]
        return np.minimum(counts ** np.float32(ALIGNMENT.count_power), np.float32(ALIGNMENT.most_prior))


@dataclass(frozen=True, eq=False)
class Keyframe:
    """The points of a frame to which others are aligned; its pose depends on the reading.

    rows: (3, ROWS, N), see `rig.tactile.slip.loops`; counted: number of points of each. center_px: of the
    points of the slopes. pixels: their rows and columns. unit: factor of the texture. richness: root energy
    of the texture. own: see `self_loss`, for a rotation by `PROBE_RAD`.
    distinct, textured: fraction of the energy of slopes and of texture that this rotation changes. oblong:
    relative difference of the dent's curvatures along its axes, 0 for a ball, 1 for a cylinder. border:
    fraction of the contact at the border of the image, which may cut it.
    """

    source: Source
    rows: Field
    counted: tuple[int, int, int]
    center_px: complex
    pixels: Pixels
    unit: float
    richness: float
    own: float = 0.0
    distinct: float = 0.0
    textured: float = 0.0
    oblong: float = 0.0
    border: float = 0.0

    @cached_property
    def area_px(self) -> int:
        """Area of the contact, work pixels."""
        return int(np.count_nonzero(self.source.mask))

    @property
    def observable(self) -> bool:
        """Whether a rotation changes this keyframe enough to be seen: smooth balls look the same.

        A ball that the border of the image cuts looks less round, so its limits are higher.
        """
        if self.oblong >= (SIGMA.cut_oblong if self.border > 0.0 else SIGMA.least_oblong):
            return True
        if self.border > CUT_SHARE:
            return self.distinct >= SIGMA.cut_distinct
        lined = self.textured >= SIGMA.least_textured and self.oblong >= SIGMA.textured_oblong
        return lined or self.distinct >= SIGMA.least_distinct

    def facts(self, share: float) -> NDArray[np.float64]:
        """Return the facts for the alignment, without a pose; share: weight among the keyframes."""
        place = share, self.center_px.real, self.center_px.imag, 0.0, 0.0, 0.0
        return np.array([*place, *self.counted, self.unit, self.own], np.float64)

    def with_map(self, learnt: LearntGradientMap) -> "Keyframe":
        """Return this keyframe with slopes of another colour map."""
        rows = self.rows.copy()
        planes, box = _fill_slopes(rows[SLOPES], self.source, learnt, self.pixels, self.center_px)
        return _with_curvature(replace(self, rows=rows), planes, box)


def make_keyframe(source: Source, learnt: LearntGradientMap) -> Keyframe | None:
    """Make a keyframe; return None if the contact has too little structure."""
    at_rows, at_columns = np.nonzero(_contact_proper(source, learnt))
    if len(at_rows) < MIN_POINTS:
        return None
    chosen = _spread(len(at_rows))
    pixels = at_rows[chosen], at_columns[chosen]
    center = complex(pixels[1].mean(), pixels[0].mean())
    rows = np.zeros((3, ROWS, MOST_POINTS), np.float32)
    found = strongest(source.texture, source.mask, rows[TEXTURE], center, _spread)
    if found is None:
        return None
    planes, box = _fill_slopes(rows[SLOPES], source, learnt, pixels, center)
    if not float(rows[SLOPES, SQUARE].sum()) > 0.0:
        return None
    counted, rich = (len(pixels[0]), found[0], 0), source.texture.richness(source.mask)
    textured = _information(rows[TEXTURE], found[0], FIRST + 3, (3, 3))
    key = Keyframe(source, rows, counted, center, pixels, found[1], rich, textured=textured)
    border = 1.0 - np.count_nonzero(source.mask[_INNER]) / key.area_px
    return _with_curvature(replace(key, border=border), planes, box)


def _with_curvature(key: Keyframe, planes: Field, box: Box) -> Keyframe:
    """Return a keyframe with its most curved points and what its slopes show; planes: (4, h, w), in a box."""
    mask = key.source.mask[within(box)]
    inside = cv2.erode(mask, _AROUND)
    rows, columns = np.nonzero(inside if inside.any() else mask)
    values = planes[CURVATURE, rows, columns]
    least = max(0, len(values) - MOST_POINTS)
    chosen = np.sort(np.argpartition(np.abs(values), least)[least:])
    chosen, points, (left, top) = chosen[_spread(len(chosen))], key.rows[CURVED], box[:2]
    points[X, : len(chosen)] = columns[chosen] + (left - key.center_px.real)
    points[Y, : len(chosen)] = rows[chosen] + (top - key.center_px.imag)
    points[FIRST, : len(chosen)] = values[chosen]
    curved = replace(key, counted=(*key.counted[:2], len(chosen)))
    own = float(self_loss(points, curved.facts(1.0), planes, np.array([1.0, -left, -top]), PROBE_RAD))
    return replace(
        curved,
        own=own,
        distinct=_information(key.rows[SLOPES], key.counted[SLOPES], FIRST + 2, (6, 2)),
        oblong=_oblong(key.rows[SLOPES], key.counted[SLOPES]),
    )


def _information(rows: Field, count: int, first: int, shape: tuple[int, int]) -> float:
    """Return the fraction of a channel's energy that a rotation by `PROBE_RAD`, and no shift, changes.

    The effects of shift, gain and constant slope are eliminated. first, shape: first row of the channel's
    Jacobian, and its number of parameters and of components.
    """
    jacobian = rows[first : first + shape[0] * shape[1], :count].astype(np.float64).reshape(shape[0], -1)
    matrix = jacobian @ jacobian.T
    other = matrix[1:, 1:] + np.eye(shape[0] - 1) * (1e-9 * np.trace(matrix) + 1e-20)
    about = matrix[0, 0] - matrix[0, 1:] @ np.linalg.solve(other, matrix[1:, 0])
    return float(about / (rows[SQUARE, :count].sum() + 1e-20) * PROBE_RAD**2 / 2.0)


def _oblong(rows: Field, count: int) -> float:
    """Return the relative difference of the two curvatures of a dent, from a linear fit of its slopes."""
    places = np.stack([rows[X, :count], rows[Y, :count], np.ones(count)]).astype(np.float64)
    moments, of_slopes = places @ places.T, places @ rows[FIRST : FIRST + 2, :count].T
    change = np.linalg.solve(moments + 1e-9 * np.eye(3), of_slopes)[:2]
    low, high = np.linalg.eigvalsh(0.5 * (change + change.T))
    return float((high - low) / max(abs(low), abs(high), 1e-20))


def _spread(count: int) -> NDArray[np.intp]:
    """Return the indices of at most `MOST_POINTS` of a number of points, in an order of `PARTS` samples."""
    chosen = np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(np.intp)
    return np.concatenate([chosen[part::PARTS] for part in range(PARTS)])


def _fill_slopes(
    rows: Field, source: Source, learnt: LearntGradientMap, pixels: Pixels, center: complex
) -> tuple[Field, Box]:
    """Fill the rows of the slopes; return `slope_planes` and the box."""
    box = contact_box(source.mask)
    planes = slope_planes(source.difference, learnt, source.mask, box, ALIGNMENT.broad_share)
    here, count = (pixels[0] - box[1], pixels[1] - box[0]), len(pixels[0])
    along_x, along_y = along_both(planes[:2], here, 1.0)
    values, x, y = planes[:2, *here], pixels[1] - center.real, pixels[0] - center.imag
    squares = (values * values).sum(0)
    rows[0, :count], rows[1, :count], rows[SQUARE, :count] = x, y, squares
    rows[WEIGHT, :count] = source.turning_at(pixels)
    # Lower weights for steep points, where colours saturate and the gel yields.
    rows[PLAIN, :count] = 1.0 / (1.0 + squares / (squares.mean() * ALIGNMENT.steep_share**2 + 1e-20))
    rows[FIRST : FIRST + 2, :count] = values
    jacobian = rows[FIRST + 2 : FIRST + 14].reshape(6, 2, -1)[..., :count]
    # A small rotation by d moves a point z to z - i d z, and changes a vector in the same way. Gain and a
    # constant slope along x and y follow.
    jacobian[0] = along_y * x - along_x * y
    jacobian[0, 0] += values[1]
    jacobian[0, 1] -= values[0]
    jacobian[1], jacobian[2], jacobian[3] = -along_x, -along_y, values
    jacobian[4, 0] = jacobian[5, 1] = 1.0
    return planes, box


def _contact_proper(source: Source, learnt: LearntGradientMap) -> Image:
    """Reduce a contact region to its deep part."""
    mask = source.mask
    rows, columns = mask.shape
    size = (max(1, columns // COARSE), max(1, rows // COARSE))
    difference = np.asarray(cv2.resize(source.difference, size, interpolation=cv2.INTER_AREA), np.float32)
    small = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    height = relief(learnt.reduce(size).apply(difference), small, COARSE)
    height, inside = cv2.resize(height, (columns, rows)), mask > 0
    heights = height[inside]
    at = int(SHALLOWER_SHARE * (heights.size - 1))
    deep = ((height > DEPTH_SHARE * np.partition(heights, at)[at]) & inside).astype(np.uint8)
    deep[:BORDER_PX], deep[-BORDER_PX:], deep[:, :BORDER_PX], deep[:, -BORDER_PX:] = 0, 0, 0, 0
    return deep
