"""Which motion both channels of a contact speak for: its slopes, and its fine texture.

The slopes of a contact (`rig.tactile.slip.registration`) hold nearly all of the energy and tell a turn to a
few hundredths of a degree where they turn with the object. Under a smooth or soft object they are the gel's
own bulge, which does not turn; what turns then is a line, an edge or a mark (`rig.tactile.slip.texture`).
Neither channel is right everywhere. They are therefore aligned together, each weighted by how well it fits
(the likelihood of a channel whose noise is unknown); and of several motions found that one is believed for
which both channels together say most. What fits as well where it was before says nothing of a motion and
counts little: it is gel, a speck or a scratch.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.keyframe import PARAMETERS, Keyframe, squared_lengths
from rig.tactile.slip.registration import turning
from rig.tactile.slip.sampling import GradientField, read
from rig.tactile.slip.texture import TextureField, TextureKey, products_of_rows

# A point whose change since the keyframe, had nothing moved, is this share of its energy counts half;
# noise, as a share of the mean energy, keeps points alike where nothing has moved.
REST_SHARE, NOISE_SHARE = 0.09, 0.01
# A channel is never weighted as if it fitted better than this share of its energy, and one that leaves less
# than the second unexplained says no more for it: the rest is no noise.
LEAST_MISFIT, LEAST_UNEXPLAINED = 0.02, 0.1
ITERATIONS, FEW_ITERATIONS = 8, 4
# Residuals are weighed and the normal matrix is made at these iterations: at the guess, and near the answer.
MATRIX_AT = (0, 2)
DONE_RAD, DONE_PX = 5e-4, 1.5e-2
MOST_TURN_STEP_RAD, MOST_STEP_PX = 0.1, 1.5
# Turn and shift come first among the parameters; of the slopes' others, gain and constant slopes, these are
# the prior weights.
MOTION, PRIOR = slice(0, 3), np.diag([0.0, 0.0, 0.0, 1e-3, 10.0, 10.0]) + 1e-9 * np.eye(PARAMETERS)
DAMPING = 1.0 + 1e-3 * np.eye(PARAMETERS)
LEAST_GAIN, MOST_GAIN = 0.3, 2.0
# So many points of a keyframe's slopes are enough here.
SLOPE_POINTS = 300
# A shift is looked for on a square grid of this reach and pitch, with so many points of the texture.
GRID_REACH, GRID_PITCH_PX, GRID_POINTS = 3, 2.5, 200

Matrix = NDArray[np.float64]
Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Weighting:
    """How much each channel counts."""

    slopes: float
    texture: float


TOGETHER = Weighting(0.25, 1.0)
TEXTURE_FIRST, SLOPES_FIRST = Weighting(0.02, 1.0), Weighting(1.0, 0.05)


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion since a keyframe and what speaks for it.

    angle_rad; shift_px of the keyframe's center. slopes, texture: correlation of each channel with its
    template, at most 1, what rests counted little.
    """

    angle_rad: float
    shift_px: complex
    slopes: float
    texture: float

    @property
    def evidence(self) -> float:
        """What both channels say for it: -log(1 - correlation^2) / 2 added up, per independent point."""
        unexplained = (1.0 - max(c, 0.0) ** 2 for c in (self.slopes, self.texture))
        return sum(-0.5 * math.log(max(share, LEAST_UNEXPLAINED)) for share in unexplained)


class Evidence:
    """One keyframe and one frame: finds motions and weighs them."""

    def __init__(self, key: Keyframe, texture: TextureKey, field: GradientField, seen: TextureField) -> None:
        self._slopes, self._fine = _Slopes(key, field), _Fine(texture, key.center_px, seen)

    def align(
        self, angle_rad: float, shift_px: complex, weighting: Weighting, iterations: int
    ) -> tuple[float, complex]:
        """Return the angle and shift found from a start."""
        for iteration in range(iterations):
            anew = iteration in MATRIX_AT
            matrix, pull = self._slopes.equations(angle_rad, shift_px, weighting.slopes, anew)
            fine_matrix, fine_pull = self._fine.equations(angle_rad, shift_px, weighting.texture, anew)
            matrix[MOTION, MOTION] += fine_matrix
            pull[MOTION] += fine_pull
            matrix = matrix * DAMPING + PRIOR
            # its solver costs a third of numpy's; the matrix is positive definite
            step = cv2.solve(matrix, pull, flags=cv2.DECOMP_CHOLESKY)[1]
            turn, right, down = step[MOTION, 0].tolist()
            turn = _clipped(turn, MOST_TURN_STEP_RAD)
            move = complex(_clipped(right, MOST_STEP_PX), _clipped(down, MOST_STEP_PX))
            shift_px += turning(angle_rad) * move
            angle_rad += turn
            if abs(turn) < DONE_RAD and abs(move) < DONE_PX:
                break
        return angle_rad, shift_px

    def placed(self, angle_rad: float, shift_px: complex) -> complex:
        """Return the shift on a grid around one at which the texture fits best, for a given turn."""
        return shift_px + complex(_GRID_PX[self._fine.best_of(angle_rad, shift_px + _GRID_PX[:, None])])

    def judged(self, angle_rad: float, shift_px: complex) -> Motion:
        """Return what speaks for a motion."""
        slopes, fine = (c.correlation_at(angle_rad, shift_px) for c in (self._slopes, self._fine))
        return Motion(angle_rad, shift_px, slopes, fine)


class _Weights:
    """The points of one channel, weighed by how ill they would fit had nothing moved.

    squares: (N,) of the template. resting: (N,) squared change where nothing has moved.
    """

    def __init__(self, squares: Values, resting: Values) -> None:
        moved = resting + np.float32(NOISE_SHARE * float(squares.mean()))
        self.points: Values = np.asarray(
            moved / (moved + np.float32(REST_SHARE) * squares + np.float32(1e-20)), np.float32
        )
        self.energy = max(float(self.points @ squares), 1e-20)
        self._sum = max(float(self.points.sum()), 1e-20)

    def of_components(self, count: int) -> Values:
        """Return them for each component of vectors (count N,), as shares of the template's energy."""
        return np.repeat(self.points / np.float32(self.energy), count)

    def robust(self, squares: Values, misfit: float) -> Values:
        """Return weights (N,), lower where a residual's square is beyond the mean."""
        width = np.float32(2.0 * misfit * self.energy / self._sum + 1e-20)
        return np.asarray(self.points / (1.0 + squares / width), np.float32)

    def correlation(self, products: Values, squares: Values) -> float:
        """Return the correlation, from what is seen times the template and the squares of what is seen."""
        return float(self.points @ products) / math.sqrt(float(self.points @ squares) * self.energy + 1e-30)


class _Slopes:
    """The slopes of a keyframe's points in one frame."""

    def __init__(self, key: Keyframe, field: GradientField) -> None:
        step = -(-len(key.points_px) // SLOPE_POINTS)
        self._center_px, self._points_px = key.center_px, key.points_px[::step]
        self._template, self._planes = key.template[::step], field.planes
        self._jacobian = np.ascontiguousarray(key.jacobian.view(np.complex64)[:, ::step])
        squares = key.squares[::step]
        self._weights = _Weights(squares, squared_lengths(self._at(0.0, 0j)[0] - self._template))
        self._shares = self._weights.of_components(2)
        self._weighted, self._matrix = self._jacobian.view(np.float32), np.eye(PARAMETERS)

    def equations(
        self, angle_rad: float, shift_px: complex, weight: float, anew: bool
    ) -> tuple[Matrix, Matrix]:
        """Return normal matrix (6, 6) and right side (6,) of the parameters of `Keyframe.jacobian`."""
        values, seen = self._at(angle_rad, shift_px)
        complex_residual = values - self._template
        residual = complex_residual.view(np.float32)
        misfit = float((residual * residual) @ self._shares)
        if anew:
            used = self._weights.robust(squared_lengths(complex_residual), misfit) * seen
            self._weighted = (self._jacobian * used).view(np.float32)
            self._matrix = (self._weighted @ self._jacobian.view(np.float32).T).astype(np.float64)
        weight /= max(misfit, LEAST_MISFIT) * self._weights.energy
        return weight * self._matrix, weight * (self._weighted @ residual).astype(np.float64)

    def correlation_at(self, angle_rad: float, shift_px: complex) -> float:
        """Return the correlation with the template at a motion."""
        values = self._at(angle_rad, shift_px)[0]
        return self._weights.correlation((values * self._template.conj()).real, squared_lengths(values))

    def _at(self, angle_rad: float, shift_px: complex) -> tuple[NDArray[np.complex64], Values]:
        """Return the frame's slopes at the points, turned back, and how much each is seen, 0 to 1."""
        turn = turning(angle_rad)
        found = read(self._planes, self._points_px * np.complex64(turn) + (self._center_px + shift_px))
        values = np.ascontiguousarray(found[:, :2]).view(np.complex64)[:, 0]
        return values * np.complex64(turn.conjugate()), found[:, 2]


class _Fine:
    """The texture of a keyframe's points in one frame."""

    def __init__(self, key: TextureKey, center_px: complex, seen: TextureField) -> None:
        self._key, self._center_px, self._seen = key, center_px, seen
        change = self._at(0.0, 0j) - key.values
        self._weights = _Weights(key.squares, products_of_rows(change, change))
        self._shares, self._template = self._weights.of_components(3), key.values.reshape(-1)
        self._weighted_template = self._shares * self._template
        self._weighted, self._matrix = key.jacobian, np.eye(3)

    def equations(
        self, angle_rad: float, shift_px: complex, weight: float, anew: bool
    ) -> tuple[Matrix, Matrix]:
        """Return normal matrix (3, 3) and right side (3,) of turn and shift."""
        found = self._at(angle_rad, shift_px).reshape(-1)
        gain = min(max(float(self._weighted_template @ found), LEAST_GAIN), MOST_GAIN)
        residual = found - np.float32(gain) * self._template
        squares = residual * residual
        misfit = float(squares @ self._shares)
        if anew:
            robust = self._weights.robust(squares.reshape(-1, 3).sum(1), misfit)
            self._weighted = self._key.jacobian * np.repeat(robust, 3)
            self._matrix = (self._weighted @ self._key.jacobian.T).astype(np.float64)
        weight *= gain / (max(misfit, LEAST_MISFIT) * self._weights.energy)
        return weight * gain * self._matrix, weight * (self._weighted @ residual).astype(np.float64)

    def correlation_at(self, angle_rad: float, shift_px: complex) -> float:
        """Return the correlation with the template at a motion."""
        found = self._at(angle_rad, shift_px)
        products = products_of_rows(found, self._key.values)
        return self._weights.correlation(products, products_of_rows(found, found))

    def best_of(self, angle_rad: float, shifts_px: NDArray[np.complex64]) -> int:
        """Return which of the shifts (G, 1) has the highest correlation, by some of the points."""
        step = max(1, len(self._key.points_px) // GRID_POINTS)
        weights = self._weights.points[::step]
        seen = self._key.pulled_back(self._seen, angle_rad, self._center_px + shifts_px, step)
        both = np.einsum("gnc,nc,n->g", seen, self._key.values[::step], weights)
        energy = np.einsum("gnc,gnc,n->g", seen, seen, weights)
        return int(np.argmax(both / np.sqrt(energy + 1e-12)))

    def _at(self, angle_rad: float, shift_px: complex) -> Values:
        return self._key.pulled_back(self._seen, angle_rad, self._center_px + shift_px)


def _clipped(value: float, most: float) -> float:
    return min(max(value, -most), most)


_STEPS_PX = np.arange(-GRID_REACH, GRID_REACH + 1) * GRID_PITCH_PX
_GRID_PX = (_STEPS_PX[None, :] + 1j * _STEPS_PX[:, None]).reshape(-1).astype(np.complex64)
