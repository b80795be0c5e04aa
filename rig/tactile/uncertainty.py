"""How sure an angle is: one standard deviation, of noise and of what is not modelled."""

from rig.tactile.grasp import Tracked

FLOOR_RAD = 0.001
MODEL = 3.0
PER_TURN = 0.005


def angle_variance(tracked: Tracked) -> float:
    """Return the variance of a tracked angle, rad^2."""
    key = tracked.key
    noise = MODEL * tracked.alignment.noise_rad
    return key.variance + FLOOR_RAD**2 + noise**2 + (PER_TURN * tracked.turned_rad) ** 2
