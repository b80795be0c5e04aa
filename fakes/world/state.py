"""The state of the simulated world, the random variation of a lift, and the pose of the object."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.clock import NS_PER_S
from drivers.types import Pose, Vector3
from fakes.objects.catalogue import GraspSite


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
    values: dict[str, float] = {}
    if before.held == after.held:
        for name in _INTERPOLATED:
            start, end = getattr(before, name), getattr(after, name)
            values[name] = start + f * (end - start)
    return replace(after, time_ns=time_ns, **values)
