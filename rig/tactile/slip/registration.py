"""Measure the rotation and translation of a contact since a keyframe, by alignment of surface gradients.

When the object rotates, both the positions and the vectors of the gradient field rotate. A keyframe stores
the gradients of a contact. A later frame is resampled with a trial rotation and translation, and its vectors
are rotated back. The residual is explained by a small rotation, translation, change of gain (deeper or softer
gel) and constant slope (the object tilts against the gel). The normal matrix is that of the keyframe, so an
iteration needs one resampling and a 6 x 6 solve (inverse compositional Gauss-Newton). Angles are image
angles, counter-clockwise positive. Positions and vectors are complex numbers, x (right) + i y (down), so that
a rotation by d multiplies them by exp(-i d).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.tactile.contact.relative import upper_median
from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.loops import align_alone
from rig.tactile.slip.parameters import SLOPES
from rig.tactile.slip.sampling import GradientField

MAX_ITERATIONS = 12
# Relative standard deviation of the pixel aspect (width over height on the gel), unknown and calibrated.
# After a rotation by d, the angle of a long contact has an error of up to a sin(d) for an aspect error of a.
ASPECT_UNKNOWN, ASPECT_KNOWN = 0.02, 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """A contact's motion since its keyframe.

    angle_rad; shift_px: motion of the keyframe's center. misfit: ratio of residual to template, rms; inf if
    nothing fits. overlap: fraction of the keyframe's points inside the contact. gain: of the gradients.
    noise_rad: one standard deviation of the angle if residuals were independent. settled: whether the
    alignment has converged. weights: (N,) for the next frame. bent_rad: change of the angle if the curvature
    of the dent may change, too. further_rad: change of the angle by iterations after convergence, if they
    were requested.
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
    bent_rad: float = 0.0
    further_rad: float = 0.0


def align(
    key: Keyframe,
    field: GradientField,
    angle_rad: float,
    shift_px: complex,
    weights: NDArray[np.float32] | None = None,
    to_the_end: bool = False,
) -> Alignment:
    """Align a frame with a keyframe, from an initial angle and shift.

    Points outside the contact do not count. to_the_end: continue to iterate after convergence, and return the
    change in `further_rad`. The result is not changed by it, because decisions such as a further keyframe may
    depend on the last digit.
    """
    weights = key.weights if weights is None else weights * key.weights
    start = angle_rad, complex(shift_px)
    found = align_alone(key.within(field), weights, key.energy, start, MAX_ITERATIONS, to_the_end)
    unexplained, signal = float(found.used @ found.squares), float(found.used @ key.squares)
    fits = signal > 0.0 and math.isfinite(unexplained)
    variance = unexplained / max(2.0 * float(found.used.sum()), 1e-12)
    return Alignment(
        angle_rad=found.angle_rad,
        shift_px=found.shift_px,
        misfit=math.sqrt(unexplained / signal) if fits else math.inf,
        overlap=np.count_nonzero(found.used) / len(found.used),
        gain=1.0 + found.gain,
        noise_rad=math.sqrt(max(found.inverse * variance, 0.0)),
        iterations=found.iterations,
        settled=found.done,
        weights=_robust(found.squares, found.used > 0.0),
        bent_rad=found.bent_rad,
        further_rad=found.further_rad,
    )


def _robust(squares: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the weights of points by their squared residuals; 1 for points outside the contact."""
    # 1.39 is the median of the squared length of a pair of unit normal errors.
    middle = float(upper_median(squares[seen])) / 1.39 if seen.any() else 1.0
    width = SLOPES.robust_width**2 * middle + 1e-20
    return np.where(seen, 1.0 / (1.0 + squares / width), 1.0).astype(np.float32)


def angle_variance(alignment: Alignment, contrast: float, aspect_known: bool) -> float:
    """Return the variance of an alignment's angle, rad^2, without that of its keyframe.

    Noise is the smaller part, because thousands of pixels are averaged. Model errors remain: the gel yields
    at the edge of the contact, colours saturate, and the map was learnt from one image. Such errors grow with
    the misfit and decrease with the contrast. A dent whose outline leans while its object does not turn, as
    of a roller, also looks like a rotation: see `bent_rad`.
    """
    systematic = SLOPES.systematic_rad * alignment.misfit / math.sqrt(contrast)
    aspect = (ASPECT_KNOWN if aspect_known else ASPECT_UNKNOWN) * math.sin(alignment.angle_rad)
    errors = SLOPES.floor_rad, alignment.noise_rad, systematic, aspect, alignment.bent_rad
    return sum(error**2 for error in errors)
