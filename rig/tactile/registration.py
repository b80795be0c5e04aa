"""How a contact has turned and moved since a keyframe: alignment of surface gradients.

A gradient field turns with the object in two ways: it appears elsewhere, and its vectors turn. A
keyframe keeps the gradients of a contact; a later frame is pulled back by a trial rotation and
translation, its vectors turned back, and what remains is fitted by a small rotation, translation,
change of gain (deeper or softer gel) and constant slope (the object tilts against the gel). The
normal matrix is the keyframe's, so an iteration costs one resampling and a 6 x 6 solve (inverse
compositional Gauss-Newton). Angles are image angles, counter-clockwise positive; x right, y down.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.relative import upper_median
from rig.tactile.relief import Field, relief
from rig.tactile.sampling import GradientField

# The contact proper is where the dent is deeper than this share of its depth; the gel's skirts
# around it depend on more than the object.
DEPTH_SHARE = 0.25
DEPTH_PERCENTILE = 95.0
BORDER_PX = 2
MIN_POINTS, MAX_POINTS = 24, 1000
# Prior spread of constant slope and gain, as weights in pixels and in template energy: they stay
# free where the contact tells them from rotation, and small where it does not.
SLOPE_PRIOR, GAIN_PRIOR = 20.0, 50.0
# Residuals beyond this multiple of their median count less and less (Cauchy weights squared).
ROBUST_WIDTH = 2.5
# A gradient of this share of the template's rms length counts half.
STEEP_SHARE = 0.6
MAX_ITERATIONS = 12
# Which points are seen is decided at these iterations: at the guess, and near the answer.
MATRIX_AT = (1, 3)
DONE_RAD, DONE_PX = 3e-5, 1e-3
PARAMETERS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """The gradients of a contact to which later frames are aligned.

    center_px: (2,) x and y. points_px: (N, 2) from the center. template: (N, 2) gradients.
    squares: (N,) of their lengths. weights: (N,), lower where steep.
    jacobian: (2N, 6) for rotation (rad), x, y (px), gain, slope along x and y. contrast: the share
    of the template's energy that a rotation by 1 rad changes beyond what translation, gain and
    slope can imitate: 0 for a smooth ball, about 1 and more for an edge. clipped: whether the contact
    reaches the image's edge.
    """

    center_px: NDArray[np.float64]
    points_px: NDArray[np.float32]
    template: NDArray[np.float32]
    squares: NDArray[np.float32]
    weights: NDArray[np.float32]
    jacobian: NDArray[np.float32]
    energy: float
    contrast: float
    clipped: bool


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A contact's motion since its keyframe.

    angle_rad; shift_px: (2,) motion of the keyframe's center. misfit: residual over template, rms;
    1 where nothing fits. overlap: share of the keyframe's points seen. gain: of the gradients.
    noise_rad: one standard deviation of the angle if residuals were independent. weights: (N,) for
    the next frame.
    """

    angle_rad: float
    shift_px: NDArray[np.float64]
    misfit: float
    overlap: float
    gain: float
    noise_rad: float
    iterations: int
    weights: NDArray[np.float32]


def make_keyframe(gradient: Field, mask: Image) -> Keyframe | None:
    """Make a keyframe of a gradient (h, w, 2) and contact mask (h, w); None if too small."""
    rows, columns = np.nonzero(_contact_proper(gradient, mask))
    if len(rows) < MIN_POINTS:
        return None
    if len(rows) > MAX_POINTS:
        chosen = np.linspace(0, len(rows) - 1, MAX_POINTS).astype(int)
        rows, columns = rows[chosen], columns[chosen]
    template = gradient[rows, columns]
    squares = np.sum(template**2, axis=1)
    energy = float(squares.mean()) / 2.0
    if not energy > 0.0:
        return None
    center = np.array([columns.mean(), rows.mean()])
    points = (np.stack([columns, rows], axis=1) - center).astype(np.float32)
    slopes = (np.asarray(cv2.Scharr(gradient, cv2.CV_32F, *axis, scale=1 / 32)) for axis in ((1, 0), (0, 1)))
    jacobian = _jacobian(points, template, *(slope[rows, columns].astype(np.float32) for slope in slopes))
    return Keyframe(
        center_px=center,
        points_px=points,
        template=template,
        squares=squares,
        weights=_plainness(squares, energy),
        jacobian=jacobian,
        energy=energy,
        contrast=_contrast(jacobian, energy),
        clipped=_clipped(mask),
    )


def _plainness(squares: Field, energy: float) -> NDArray[np.float32]:
    """Weigh points down where steep: there colours saturate and the gel gives way."""
    weights = 1.0 / (1.0 + squares / (2.0 * energy * STEEP_SHARE**2))
    return (weights / weights.mean()).astype(np.float32)


def _contrast(jacobian: NDArray[np.float32], energy: float) -> float:
    """Return the share of the energy that a turn changes, see `Keyframe`."""
    points = len(jacobian) // 2
    inverse = np.linalg.inv(_normal(jacobian, np.ones(points, np.float32), energy))
    return float(1.0 / (inverse[0, 0] * energy * 2 * points))


def _clipped(mask: Image) -> bool:
    inner = mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    return cv2.countNonZero(inner) < cv2.countNonZero(mask)


def align(
    key: Keyframe,
    gradient: Field,
    mask: Image,
    angle_rad: float,
    shift_px: NDArray[np.float64],
    weights: NDArray[np.float32] | None = None,
    to_the_end: bool = False,
) -> Alignment:
    """Align a frame with a keyframe, starting from a guess of angle and shift.

    gradient: (h, w, 2). mask: (h, w) uint8, 1 in the contact; points that fall outside do not count.
    to_the_end: iterate on when nothing changes any more.
    """
    field = GradientField(gradient, mask)
    weights = key.weights if weights is None else weights * key.weights
    shift = np.array(shift_px, np.float64)
    iteration, used, inverse = 0, weights, np.zeros((PARAMETERS, PARAMETERS))
    step, residual = np.zeros(PARAMETERS), key.template
    while iteration < MAX_ITERATIONS:
        iteration += 1
        values, seen, turn = _pulled_back(key, field, angle_rad, shift)
        residual = values - key.template
        if iteration in MATRIX_AT:
            used = weights * seen
            inverse = np.asarray(np.linalg.inv(_normal(key.jacobian, used, key.energy)), np.float64)
        step = inverse @ (key.jacobian.T @ (residual * used[:, None]).reshape(-1)).astype(np.float64)
        angle_rad += float(step[0])
        shift += turn @ step[1:3]
        if abs(step[0]) < DONE_RAD and np.abs(step[1:3]).max() < DONE_PX and not to_the_end:
            break
        if not np.isfinite(angle_rad) or np.abs(shift).max() > max(mask.shape):
            break
    remaining = residual - (key.jacobian @ step.astype(np.float32)).reshape(-1, 2)
    return _judged(key, remaining.astype(np.float32), used, inverse, iteration, angle_rad, shift, step)


def similarity(
    key: Keyframe, gradient: Field, mask: Image, angle_rad: float, shift_px: NDArray[np.float64]
) -> float:
    """Return how like the keyframe a frame is at a trial pose, -1 to 1 (normalised correlation)."""
    field = GradientField(gradient, mask)
    values, seen, _ = _pulled_back(key, field, angle_rad, shift_px)
    values = values * seen[:, None]
    size = math.sqrt(float((values**2).sum()) * key.energy * key.template.size)
    return float((values * key.template).sum()) / size if size > 0.0 else -1.0


def turning(angle_rad: float) -> NDArray[np.float64]:
    """Return the (2, 2) matrix that turns x right, y down counter-clockwise as seen."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, sin], [-sin, cos]])


def _judged(
    key: Keyframe,
    remaining: NDArray[np.float32],
    used: NDArray[np.float32],
    inverse: NDArray[np.float64],
    iterations: int,
    angle_rad: float,
    shift: NDArray[np.float64],
    step: NDArray[np.float64],
) -> Alignment:
    seen = used > 0.0
    squares = remaining[:, 0] ** 2 + remaining[:, 1] ** 2
    unexplained, signal = float(used @ squares), float(used @ key.squares)
    misfit = math.sqrt(unexplained / signal) if signal > 0.0 and math.isfinite(unexplained) else math.inf
    variance = unexplained / max(2.0 * float(used.sum()), 1e-12)
    count = int(np.count_nonzero(seen))
    # 1.39 is the median of the squared length of a pair of unit normal errors.
    width = ROBUST_WIDTH**2 * (float(upper_median(squares[seen])) / 1.39 if count else 1.0) + 1e-20
    weights = np.where(seen, 1.0 / (1.0 + squares / width), 1.0).astype(np.float32)
    noise = math.sqrt(max(inverse[0, 0] * variance, 0.0))
    return Alignment(
        angle_rad, shift, misfit, count / len(seen), 1.0 + float(step[3]), noise, iterations, weights
    )


def _contact_proper(gradient: Field, mask: Image) -> Image:
    """Narrow a contact region to where the gel is pressed in deep."""
    height = relief(gradient, mask)
    inside = mask > 0
    depth = float(np.percentile(height[inside], DEPTH_PERCENTILE))
    deep = ((height > DEPTH_SHARE * depth) & inside).astype(np.uint8)
    deep[:BORDER_PX], deep[-BORDER_PX:], deep[:, :BORDER_PX], deep[:, -BORDER_PX:] = 0, 0, 0, 0
    return deep


def _jacobian(points: Field, template: Field, along_x: Field, along_y: Field) -> NDArray[np.float32]:
    """What small changes of the six parameters do to the template, (2N, 6)."""
    columns = np.zeros((len(points), 2, PARAMETERS), np.float32)
    x, y = points[:, :1], points[:, 1:]
    # Turning by d takes (x, y) to (x + d y, y - d x), for points and for vectors alike.
    columns[..., 0] = np.stack([template[:, 1], -template[:, 0]], axis=1) - (along_x * y - along_y * x)
    columns[..., 1], columns[..., 2] = -along_x, -along_y
    columns[..., 3] = template
    columns[:, 0, 4] = columns[:, 1, 5] = 1.0
    return columns.reshape(-1, PARAMETERS)


def _normal(
    jacobian: NDArray[np.float32], weights: NDArray[np.float32], energy: float
) -> NDArray[np.float64]:
    weighted = (jacobian.reshape(len(weights), -1) * weights[:, None]).reshape(jacobian.shape)
    normal = (jacobian.T @ weighted).astype(np.float64)
    diagonal = normal.reshape(-1)[:: PARAMETERS + 1]
    # A direction without information must not make the matrix exactly singular.
    diagonal += 1e-9 * diagonal + 1e-12 * diagonal.sum() + 1e-30
    diagonal[3:] += (GAIN_PRIOR * energy, SLOPE_PRIOR, SLOPE_PRIOR)
    return normal


def _pulled_back(
    key: Keyframe, field: GradientField, angle_rad: float, shift: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float64]]:
    """Return the frame's gradients at the keyframe's points, turned back; which are seen; the turn."""
    turn = turning(angle_rad)
    small = turn.astype(np.float32)
    values, seen = field.at(key.points_px @ small.T + (key.center_px + shift).astype(np.float32))
    return values @ small, seen, turn
