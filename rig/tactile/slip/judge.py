"""Decide whether the slopes or the texture of a contact show its rotation, with the newest keyframe.

Both channels are aligned together. The pose of the slopes alone is kept unless the joint pose has a clearly
higher score. Older keyframes of the contact drift less, so they correct the newest one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rig.tactile.slip.evidence import Fit, aligned, fit_at
from rig.tactile.slip.keys import ContactPose, Key
from rig.tactile.slip.loops import LEAST_MISFIT
from rig.tactile.slip.parameters import KEYFRAMES, TEXTURE
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField

ITERATIONS = 8


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
        more = TEXTURE.more_score if alone < TEXTURE.ample_score else TEXTURE.more_than_ample
        firm = leads and belief.fit.texture >= TEXTURE.firm
        if belief.fit.score < alone + (0.0 if firm else more):
            return None
    for key in _older(keys, belief.pose.angle_rad):
        older = key.facing(field, texture)
        if older is not None:
            belief = _together(belief, _belief(key, aligned([older], belief.pose, ITERATIONS)))
    return belief


def still_fits(fit: Fit, turned_rad: float) -> bool:
    """Return whether a keyframe is still used after a rotation since it was taken."""
    if abs(turned_rad) > TEXTURE.next_key_rad:
        return abs(turned_rad) <= TEXTURE.furthest_key_rad and min(fit.slopes, fit.texture) >= TEXTURE.kept
    return fit.score >= TEXTURE.kept_score


def sigma_alone(contrast: float, fit: Fit) -> float:
    """Return one standard deviation of the angle that one keyframe and one frame show, rad.

    A turn that changes the slopes little is poorly constrained by them, however well they fit.
    """
    slopes = TEXTURE.slopes_sigma_rad / math.sqrt(contrast), fit.slopes
    channels = slopes, (TEXTURE.sigma_rad, fit.texture)
    information = 0.0
    for sigma, correlation in channels:
        explained = min(max(correlation, TEXTURE.least_correlation) ** 2, 1.0 - LEAST_MISFIT)
        information += explained / ((1.0 - explained) * sigma**2)
    return 1.0 / math.sqrt(information)


def _belief(key: Key, fit: Fit) -> Belief:
    # Resting texture pulls every key of a chain the same way: errors add up, not only their squares.
    own = sigma_alone(key.frame.contrast, fit)
    return Belief(fit.pose, (math.sqrt(key.variance) + own) ** 2 + TEXTURE.least_sigma_rad**2, fit)


def _older(keys: Sequence[Key], angle_rad: float) -> list[Key]:
    """Return the first key, and the oldest near one of the others except the newest."""
    near = [k for k in keys[1:-1] if k.near(angle_rad)]
    return [*keys[:1], *near[:1]] if len(keys) > 1 else []


def _together(belief: Belief, found: Belief) -> Belief:
    """Fuse the pose with that of an older key, weighted by variance, if they agree."""
    gap = found.pose.angle_rad - belief.pose.angle_rad
    total = belief.variance + found.variance
    same_rad = max(TEXTURE.same_rad, KEYFRAMES.same_sigmas * math.sqrt(total))
    if found.fit.score < TEXTURE.older_score or abs(gap) > same_rad:
        return belief
    share = belief.variance / total
    point = belief.pose.point_px + share * (found.pose.point_px - belief.pose.point_px)
    pose = ContactPose(belief.pose.angle_rad + share * gap, point)
    return replace(belief, pose=pose, variance=belief.variance * found.variance / total)
