"""Decide whether the slopes or the texture of a contact show its rotation, with the newest keyframe.

Both channels are aligned together. The pose of the slopes alone is kept unless the joint pose has a clearly
higher score. Older keyframes of the contact drift less, so they correct the newest one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rig.tactile.slip.evidence import Fit, aligned, fit_at
from rig.tactile.slip.keys import SAME_SIGMAS, ContactPose, Key
from rig.tactile.slip.loops import LEAST_MISFIT
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField

ITERATIONS = 8
# If the slopes leave little unexplained, their pose is kept unless the joint pose has a score that is higher
# by MORE_SCORE, or by MORE_THAN_AMPLE if that of the slopes is at least AMPLE_SCORE.
MORE_SCORE, AMPLE_SCORE, MORE_THAN_AMPLE = 0.1, 1.2, 0.5
# If the texture leads already with at least this correlation, an equal score suffices: just after a keyframe
# a resting bulge fits perfectly, and the rotation that it hides would be lost with the next keyframe.
FIRM_TEXTURE = 0.95
# An older keyframe with a lower score is ignored. It shows the same rotation within this angle or within
# `SAME_SIGMAS`.
LEAST_SCORE, SAME_RAD = 0.15, math.radians(4.0)
# One standard deviation of the angle that a channel shows alone, times the root of its unexplained share (of
# the slopes: for a contact of contrast 1, see `Keyframe`); its lowest correlation there; the lowest sigma.
# Set on the development clips. One constant sigma increases the error of smooth ovals.
SLOPES_SIGMA_RAD, TEXTURE_SIGMA_RAD = math.radians(12.0), math.radians(3.0)
LEAST_CORRELATION, LEAST_SIGMA_RAD = 0.05, math.radians(0.3)
# A keyframe is kept up to a rotation of NEXT_KEY_RAD if its score is at least KEPT_SCORE, and up to
# FURTHEST_KEY_RAD if both channels have at least the correlation KEPT.
NEXT_KEY_RAD, KEPT_SCORE = math.radians(3.0), 0.7
KEPT, FURTHEST_KEY_RAD = 0.75, math.radians(12.0)


@dataclass(frozen=True, slots=True)
class Belief:
    """A pose of the contact, the variance of its angle (rad^2), and the fit of the newest keyframe there."""

    pose: ContactPose
    variance: float
    fit: Fit


def by_texture(
    keys: Sequence[Key],
    field: GradientField,
    texture: TextureField,
    expected: ContactPose,
    by_slopes: ContactPose | None,
    leads: bool,
) -> Belief | None:
    """Return the pose by slopes and texture together; None if the pose of the slopes alone is kept.

    keys: the first one of the contact first, its newest last. expected: the initial pose. by_slopes: the pose
    of the slopes alone if they leave little unexplained, else None. leads: whether the texture led in the
    last frame. Without texture in the newest key there is nothing to compare.
    """
    newest = keys[-1].facing(field, texture)
    if newest is None:
        return None
    belief = _belief(keys[-1], aligned([newest], expected, ITERATIONS))
    if by_slopes is not None:
        alone = fit_at(newest, by_slopes).score
        more = MORE_SCORE if alone < AMPLE_SCORE else MORE_THAN_AMPLE
        firm = leads and belief.fit.texture >= FIRM_TEXTURE
        if belief.fit.score < alone + (0.0 if firm else more):
            return None
    for key in _older(keys, belief.pose.angle_rad):
        older = key.facing(field, texture)
        if older is not None:
            belief = _together(belief, _belief(key, aligned([older], belief.pose, ITERATIONS)))
    return belief


def still_fits(fit: Fit, turned_rad: float) -> bool:
    """Return whether a keyframe is still used after a rotation since it was taken."""
    if abs(turned_rad) > NEXT_KEY_RAD:
        return abs(turned_rad) <= FURTHEST_KEY_RAD and min(fit.slopes, fit.texture) >= KEPT
    return fit.score >= KEPT_SCORE


def sigma_alone(contrast: float, fit: Fit) -> float:
    """Return one standard deviation of the angle that one keyframe and one frame show, rad.

    A turn that changes the slopes little is poorly constrained by them, however well they fit.
    """
    channels = ((SLOPES_SIGMA_RAD / math.sqrt(contrast), fit.slopes), (TEXTURE_SIGMA_RAD, fit.texture))
    information = 0.0
    for sigma, correlation in channels:
        explained = min(max(correlation, LEAST_CORRELATION) ** 2, 1.0 - LEAST_MISFIT)
        information += explained / ((1.0 - explained) * sigma**2)
    return 1.0 / math.sqrt(information)


def _belief(key: Key, fit: Fit) -> Belief:
    # Resting texture pulls every key of a chain the same way: errors add up, not only their squares.
    own = sigma_alone(key.frame.contrast, fit)
    return Belief(fit.pose, (math.sqrt(key.variance) + own) ** 2 + LEAST_SIGMA_RAD**2, fit)


def _older(keys: Sequence[Key], angle_rad: float) -> list[Key]:
    """Return the first key, and the oldest near one of the others except the newest."""
    near = [k for k in keys[1:-1] if k.near(angle_rad)]
    return [*keys[:1], *near[:1]] if len(keys) > 1 else []


def _together(belief: Belief, found: Belief) -> Belief:
    """Fuse the pose with that of an older key, weighted by variance, if they agree."""
    gap = found.pose.angle_rad - belief.pose.angle_rad
    total = belief.variance + found.variance
    if found.fit.score < LEAST_SCORE or abs(gap) > max(SAME_RAD, SAME_SIGMAS * math.sqrt(total)):
        return belief
    share = belief.variance / total
    point = belief.pose.point_px + share * (found.pose.point_px - belief.pose.point_px)
    pose = ContactPose(belief.pose.angle_rad + share * gap, point)
    return replace(belief, pose=pose, variance=belief.variance * found.variance / total)
