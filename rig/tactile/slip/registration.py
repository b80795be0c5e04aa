"""How a contact has turned and moved since a keyframe: alignment of surface gradients.

A gradient field turns with the object in two ways: it appears elsewhere, and its vectors turn. A
keyframe keeps the gradients of a contact; a later frame is pulled back by a trial rotation and
translation, its vectors turned back, and what remains is fitted by a small rotation, translation,
change of gain (deeper or softer gel) and constant slope (the object tilts against the gel). The
normal matrix is the keyframe's, so an iteration costs one resampling and a 6 x 6 solve (inverse
compositional Gauss-Newton). Angles are image angles, counter-clockwise positive. Places and vectors
are complex numbers, x (right) + i y (down), so that such a turn by d multiplies them by exp(-i d).
"""

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.tactile.contact.relative import upper_median
from rig.tactile.slip.keyframe import PARAMETERS, Keyframe, normal_matrix, squared_lengths
from rig.tactile.slip.sampling import GradientField

# Residuals beyond this multiple of their median count less and less (Cauchy weights squared).
ROBUST_WIDTH = 2.5
MAX_ITERATIONS = 12
# Which points are seen is decided at these iterations: at the guess, and near the answer.
MATRIX_AT = (1, 3)
# A step this small is the last one needed: the next would be several times smaller.
DONE_RAD, DONE_PX = 5e-5, 1.5e-3


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A contact's motion since its keyframe.

    angle_rad; shift_px: motion of the keyframe's center. misfit: residual over template, rms; inf
    where nothing fits. overlap: share of the keyframe's points seen. gain: of the gradients.
    noise_rad: one standard deviation of the angle if residuals were independent. settled: whether the
    last step was as small as wanted. weights: (N,) for the next frame. further_rad: how far iterations
    after the last change that counts would have turned it, where they were asked for.
    """

    angle_rad: float
    shift_px: complex
    misfit: float
    overlap: float
    gain: float
    noise_rad: float
    iterations: int
    settled: bool
    weights: NDArray[np.float32]
    further_rad: float = 0.0


def align(
    key: Keyframe,
    field: GradientField,
    angle_rad: float,
    shift_px: complex,
    weights: NDArray[np.float32] | None = None,
    to_the_end: bool = False,
) -> Alignment:
    """Align a frame with a keyframe, starting from a guess of angle and shift.

    Points that fall outside the contact do not count. to_the_end: iterate on when nothing changes
    any more, and say what that would change. The answer stays: what depends on it, such as whether another
    keyframe is due, may turn on the last digit.
    """
    weights = key.weights if weights is None else weights * key.weights
    used, weighted, inverse = weights, key.jacobian, np.zeros((PARAMETERS, PARAMETERS))
    step, residual = np.zeros(PARAMETERS), key.template
    iteration, done, answer = 0, False, None
    while iteration < MAX_ITERATIONS and not (done and not to_the_end):
        iteration += 1
        values, seen = _pulled_back(key, field, angle_rad, shift_px)
        residual = values - key.template
        if iteration in MATRIX_AT and not done:
            used = weights * seen
            weighted = _pairs(key.jacobian.view(key.template.dtype) * used)
            inverse = np.linalg.inv(normal_matrix(weighted, key.jacobian, key.energy))
        step = inverse @ (weighted @ _pairs(residual)).astype(np.float64)
        shift_px += turning(angle_rad) * complex(step[1], step[2])
        angle_rad += float(step[0])
        if not math.isfinite(angle_rad) or abs(shift_px) > 2 * max(field.mask.shape):
            break
        done = done or (abs(step[0]) < DONE_RAD and max(abs(step[1]), abs(step[2])) < DONE_PX)
        if done and answer is None:
            answer = angle_rad, shift_px, residual, step
    at_the_end_rad = angle_rad
    if answer is not None:
        angle_rad, shift_px, residual, step = answer
    remaining = _pairs(residual) - step.astype(key.jacobian.dtype) @ key.jacobian
    squares = squared_lengths(remaining.view(residual.dtype))
    unexplained, signal = float(used @ squares), float(used @ key.squares)
    fits = signal > 0.0 and math.isfinite(unexplained)
    variance = unexplained / max(2.0 * float(used.sum()), 1e-12)
    return Alignment(
        angle_rad=angle_rad,
        shift_px=shift_px,
        misfit=math.sqrt(unexplained / signal) if fits else math.inf,
        overlap=np.count_nonzero(used) / len(used),
        gain=1.0 + float(step[3]),
        noise_rad=math.sqrt(max(inverse[0, 0] * variance, 0.0)),
        iterations=iteration,
        settled=done,
        weights=_robust(squares, used > 0.0),
        further_rad=at_the_end_rad - angle_rad,
    )


def similarity(key: Keyframe, field: GradientField, angle_rad: float, shift_px: complex) -> float:
    """Return how like the keyframe a frame is at a trial pose, -1 to 1 (normalised correlation)."""
    values, seen = _pulled_back(key, field, angle_rad, shift_px)
    values = values * seen
    size = math.sqrt(float(squared_lengths(values).sum()) * float(key.squares.sum()))
    return float(np.vdot(key.template, values).real) / size if size > 0.0 else -1.0


def turning(angle_rad: float) -> complex:
    """Return the factor that turns places and vectors counter-clockwise as seen."""
    return cmath.exp(-1j * angle_rad)


def _robust(squares: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the weights of points by their squared residuals, 1 for those not seen."""
    # 1.39 is the median of the squared length of a pair of unit normal errors.
    middle = float(upper_median(squares[seen])) / 1.39 if seen.any() else 1.0
    width = ROBUST_WIDTH**2 * middle + 1e-20
    return np.where(seen, 1.0 / (1.0 + squares / width), 1.0).astype(np.float32)


def _pairs(vectors: NDArray[np.complex64]) -> NDArray[np.float32]:
    """Return (N,) complex vectors as (2N,) numbers."""
    return vectors.view(vectors.real.dtype)


def _pulled_back(
    key: Keyframe, field: GradientField, angle_rad: float, shift_px: complex
) -> tuple[NDArray[np.complex64], NDArray[np.bool_]]:
    """Return the frame's gradients at the keyframe's points, turned back, and which are seen."""
    turn = turning(angle_rad)
    values, seen = field.at(key.points_px * np.complex64(turn) + np.complex64(key.center_px + shift_px))
    return values * np.complex64(turn.conjugate()), seen
