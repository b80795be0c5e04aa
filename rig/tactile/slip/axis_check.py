"""An absolute check on a tracked angle: the direction of a long contact.

Every further keyframe adds its error to the angle, and a turn that nobody saw is not known at all.
The long axis of the contact, known modulo a half turn, is less exact than an alignment, but what it
says of the turn since the grasp does not depend on what happened in between.
"""

import math
from dataclasses import dataclass

import cv2

from drivers.types import Image

# Ratio of long to short axis (of the ellipse with the contact's second moments) from which on the
# axis is asked; over simulated lifts it is then 0.65 degrees off, rms, and below 1.3 up to 2 degrees.
LEAST_RATIO = 1.5
# Taken for one standard deviation: a load that shifts draws the contact's outline too.
SIGMA_RAD = math.radians(1.5)
# An axis further off than this many standard deviations belongs to a contact of another shape.
GATE_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class AxisAnchor:
    """The tracked angle at which the contact's long axis had the image angle 0, rad."""

    zero_rad: float

    def corrected(self, mask: Image, angle_rad: float, variance: float) -> tuple[float, float]:
        """Return angle and variance, bounded by the axis where the angle is less sure than that.

        mask: (h, w) uint8, 1 in the contact. variance: rad^2. The variance never falls below the
        axis's own, whose error is the same each time.
        """
        axis = long_axis(mask) if variance > SIGMA_RAD**2 else None
        if axis is None:
            return angle_rad, variance
        gap = math.remainder(axis + self.zero_rad - angle_rad, math.pi)
        if abs(gap) > GATE_SIGMAS * math.sqrt(variance + SIGMA_RAD**2):
            return angle_rad, variance
        return angle_rad + gap * variance / (variance + SIGMA_RAD**2), SIGMA_RAD**2


def anchor(mask: Image, angle_rad: float) -> AxisAnchor | None:
    """Note the axis of a contact at a tracked angle; None where it has no long axis."""
    axis = long_axis(mask)
    return None if axis is None else AxisAnchor(angle_rad - axis)


def long_axis(mask: Image) -> float | None:
    """Return the image angle of a contact's long axis, rad modulo pi; None where it is not long.

    mask: (h, w) uint8, 1 in the contact.
    """
    moments = cv2.moments(mask, True)
    difference, mixed = moments["mu20"] - moments["mu02"], 2.0 * moments["mu11"]
    total, spread = moments["mu20"] + moments["mu02"], math.hypot(difference, mixed)
    if total + spread < LEAST_RATIO**2 * (total - spread) or spread <= 0.0:
        return None
    return -0.5 * math.atan2(mixed, difference)
