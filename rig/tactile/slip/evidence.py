"""Align a frame with keyframes by slopes and fine texture, and score the fit at a pose.

The slopes of a contact (`rig.tactile.slip.registration`) hold nearly all of the energy. Where they rotate
with the object they show a rotation to a few hundredths of a degree. Under a smooth or soft object they are
those of the gel's bulge, which does not rotate; a line, an edge or a mark (`rig.tactile.slip.texture`) does.
Neither channel is always correct. Both are therefore aligned together, each weighted by the quality of its
fit (the likelihood of a channel with unknown noise). Points that also fit at their old position get little
weight, because they may belong to the gel.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.channel import MOST_KEYS, JointKey
from rig.tactile.slip.keys import ContactPose
from rig.tactile.slip.loops import align_jointly, correlation_at, turning
from rig.tactile.slip.parameters import JOINT


@dataclass(frozen=True, slots=True)
class Fit:
    """A pose and how well keyframes fit there.

    slopes, texture: mean correlation of each channel with its templates, at most 1. score: mean over the
    keyframes of -log(1 - correlation^2) / 2, summed over the channels. own_rad: one standard deviation of
    the angle if the contact had one independent point.
    """

    pose: ContactPose
    slopes: float
    texture: float
    score: float
    own_rad: float = math.inf


def aligned(
    keys: Sequence[JointKey],
    start: ContactPose,
    iterations: int,
    expected_rad: float = 0.0,
    prior: float = 0.0,
) -> Fit:
    """Align a frame to keyframes jointly, from an initial pose.

    prior: weight of the squared distance from the expected angle.
    """
    # The compiled loop takes a fixed number of keyframes; those of weight 0 do not count.
    filled = (*keys, *(MOST_KEYS - len(keys)) * (keys[0]._replace(weight=0.0),))
    at = start.angle_rad, complex(start.point_px)
    shares = JOINT.slopes_share, 1.0
    angle, point, normal, fits = align_jointly(filled, at, expected_rad, prior, shares, iterations)
    own_rad = math.sqrt(max(float(np.linalg.inv(normal)[0, 0]), 0.0))
    return _fit(keys, ContactPose(angle, point), fits[: len(keys)], own_rad)


def fit_at(key: JointKey, pose: ContactPose) -> Fit:
    """Return the fit of a keyframe at a pose, without alignment."""
    turn = pose.angle_rad - key.angle_rad
    shift = complex(pose.point_px - turning(turn) * key.lever_px - key.slopes.center)
    slopes = correlation_at(key.slopes, key.slope_weights, turn, shift)
    texture = correlation_at(key.texture, key.texture_weights, turn, shift)
    return _fit([key], pose, np.array([[slopes, texture]]))


def _fit(
    keys: Sequence[JointKey], pose: ContactPose, fits: NDArray[np.float64], own_rad: float = math.inf
) -> Fit:
    unexplained = np.maximum(1.0 - np.square(np.maximum(fits, 0.0)), JOINT.least_unexplained)
    scores = -0.5 * np.log(unexplained).sum(axis=1)
    weights = [key.weight for key in keys]
    slopes, texture = np.average(fits, axis=0, weights=weights)
    score = np.average(scores, weights=weights)
    return Fit(pose, float(slopes), float(texture), float(score), own_rad)
