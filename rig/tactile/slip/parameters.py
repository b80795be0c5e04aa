"""The parameters of `slip`, from `models/slip.json`: angles in rad, times in s, lengths in work pixels."""

import json
import math
from dataclasses import dataclass

from rig.tactile.contact.model_files import MODELS

MOST_RATE_RAD_S = math.radians(200.0)
"""Highest rotation rate of an object in a gripper."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Prediction of the pose.

    horizon_s: longest extrapolation. acceleration_rad_s2: of rotations that are not observed. rate_s: time
    over which the rate is averaged.
    """

    horizon_s: float
    acceleration_rad_s2: float
    rate_s: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignment of a frame to the keyframes.

    slopes_share: weight of the slopes beside the texture in the first reading. broad_share: part of the
    broad slopes that is subtracted. rest_share, noise_share: likelihood of points that rest with the gel,
    and their noise, in squares of the template. good_score, most_loss, surprise_rad, check_s: a better
    pose is searched for if a fit is worse than this fraction of the usual score, loses more agreement of
    the curvature, has turned by more since the last frame, or was not checked for this time.
    score_of_loss: weight of the loss in the rank. aside_rad: distance of further starts. least_score,
    give_up_s: a joint fit below is none; the contact begins again after this time without one. network_s,
    look_s: period of the network, and of the texture while the slopes lead. steep_share: slopes above this
    fraction of the root mean square get less weight. plain_fit, growing_fit: correlation of the slopes from
    which on they explain the frame alone, of a settled contact and of one that grows. more_score: the
    texture takes the lead if the rank of the joint fit exceeds that of the slopes by this; it loses the
    lead if its rank is lower. most_prior, count_power: prior weight of slopes at turning texture.
    iterations: most steps. closing_rank, closing_gain: a direct alignment to an old keyframe corrects the
    pose if its rank is as high, and higher than at the pose.
    """

    slopes_share: float
    broad_share: float
    rest_share: float
    noise_share: float
    good_score: float
    most_loss: float
    score_of_loss: float
    surprise_rad: float
    aside_rad: float
    least_score: float
    give_up_s: float
    network_s: float
    steep_share: float
    plain_fit: float
    growing_fit: float
    look_s: float
    more_score: float
    most_prior: float
    count_power: float
    check_s: float
    iterations: float
    closing_rank: float
    closing_gain: float


@dataclass(frozen=True, slots=True)
class Keyframes:
    """Keyframes, and weights by the network.

    richer, further_rad, grown: a frame with this many times the texture of the richest keyframe, that has
    turned by more from all, or, before the contact has settled, has this many times the area of the newest
    one, becomes one. least_richness, power, used: fraction of the richest one's texture below
    which a keyframe is not used, exponent of its weight, and number of those used. torn_ratio: ratio of areas
    from which on a frame is torn. least_count, resting, turning: least weight of texture, and the network's
    answers that give the least and the full weight.
    """

    richer: float
    further_rad: float
    grown: float
    least_richness: float
    power: float
    used: float
    torn_ratio: float
    least_count: float
    resting: float
    turning: float


@dataclass(frozen=True, slots=True)
class Sigma:
    """Standard deviation of the angle.

    worst_loss_rad: per largest loss of agreement of the curvature, see `Tracked`.
    worst_spread: per largest difference between the readings. least_rad: in any case. least_distinct,
    least_textured, textured_oblong, least_oblong, cut_distinct, cut_oblong: see `Keyframe.observable`;
    smooth balls have less. pace_s: time over which sigma follows.
    """

    worst_loss_rad: float
    worst_spread: float
    least_rad: float
    least_distinct: float
    least_textured: float
    textured_oblong: float
    least_oblong: float
    cut_distinct: float
    cut_oblong: float
    pace_s: float


@dataclass(frozen=True, slots=True)
class Fusion:
    """Fusion of two fingertips, see `rig.lift.object_angle`.

    sticks, anything: probability that a fingertip follows the resting gel, and that it is anything.
    correlation: of the errors of both.
    """

    sticks: float
    anything: float
    correlation: float


_SHIPPED: dict[str, dict[str, float]] = json.loads((MODELS / "slip.json").read_text())["parameters"]
MOTION, ALIGNMENT = Motion(**_SHIPPED["motion"]), Alignment(**_SHIPPED["alignment"])
KEYFRAMES, SIGMA = Keyframes(**_SHIPPED["keyframes"]), Sigma(**_SHIPPED["sigma"])
FUSION = Fusion(**_SHIPPED["fusion"])
