"""What the simulated world tells a benchmark: which grip would hold, and when the object slipped."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.clock import to_ns
from drivers.types import Pose
from fakes.objects.catalogue import find_object
from fakes.world.motion import FingerPath, ToolPath, TrapezoidProfile
from fakes.world.state import BenchLayout
from fakes.world.world import FINGER_STIFFNESS_N_M, STALL_FORCE_N, World

TABLE = Pose((0.45, 0.0, 0.06))
DOWN = Rotation.from_euler("x", 180, degrees=True)
WRENCH_LEFT_M = -0.05


def world_with(what: str, seed: int = 5) -> World:
    model = find_object(what)
    x, y, z = TABLE.position_m
    at = Pose.from_rotation(np.array((x + model.sites[0].offset_m, y, z)), DOWN)
    world = World(BenchLayout(TABLE, at), seed=3)
    world.place(model, seed=seed)
    return world


def grip(world: World, force_n: float) -> None:
    assert world.model is not None
    layout = world.layout
    width_m = world.model.sites[0].width_m + world.variation.width_error_m
    closed_m = layout.max_opening_m - width_m + force_n / FINGER_STIFFNESS_N_M
    counts = layout.open_counts + closed_m / layout.opening_per_count_m
    world.fingers = FingerPath.resting(counts)


def rise(world: World, since_s: float) -> None:
    """Lift by 50 mm within about a second, from a time on."""
    world.state_at(to_ns(since_s))
    start = world.tool_pose_at(to_ns(since_s))
    profile = TrapezoidProfile(to_ns(since_s), 0.05, 0.06, 0.5)
    world.tool = ToolPath.between(start, start.translated(z_m=0.05), profile)


@pytest.mark.parametrize("seed", range(5))
def test_fingers_that_stall_hold_no_more_than_they_push(seed: int) -> None:
    """The wrench's torque asks for more than the fingers push with, however far they are told to close."""
    world = world_with("wrench", seed)
    assert not world.would_hold(WRENCH_LEFT_M, 250)
    grip(world, STALL_FORCE_N)
    rise(world, 0.1)
    world.state_at(to_ns(1.5))
    assert world.slipped_between(0, to_ns(1.5))


@pytest.mark.parametrize("seed", range(5))
def test_a_grip_that_would_hold_does(seed: int) -> None:
    world = world_with("toothbrush", seed)
    assert world.model is not None
    offset_m = world.model.sites[0].offset_m
    counts = next(n for n in range(1, 60) if world.would_hold(offset_m, n))
    force_n = counts * world.layout.opening_per_count_m * FINGER_STIFFNESS_N_M
    grip(world, force_n)
    rise(world, 0.1)
    world.state_at(to_ns(1.5))
    assert not world.slipped_between(0, to_ns(1.5))
