"""The parameters of the estimator's likelihoods and of its motion model, which `rig fit-slip` fits.

They are in `models/slip.json`, with the data of the last fit and the names of the parameters that it tried.
Angles are in rad, times in s, lengths in work pixels. "Score" and
"correlation" are those of `rig.tactile.slip.evidence.Fit`, "misfit" and "overlap" those of
`rig.tactile.slip.registration.Alignment`.
"""

import json
from dataclasses import dataclass

from rig.tactile.contact.model_files import MODELS

FILE = "slip.json"
Values = dict[str, dict[str, float]]
"""Parameters by group and name."""


@dataclass(slots=True)
class Motion:
    """The prior of the motion.

    moving_density, rest_density: spectral density of the angular acceleration, rad^2/s^3, while an object
    slips and at rest (creep). calming_s: time constant of the transition from slip to rest. moves_sigmas:
    slip begins if the sum of the last normalised innovations exceeds this many of its standard deviations.
    noise_ratio: of the angle's noise to that of independent pixels. least_noise_rad: smallest noise of an
    angle. first_rate_rad_s: standard deviation of the first rate. horizon_s: longest time over which a rate
    is extrapolated. acceleration_rad_s2: standard deviation of the acceleration of an object that is not
    seen. most_shift_px: largest predicted shift of a contact per frame. joint_rate_s: time constant of the
    joint tracker's predicted rate.
    """

    moving_density: float
    rest_density: float
    calming_s: float
    moves_sigmas: float
    noise_ratio: float
    least_noise_rad: float
    first_rate_rad_s: float
    horizon_s: float
    acceleration_rad_s2: float
    most_shift_px: float
    joint_rate_s: float


@dataclass(slots=True)
class Slopes:
    """The alignment of slopes alone.

    broad_share: part of the local mean that is subtracted from slopes. steep_share: a gradient of this
    multiple of the rms length has half of the weight. depth_share: keyframes use the part of a dent that is
    deeper than this fraction of its depth. robust_width: residuals above this multiple of their median get
    decreasing weights. systematic_rad, floor_rad: sigma of model errors (for misfit and contrast 1) and its
    lowest value. good_misfit, good_overlap: limits of a good alignment, else a keyframe is taken;
    unsettled_misfit: the same for one that has not converged. worst_misfit, worst_overlap: limits of a used
    alignment. plain_misfit: up to this misfit the slopes are those of the object, unless the texture is
    clearly better.
    """

    broad_share: float
    steep_share: float
    depth_share: float
    robust_width: float
    systematic_rad: float
    floor_rad: float
    good_misfit: float
    good_overlap: float
    unsettled_misfit: float
    worst_misfit: float
    worst_overlap: float
    plain_misfit: float


@dataclass(slots=True)
class Texture:
    """The alignment of slopes and texture together, with one keyframe.

    The weight of texture grows from least_count to 1 between the fractions resting and turning that the
    network predicts. rest_share, noise_share: a point whose change, had nothing moved, is rest_share of its
    energy plus noise_share of the mean energy has half of the weight. noise_rad: noise of the angle from
    frame to frame. lost_score: a contact with a lower score is lost.

    The texture leads if its score is higher than that of the slopes by more_score, or by more_than_ample if
    that of the slopes is at least ample_score. If it leads already with the correlation firm, an equal score
    suffices: just after a keyframe a resting bulge fits perfectly.

    older_score, same_rad: an older keyframe corrects the newest one if it has this score and its angle
    differs by at most same_rad. slopes_sigma_rad, sigma_rad: sigma of the angle that slopes (of contrast 1)
    or texture show alone, times the root of the unexplained share; least_correlation, least_sigma_rad:
    lowest correlation and sigma there. A keyframe is used up to next_key_rad with the score kept_score, and
    up to furthest_key_rad if both channels have the correlation kept.
    """

    least_count: float
    resting: float
    turning: float
    rest_share: float
    noise_share: float
    noise_rad: float
    lost_score: float
    more_score: float
    ample_score: float
    more_than_ample: float
    firm: float
    older_score: float
    same_rad: float
    slopes_sigma_rad: float
    sigma_rad: float
    least_correlation: float
    least_sigma_rad: float
    next_key_rad: float
    kept_score: float
    kept: float
    furthest_key_rad: float


@dataclass(slots=True)
class Keyframes:
    """The keyframes of the keyframe tracker.

    near_rad: keyframes are used up to this rotation. same_sigmas: angles that differ by more standard
    deviations contradict each other. A growing contact gets a keyframe when it has changed by renewed_share,
    and another when it has settled. torn_ratio: ratio of areas from which on a frame is torn. give_up_s: time
    without a fitting keyframe after which a settled contact gets a new one.
    """

    near_rad: float
    same_sigmas: float
    renewed_share: float
    torn_ratio: float
    give_up_s: float


@dataclass(slots=True)
class Joint:
    """The joint tracker.

    slopes_share: weight of the slopes; that of the texture is 1. broad_share: as in `Slopes`, for the slopes
    of this tracker. prior_weight: of the squared distance from the predicted angle,
    1/rad^2. least_unexplained: smallest residual share in a score. Below good_score, or further than
    surprise_rad from the prediction, four further initial angles are tried, aside_rad apart. A keyframe is
    added if it is richer than all others by the factor richer, or further than further_rad from all others.
    Keyframes below the fraction least_richness of the richest are not used.
    """

    slopes_share: float
    broad_share: float
    prior_weight: float
    least_unexplained: float
    good_score: float
    surprise_rad: float
    aside_rad: float
    richer: float
    further_rad: float
    least_richness: float


@dataclass(slots=True)
class Fusion:
    """The fusion of both trackers, and of the fingertips.

    weight_s, offset_s: time constants of the joint tracker's weight and offset. least_score: lowest score at
    which it is used. unknown_gap_rad, unknown_sigma_rad: gap and sigma where the other tracker has no answer.
    most_own_rad, least_own_score: limits of the joint tracker's own sigma and of the score that divides it.
    least_richness: lowest richness in the variance. constant_rad, gap, sigma, own_sigma, faint_rad: factors
    of sigma where the texture leads: a constant, the gap between the trackers, the sigma of the keyframe
    tracker, that of the joint tracker, and the inverse richness. sigma_pace_s: time constant of the reported
    sigma.

    sticks: probability that a fingertip follows the resting gel. anything: fraction of such angles that are
    arbitrary. correlation: of the errors of two fingertips.
    """

    weight_s: float
    offset_s: float
    least_score: float
    unknown_gap_rad: float
    unknown_sigma_rad: float
    most_own_rad: float
    least_own_score: float
    least_richness: float
    constant_rad: float
    gap: float
    sigma: float
    own_sigma: float
    faint_rad: float
    sigma_pace_s: float
    sticks: float
    anything: float
    correlation: float


@dataclass(slots=True)
class Shape:
    """Sigma due to the shape of a contact, and its long axis.

    pivot_share: distance of an arc's pivot from the middle, one sigma, as a fraction of the radius of a
    circle of equal area. axis_ratio: smallest ratio of the axes of a long contact; axis_sigma_rad: sigma of
    its long axis. The contact has another shape if the axis differs by more than axis_gate_sigmas, or its
    area or ratio by more than the factor axis_same_shape. missed_rad: sigma of the rotation that is missed
    on a round contact of the trace missed_trace; for larger traces it decreases with the power
    missed_power.
    """

    pivot_share: float
    axis_ratio: float
    axis_sigma_rad: float
    axis_gate_sigmas: float
    axis_same_shape: float
    missed_rad: float
    missed_trace: float
    missed_power: float


def shipped() -> Values:
    """Return the parameters that come with the product."""
    found: Values = json.loads((MODELS / FILE).read_text())["parameters"]
    return found


def use(values: Values) -> None:
    """Replace all parameters in this process. Estimators that exist should not be used any more."""
    for name, group in GROUPS.items():
        for parameter, value in values[name].items():
            setattr(group, parameter, value)


_SHIPPED = shipped()
MOTION = Motion(**_SHIPPED["motion"])
SLOPES = Slopes(**_SHIPPED["slopes"])
TEXTURE = Texture(**_SHIPPED["texture"])
KEYFRAMES = Keyframes(**_SHIPPED["keyframes"])
JOINT = Joint(**_SHIPPED["joint"])
FUSION = Fusion(**_SHIPPED["fusion"])
SHAPE = Shape(**_SHIPPED["shape"])
GROUPS = {
    "motion": MOTION,
    "slopes": SLOPES,
    "texture": TEXTURE,
    "keyframes": KEYFRAMES,
    "joint": JOINT,
    "fusion": FUSION,
    "shape": SHAPE,
}
"""The parameters in use, by the names in the file."""
