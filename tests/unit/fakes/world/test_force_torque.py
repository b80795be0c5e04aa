"""What the flange's sensor feels of an object: weight, torque up to the pads' friction; its own errors."""

import numpy as np
import pytest

from drivers.clock import to_ns
from drivers.types import Pose
from fakes.objects.catalogue import find_object
from fakes.wire.ur.geometry import from_pose
from fakes.wire.ur.robot import ForceSensor
from fakes.world.force_torque import NOTHING, FlangeSensor, carried_wrench
from fakes.world.motion import FingerPath, ToolPath, TrapezoidProfile
from fakes.world.slip import GRAVITY
from fakes.world.state import BenchLayout
from fakes.world.world import World
from rig.bench.assembly import TOOL_DOWN

TABLE = Pose((0.45, 0.0, 0.05))
HOME = Pose.from_rotation((0.45, 0.0, 0.25), TOOL_DOWN)
HELD_NS = to_ns(1.0)


def lifted(name: str, site: int, squeeze_m: float, height_m: float) -> World:
    """A world in which an object was grasped at a site, then raised, and is looked at after 1 s."""
    world = World(BenchLayout(TABLE, HOME), seed=3)
    world.place(find_object(name), seed=3)
    model = find_object(name)
    low = Pose.from_rotation(TABLE.translated(x_m=model.sites[site].offset_m).position_m, TOOL_DOWN)
    world.tool = ToolPath.resting(low)
    wide = model.sites[site].width_m + world.variation.width_error_m - squeeze_m
    counts = (world.layout.max_opening_m - wide) / world.layout.opening_per_count_m + world.layout.open_counts
    world.fingers = FingerPath.resting(counts)
    world.state_at(to_ns(0.1))
    world.tool = ToolPath.between(
        low, low.translated(z_m=height_m), TrapezoidProfile(to_ns(0.1), height_m, height_m / 0.5, 10.0)
    )
    world.state_at(HELD_NS)
    return world


def test_a_held_object_pulls_with_its_weight_and_turns_with_weight_times_lever() -> None:
    world = lifted("16", 1, squeeze_m=0.004, height_m=0.03)
    grip = world.grip_at(HELD_NS)
    assert grip is not None
    assert grip[1].holds_turn()
    model = find_object("16")
    weight = model.mass_kg * GRAVITY
    fx, fy, fz, tx, ty, tz = carried_wrench(world, HELD_NS)
    assert (fx, fy, tx, tz) == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-9)
    assert fz == pytest.approx(-weight)
    assert ty == pytest.approx(-weight * model.sites[1].offset_m, rel=1e-3)


@pytest.mark.parametrize(("site", "side"), [(0, -1.0), (2, 1.0)])
def test_a_slipping_object_turns_the_hand_with_the_pads_friction_alone(site: int, side: float) -> None:
    world = lifted("7", site, squeeze_m=0.002, height_m=0.03)
    grip = world.grip_at(HELD_NS)
    assert grip is not None
    state, load = grip
    assert side * state.object_turn_rad > np.radians(5.0)
    fx, _, fz, _, ty, _ = carried_wrench(world, HELD_NS)
    assert ty == pytest.approx(-side * load.turning_limit_nm)
    assert abs(ty) < load.weight_n * abs(load.lever_m)
    assert -load.weight_n < fz < -0.3 * load.weight_n, "the support carries a part"
    assert side * fx < 0.0, "the far end is dragged"


def test_both_simulated_arms_feel_the_same() -> None:
    world = lifted("7", 2, squeeze_m=0.002, height_m=0.03)
    behind_wire, in_process = ForceSensor(world), FlangeSensor(world.seed)
    tcp = from_pose(world.tool_pose_at(HELD_NS))
    expected = in_process.shown(in_process.drifted(carried_wrench(world, HELD_NS), HELD_NS), HELD_NS)
    reading = behind_wire.sense(HELD_NS, tcp)
    assert reading == pytest.approx(expected)
    behind_wire.zero(reading)
    assert behind_wire.sense(HELD_NS, tcp) == pytest.approx(NOTHING, abs=1e-9)
