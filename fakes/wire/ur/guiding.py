"""A person's hand at the simulated arm: it leads the tool as a script says, while the arm gives way."""

import math

from drivers.types import Vector6
from fakes.wire.ur.body import STILL, Body
from fakes.wire.ur.frames import moved

ALL_AXES = (True,) * 6


class GuidingHand:
    """Pushes along a straight way for a while, whether or not the arm gives way."""

    def __init__(self) -> None:
        self._way: Vector6 = STILL
        self._total_s = self._gone_s = 1.0
        self._share = 0.0

    def lead(self, way: Vector6, total_s: float) -> None:
        """Begin to push. way: x y z, m, and rotation vector, rad, base axes, of all of it."""
        self._way, self._total_s, self._gone_s, self._share = way, total_s, 0.0, 0.0

    @property
    def pushing(self) -> bool:
        """Whether it still pushes."""
        return self._gone_s < self._total_s

    def pass_time(self, dt_s: float) -> None:
        """Go on pushing for a cycle: slowly at first and at the end, as hands do."""
        before, self._gone_s = self._gone_s, min(self._gone_s + dt_s, self._total_s)
        self._share = _covered(self._gone_s / self._total_s) - _covered(before / self._total_s)

    def step(self) -> Vector6:
        """How far the tool gives way in this cycle."""
        a, b, c, d, e, f = (self._share * value for value in self._way)
        return a, b, c, d, e, f


def _covered(share_of_time: float) -> float:
    return 0.5 - 0.5 * math.cos(math.pi * share_of_time)


class Guided:
    """teach_mode, freedrive_mode: the arm goes where the hand leads it, and stays where it does not.

    axes: those of the base along and about which it gives way.
    """

    def __init__(self, hand: GuidingHand, axes: tuple[bool, ...] = ALL_AXES) -> None:
        self._hand, self._axes = hand, axes

    def step(self, body: Body, dt_s: float) -> bool:
        """See `ArmMover`."""
        way = [value if free else 0.0 for value, free in zip(self._hand.step(), self._axes, strict=True)]
        if any(way):
            body.follow(moved(body.tcp, tuple(way[:3]), tuple(way[3:])))
        return False
