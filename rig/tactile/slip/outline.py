"""The outline of a contact as a second measurement of its rotation.

A thin edge has little texture, and its slopes are those of a narrow ridge: both may turn too little. The long
axis of the contact's region turns with the object, however faint the contact is. On round contacts the axis
is uncertain; then it does not count.
"""

import math
from dataclasses import dataclass

import cv2

from drivers.types import Image

AXIS_RAD = math.radians(6.0)
"""Standard deviation of the axis of a region with elongation e, times e - 1/e. Errors of the axis in this
unit, at elongations above 1.15: 6.8 degrees in the median for `digit-edges`, 8.5 for the development clips,
0.7 on SIMULATED lifts. With half or twice the value, the angles are as good."""
LEAST_ELONGATION = 1.05
"""Rounder regions have no axis: its standard deviation would exceed 60 degrees."""


@dataclass(frozen=True, slots=True)
class Axis:
    """The long axis of a region.

    angle_rad: direction, counter-clockwise from the x axis, modulo pi. elongation: ratio of the standard
    deviations along and across it, at least 1.
    """

    angle_rad: float
    elongation: float


def axis_of(mask: Image) -> Axis:
    """Return the axis of a region from its second moments. mask: (h, w) uint8, nonzero inside."""
    moments = cv2.moments(mask, binaryImage=True)
    along_x, along_y, mixed = moments["mu20"], moments["mu02"], moments["mu11"]
    mean, half = 0.5 * (along_x + along_y), math.hypot(0.5 * (along_x - along_y), mixed)
    # The image's y axis points down.
    angle_rad = -0.5 * math.atan2(2.0 * mixed, along_x - along_y)
    return Axis(angle_rad, math.sqrt((mean + half) / max(mean - half, 1e-9 * mean, 1e-9)))


class Outline:
    """Corrects the angle of a settled contact by the rotation of its axis since it settled."""

    def __init__(self) -> None:
        self._origin: tuple[Axis, float] | None = None

    def forget(self) -> None:
        """Count from the next frame on: the contact has ended, or its shape has changed."""
        self._origin = None

    def correct(self, angle_rad: float, variance: float, mask: Image) -> tuple[float, float]:
        """Return the mean of an angle and of the axis, weighted by their variances (rad^2), and its variance.

        The difference of both counts as uncertainty of the axis, because a region may also change its shape.
        An axis that has turned less, by more than its deviation, may be that of the resting gel: it does not
        count.
        """
        axis = axis_of(mask)
        if self._origin is None:
            self._origin = axis, angle_rad
        first, first_rad = self._origin
        elongation = min(axis.elongation, first.elongation)
        if elongation < LEAST_ELONGATION:
            return angle_rad, variance
        turned_rad = angle_rad - first_rad
        away_rad = math.remainder(axis.angle_rad - first.angle_rad - turned_rad, math.pi)
        deviation_rad = AXIS_RAD / (elongation - 1.0 / elongation)
        if abs(turned_rad + away_rad) < abs(turned_rad) - deviation_rad:
            return angle_rad, variance
        axis_variance = deviation_rad**2 + away_rad**2
        share = variance / (variance + axis_variance)
        return angle_rad + share * away_rad, share * axis_variance
