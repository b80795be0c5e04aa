"""The parameters of the estimator, from `models/slip.json`. Angles in rad, times in s, lengths in work pixels."""

import json
from dataclasses import dataclass

from rig.tactile.contact.model_files import MODELS

FILE = "slip.json"
Values = dict[str, dict[str, float]]
"""Parameters by group and name."""


@dataclass(slots=True)
class Motion:
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
    rate_s: float


@dataclass(slots=True)
class Alignment:
    slopes_share: float
    broad_share: float
    prior_weight: float
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
    look_s: float
    more_score: float
    rests_rad: float
    most_prior: float
    count_power: float
    check_frames: float
    noise_own: float
    iterations: float
    stride: float


@dataclass(slots=True)
class Keyframes:
    richer: float
    further_rad: float
    least_richness: float
    power: float
    used: float
    torn_ratio: float
    least_count: float
    resting: float
    turning: float


@dataclass(slots=True)
class Sigma:
    loss_rad: float
    spread: float
    least_rad: float
    least_distinct: float
    pace_s: float


@dataclass(slots=True)
class Fusion:
    sticks: float
    anything: float
    correlation: float


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
MOTION, ALIGNMENT = Motion(**_SHIPPED["motion"]), Alignment(**_SHIPPED["alignment"])
KEYFRAMES, SIGMA = Keyframes(**_SHIPPED["keyframes"]), Sigma(**_SHIPPED["sigma"])
FUSION = Fusion(**_SHIPPED["fusion"])
GROUPS = {"motion": MOTION, "alignment": ALIGNMENT, "keyframes": KEYFRAMES, "sigma": SIGMA, "fusion": FUSION}
