"""Simulate the rotation of a held object between two fingers during one lift.

The far end of the object stays on its support while the grasp rises, so the support forces the object to the
angle asin(height / reach). The grip follows in stick and slip: the gel is twisted up to a threshold, the
object slips at a bounded rate, then sticks again (paper, section IV-B, phases A to C). If the friction torque
of the grip exceeds the torque of the weight, the object keeps its angle, and the twisted gel relaxes.
"""

import math
from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81
SLIDE_M_PER_RAD = 0.002
"""Slide down the pads per rotation: about 1 mm for a slip of 30 degrees."""
PAD_M = 0.012
"""Slide after which the object has left the pads."""
TORSION_LIMIT_RAD = math.radians(1.5)
"""Largest torsion of the gel."""
TORSION_RELAXES_S = 0.8
"""Time constant of the relaxation of the torsion."""


@dataclass(frozen=True, slots=True)
class GripLoad:
    """The load on the grip.

    force_n: normal force per finger. weight_n: of the object. friction: coefficient. patch_radius_m: radius
    of the contact. lever_m: from the centre of mass to the grasp, positive if the grasp is on the object's
    right (+x). reach_m: distance from the grasp to the end that stays on the support.
    """

    force_n: float
    weight_n: float
    friction: float
    patch_radius_m: float
    lever_m: float
    reach_m: float

    @property
    def sliding_limit_n(self) -> float:
        """Largest friction force of both pads."""
        return 2.0 * self.friction * self.force_n

    @property
    def turning_limit_nm(self) -> float:
        """Largest friction torque of both pads, for circular contacts of uniform pressure."""
        return self.sliding_limit_n * (2.0 / 3.0) * self.patch_radius_m

    def holds_turn(self) -> bool:
        """Whether friction carries the torque of the weight."""
        return self.turning_limit_nm >= self.weight_n * abs(self.lever_m)

    def holds_weight(self) -> bool:
        """Whether friction carries the part of the weight that is not on the support."""
        share = 1.0 if self.holds_turn() else 1.0 - min(abs(self.lever_m) / self.reach_m, 1.0)
        return self.sliding_limit_n >= share * self.weight_n


@dataclass(slots=True)
class SlipDynamics:
    """State of one grip: rotation (rad, counter-clockwise positive in the camera image), torsion, slide."""

    rng: np.random.Generator
    angle_rad: float = 0.0
    torsion_rad: float = 0.0
    slide_m: float = 0.0
    fallen: bool = False
    slipping: bool = False
    creep_rad: float = 0.0
    _threshold_rad: float = math.radians(0.4)
    _rate_rad_s: float = math.radians(30.0)

    def step(self, load: GripLoad, height_m: float, dt_s: float) -> None:
        """Advance by `dt_s`. height_m: height of the grasp above the position where the fingers closed."""
        before = self.angle_rad
        if height_m > 0.0 and not load.holds_weight():
            self.slide_m = min(self.slide_m + max(0.02, 3.0 * self.slide_m) * dt_s, PAD_M)
            self.fallen = self.slide_m >= PAD_M
        elif load.holds_turn():
            # the grip carries the torque, so a slip ends; set down, the support turns the object back
            self.slipping = False
            wound_up = min(height_m / 0.01, 1.0) * math.radians(0.3)
            turned = max(min(abs(self.angle_rad), _demand(load, height_m)), wound_up)
            self.angle_rad = math.copysign(turned, load.lever_m)
        else:
            self._stick_slip(load, height_m, dt_s)
        # the gel twists with the object up to a limit, and relaxes
        turned_rad = self.angle_rad - before
        wound = min(abs(self.torsion_rad) / TORSION_LIMIT_RAD, 1.0)
        drag = 1.0 - wound if turned_rad * self.torsion_rad > 0.0 else 1.0
        self.torsion_rad += 0.5 * turned_rad * drag - self.torsion_rad * dt_s / TORSION_RELAXES_S
        self.slide_m += SLIDE_M_PER_RAD * abs(turned_rad)

    def _stick_slip(self, load: GripLoad, height_m: float, dt_s: float) -> None:
        demand = _demand(load, height_m)
        turned = abs(self.angle_rad)
        if self.slipping:
            turned += self._rate_rad_s * dt_s
            if turned >= demand:
                turned, self.slipping = demand, False
                self._threshold_rad = math.radians(min(self.rng.lognormal(-1.0, 0.7), 2.5))
        elif demand - turned > self._threshold_rad:
            self.slipping = True
            self._rate_rad_s = math.radians(self.rng.uniform(25.0, 60.0))
        elif demand < turned:
            turned = demand
        else:
            turned = min(turned + self.creep_rad * math.exp(-turned) * dt_s, demand)
        self.angle_rad = math.copysign(turned, load.lever_m)


def _demand(load: GripLoad, height_m: float) -> float:
    """Return the angle to which the support forces the object, rad."""
    return math.asin(min(max(height_m, 0.0) / load.reach_m, 0.95))
