"""The slopes of a contact to which later frames are aligned (see `rig.tactile.slip.registration`)."""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.arc import pivot_doubt
from rig.tactile.slip.channel import Channel
from rig.tactile.slip.height import Gradient, relief
from rig.tactile.slip.loops import PARAMETERS, normal_matrix, with_priors
from rig.tactile.slip.parameters import JOINT, SLOPES
from rig.tactile.slip.roundness import trace_of_a_turn
from rig.tactile.slip.sampling import GradientField, sharpened

# Keyframes use the part of the dent that is deeper than a fraction of this quantile of the depth, because the
# gel around it does not depend on the object alone.
SHALLOWER_SHARE = 0.95
BORDER_PX = 2
MIN_POINTS, MAX_POINTS = 24, 600


@dataclass(frozen=True, eq=False)
class Keyframe:
    """The gradients of a contact to which later frames are aligned.

    center_px: origin of points_px, (N,) complex64. template: (2, N) float32, x and y of the sharpened
    gradients. squares: (N,), their squared lengths. weights: (N,), lower for steep gradients. jacobian: (6,
    2, N) for rotation (rad), x, y (px), gain, slope along x and y. pixels: rows and columns of the points.
    gradient, mask: (h, w), its source data.
    """

    center_px: complex
    points_px: NDArray[np.complex64]
    template: NDArray[np.float32]
    squares: NDArray[np.float32]
    weights: NDArray[np.float32]
    jacobian: NDArray[np.float32]
    energy: float
    pixels: tuple[NDArray[np.intp], NDArray[np.intp]]
    gradient: Gradient
    mask: Image

    @cached_property
    def contrast(self) -> float:
        """The fraction of the gradients' energy that a rotation by 1 rad changes.

        Changes that translation, gain and slope can explain do not count: 0 for a smooth ball, 1 or more for
        an edge.
        """
        _, squares, jacobian = _linearised(self.gradient, self.points_px, *self.pixels)
        return _contrast(jacobian, _energy(squares))

    @cached_property
    def trace(self) -> float:
        """See `trace_of_a_turn`."""
        return trace_of_a_turn(self.points_px, self.template, self.gradient, self.mask)

    @cached_property
    def pivot(self) -> float:
        """See `pivot_doubt`."""
        return pivot_doubt(self.gradient, self.mask)

    @property
    def clipped(self) -> bool:
        """Whether the contact reaches the image's edge."""
        inner = self.mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
        return cv2.countNonZero(inner) < cv2.countNonZero(self.mask)

    def within(self, field: GradientField) -> Channel:
        """Return this keyframe together with a frame to align."""
        return self._channel(field.planes, self.template, self.squares, self.jacobian)

    def weighted(self, turning: NDArray[np.float32]) -> "Keyframe":
        """Return this keyframe with its weights multiplied by others, (N,)."""
        weights = self.weights * turning
        return replace(self, weights=weights / weights.mean())

    def fine_within(self, field: GradientField) -> Channel:
        """Return this keyframe and a frame to align with less of their broad slopes: see `fine_planes`."""
        return self._channel(field.fine_planes, *self._fine)

    @cached_property
    def _fine(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Template, squares and jacobian for `fine_within`."""
        return _linearised(sharpened(self.gradient, JOINT.broad_share), self.points_px, *self.pixels)

    def _channel(
        self,
        planes: NDArray[np.float32],
        template: NDArray[np.float32],
        squares: NDArray[np.float32],
        jacobian: NDArray[np.float32],
    ) -> Channel:
        return Channel(planes, self.points_px, self.center_px, template, squares, jacobian, turns=1.0)


def make_keyframe(gradient: Gradient, mask: Image) -> Keyframe | None:
    """Make a keyframe of a gradient (h, w) and contact mask (h, w); None if too small."""
    rows, columns = np.nonzero(_contact_proper(gradient, mask))
    if len(rows) < MIN_POINTS:
        return None
    if len(rows) > MAX_POINTS:
        chosen = np.linspace(0, len(rows) - 1, MAX_POINTS).astype(int)
        rows, columns = rows[chosen], columns[chosen]
    center = complex(columns.mean(), rows.mean())
    points = (columns + 1j * rows - center).astype(np.complex64)
    template, squares, jacobian = _linearised(sharpened(gradient, SLOPES.broad_share), points, rows, columns)
    energy = _energy(squares)
    if not energy > 0.0:
        return None
    return Keyframe(
        center_px=center,
        points_px=points,
        template=template,
        squares=squares,
        weights=_plainness(squares, energy),
        jacobian=jacobian,
        energy=energy,
        pixels=(rows, columns),
        gradient=gradient,
        mask=mask,
    )


def squared_lengths(vectors: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Return the squared lengths of complex vectors, (N,)."""
    return vectors.real**2 + vectors.imag**2


def _linearised(
    gradient: Gradient, points: NDArray[np.complex64], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the gradients at points (2, N), the squares of their lengths, and their jacobian."""
    values = gradient[rows, columns]
    along = [slope[rows, columns] for slope in _slopes(gradient)]
    return _pairs(values), squared_lengths(values), _pairs(_jacobian(points, values, *along))


def _energy(squares: NDArray[np.float32]) -> float:
    """Return the mean square of a component."""
    return float(squares.mean()) / 2.0


def _slopes(gradient: Gradient) -> tuple[Gradient, Gradient]:
    """Return the derivatives of a gradient along x and along y."""
    pairs = np.ascontiguousarray(gradient).view(np.float32).reshape(*gradient.shape, 2)
    across, down = (
        np.asarray(cv2.Scharr(pairs, cv2.CV_32F, *axis, scale=1 / 32)) for axis in ((1, 0), (0, 1))
    )
    return across.view(np.complex64)[..., 0], down.view(np.complex64)[..., 0]


def _plainness(squares: NDArray[np.float32], energy: float) -> NDArray[np.float32]:
    """Return lower weights for steep points, where colours saturate and the gel yields."""
    weights = 1.0 / (1.0 + squares / (2.0 * energy * SLOPES.steep_share**2))
    return (weights / weights.mean()).astype(np.float32)


def _contrast(jacobian: NDArray[np.float32], energy: float) -> float:
    """Return the fraction of the energy that a rotation changes, see `Keyframe.contrast`."""
    alike = np.ones(jacobian.shape[2], np.float32)
    inverse = np.linalg.inv(with_priors(normal_matrix(jacobian, alike), energy))
    return float(1.0 / (inverse[0, 0] * energy * 2 * jacobian.shape[2]))


def _contact_proper(gradient: Gradient, mask: Image) -> Image:
    """Reduce a contact region to its deep part."""
    height = relief(gradient, mask)
    inside = mask > 0
    deep = ((height > SLOPES.depth_share * _depth(height[inside])) & inside).astype(np.uint8)
    deep[:BORDER_PX], deep[-BORDER_PX:], deep[:, :BORDER_PX], deep[:, -BORDER_PX:] = 0, 0, 0, 0
    return deep


def _depth(heights: NDArray[np.float32]) -> float:
    """Return the quantile `SHALLOWER_SHARE` of the heights; np.percentile takes ten times as long."""
    at = SHALLOWER_SHARE * (heights.size - 1)
    lower, upper = int(at), min(int(at) + 1, heights.size - 1)
    ordered = np.partition(heights, (lower, upper))
    return float(ordered[lower] + (at - lower) * (ordered[upper] - ordered[lower]))


def _jacobian(
    points: NDArray[np.complex64], template: Gradient, along_x: Gradient, along_y: Gradient
) -> NDArray[np.complex64]:
    """Return the derivatives of the template with respect to the six parameters, (6, N)."""
    rows = np.empty((PARAMETERS, len(points)), np.complex64)
    # A small rotation by d moves a point z to z - i d z, and changes a vector in the same way.
    rows[0] = -1j * template - (along_x * points.imag - along_y * points.real)
    rows[1], rows[2], rows[3] = -along_x, -along_y, template
    rows[4], rows[5] = 1.0, 1j
    return rows


def _pairs(vectors: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Return complex vectors (..., N) as x and y, (..., 2, N)."""
    return np.stack([vectors.real, vectors.imag], axis=-2)
