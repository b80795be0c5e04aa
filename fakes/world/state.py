"""The state of the simulated world, the random variation of a lift, the pose and the slip of the object.

During a lift the far end of the object stays on its support while the grasp rises, so the support forces the
object to the angle asin(height / reach). The grip follows in stick and slip: the gel is twisted up to a
threshold, the object slips at a bounded rate, then sticks again (paper, section IV-B, phases A to C). If the
friction torque of the grip exceeds the torque of the weight, the object keeps its angle, and the twisted gel
relaxes.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.clock import NS_PER_S
from drivers.types import Pose, Vector3
from fakes.objects.catalogue import GraspSite

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


@dataclass(frozen=True, slots=True)
class BenchLayout:
    """Poses on the simulated bench (base frame, m), and the range of the fingers."""

    base_T_table: Pose  # noqa: N815
    home: Pose
    open_counts: int = 6
    """Position when fully open; it is a software limit, not 0 (manual, gPO)."""
    max_opening_m: float = 0.120
    """Largest distance between the gels: the two DIGITs take 35 mm of the gripper's nominal 155 mm."""
    opening_per_count_m: float = 0.155 / 249.0
    closed_counts: int = 255
    """Highest position that may be commanded."""
    floor_z_m: float = 0.0
    """Height of the tool at which the fingertips touch the table."""


@dataclass(frozen=True, slots=True)
class WorldState:
    """State of the world at one instant; angles are in rad, counter-clockwise positive in the camera image.

    force_n: normal force per finger. object_turn_rad: rotation of the object. wrist_rad: rotation of the
    tool. torsion_rad: torsion of the gel under the object. slide_m: slide of the object down
    the pads. loaded: fraction of the weight on the pads, 0 to 1. held: whether the object is held.
    """

    time_ns: int
    force_n: float
    object_turn_rad: float
    wrist_rad: float
    torsion_rad: float
    slide_m: float
    loaded: float
    held: bool


@dataclass(frozen=True, slots=True)
class LiftVariation:
    """Random differences between lifts, drawn from the seed of the world."""

    misplacement_m: tuple[float, float]
    width_error_m: float
    friction_factor: float
    pivot_mm: tuple[float, float]
    tilt_at_rest: tuple[float, float]
    tilt_under_load: tuple[float, float]
    force_shift: float
    sway_phase: float

    @classmethod
    def from_rng(cls, rng: np.random.Generator) -> "LiftVariation":
        def pair(spread: float) -> tuple[float, float]:
            return float(rng.normal(0.0, spread)), float(rng.normal(0.0, spread))

        return cls(
            misplacement_m=pair(0.0008),
            width_error_m=float(rng.normal(0.0, 0.0004)),
            friction_factor=float(rng.uniform(0.8, 1.2)),
            pivot_mm=pair(1.2),
            tilt_at_rest=pair(0.008),
            tilt_under_load=pair(0.012),
            force_shift=float(rng.normal(0.0, 0.12)),
            sway_phase=float(rng.uniform(0.0, 2 * math.pi)),
        )


@dataclass(frozen=True, slots=True)
class Grasp:
    """How an object is held. off_m: offset of the tool from the site's centre, along the base's x and up."""

    site: GraspSite
    off_m: tuple[float, float] = (0.0, 0.0)


HAND_TURN = ((3.0, 0.83), (2.0, 1.37), (1.5, 0.29))
"""Irregular motion of a person who turns an object to and fro: amplitudes in degrees, frequencies in Hz."""


def hand_turn_rad(time_ns: int) -> float:
    """Return how far a person has turned an object by hand at a time."""
    time_s = time_ns / NS_PER_S
    return math.radians(sum(size * math.sin(2.0 * math.pi * hz * time_s) for size, hz in HAND_TURN))


def object_pose(
    layout: BenchLayout, variation: LiftVariation, grasp: Grasp | None, state: WorldState, tool_m: Vector3
) -> Pose:
    """Return `base_T_object`: origin at the centre of mass, x along the object, z up.

    grasp: how the object is held; None while it lies on the table. tool_m: position of the TCP in the base
    frame.
    """
    right, down = variation.misplacement_m
    if not state.held or grasp is None:
        return layout.base_T_table.translated(x_m=right, z_m=-down)
    turn = Rotation.from_euler("y", -state.object_turn_rad)
    off_x, off_z = grasp.off_m
    place = np.add(tool_m, (right - off_x, 0.0, -down - state.slide_m - off_z))
    return Pose.from_rotation(place - turn.apply((grasp.site.offset_m, 0.0, 0.0)), turn)


_INTERPOLATED = ("force_n", "object_turn_rad", "wrist_rad", "torsion_rad", "slide_m", "loaded")


def between(before: WorldState, after: WorldState, time_ns: int) -> WorldState:
    """Return the state at `time_ns`, linearly interpolated between two states."""
    f = (time_ns - before.time_ns) / (after.time_ns - before.time_ns)
    ends = {name: (getattr(before, name), getattr(after, name)) for name in _INTERPOLATED}
    values = {name: start + f * (end - start) for name, (start, end) in ends.items()}
    return replace(after, time_ns=time_ns, **(values if before.held == after.held else {}))
