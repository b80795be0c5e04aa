"""An absolute check on a tracked angle: the direction of a long contact.

Every further keyframe adds its error to the angle, and a turn without contact is not observed at all.
The long axis of the contact, known modulo a half turn, is less exact than an alignment, but it shows the
turn since the grasp independently of the frames in between.
"""

import math
from dataclasses import dataclass

import cv2

from drivers.types import Image
from rig.tactile.slip.parameters import SHAPE


@dataclass(frozen=True, slots=True)
class ContactShape:
    """A long contact. axis_rad: image angle of its long axis, modulo pi. ratio: of long to short axis."""

    axis_rad: float
    area_px: float
    ratio: float


@dataclass(frozen=True, slots=True)
class AxisAnchor:
    """The stored long axis of a contact.

    zero_rad: the tracked angle at which the axis has the image angle 0. area_px, ratio: shape of the contact.
    """

    zero_rad: float
    area_px: float
    ratio: float

    def corrected(self, mask: Image, angle_rad: float, variance: float) -> tuple[float, float]:
        """Return angle and variance, corrected by the axis if the angle is less certain than the axis.

        mask: (h, w) uint8, 1 in the contact. variance: rad^2. It never becomes smaller than that of the axis,
        because the errors of the axis are correlated over the frames.
        """
        of_axis = SHAPE.axis_sigma_rad**2
        shape = contact_shape(mask) if variance > of_axis else None
        if shape is None or not self._like(shape):
            return angle_rad, variance
        gap = math.remainder(shape.axis_rad + self.zero_rad - angle_rad, math.pi)
        if abs(gap) > SHAPE.axis_gate_sigmas * math.sqrt(variance + of_axis):
            return angle_rad, variance
        return angle_rad + gap * variance / (variance + of_axis), of_axis

    def _like(self, shape: ContactShape) -> bool:
        """Whether a contact still has the shape for which the axis was stored."""
        pairs = ((shape.area_px, self.area_px), (shape.ratio, self.ratio))
        return all(max(pair) <= SHAPE.axis_same_shape * min(pair) for pair in pairs)


def anchor(mask: Image, angle_rad: float) -> AxisAnchor | None:
    """Return the axis of a contact at a tracked angle; None without a long axis."""
    shape = contact_shape(mask)
    return None if shape is None else AxisAnchor(angle_rad - shape.axis_rad, shape.area_px, shape.ratio)


def contact_shape(mask: Image) -> ContactShape | None:
    """Return the long axis and the shape of a contact; None if it is not long.

    mask: (h, w) uint8, 1 in the contact.
    """
    moments = cv2.moments(mask, True)
    difference, mixed = moments["mu20"] - moments["mu02"], 2.0 * moments["mu11"]
    total, spread = moments["mu20"] + moments["mu02"], math.hypot(difference, mixed)
    if total + spread < SHAPE.axis_ratio**2 * (total - spread) or spread <= 0.0:
        return None
    ratio = math.sqrt((total + spread) / max(total - spread, 1e-9))
    return ContactShape(-0.5 * math.atan2(mixed, difference), moments["m00"], ratio)
