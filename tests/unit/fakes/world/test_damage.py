"""A soft object keeps the mark of an over-tight grip, and no sensor shows it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.objects.catalogue import find_object
from fakes.world.motion import FingerPath
from fakes.world.state import BenchLayout
from fakes.world.world import FINGER_STIFFNESS_N_M, World

TABLE = Pose((0.45, 0.0, 0.06))
DOWN = Rotation.from_euler("x", 180, degrees=True)
HELD_NS = 20_000_000


def gripped(what: str, force_n: float) -> World:
    """A world whose fingers press an object at its first site with so much force."""
    model = find_object(what)
    site = model.sites[0]
    x, y, z = TABLE.position_m
    layout = BenchLayout(TABLE, Pose.from_rotation(np.array((x + site.offset_m, y, z)), DOWN))
    world = World(layout, seed=3)
    world.place(model, seed=5)
    width = site.width_m + world.variation.width_error_m
    closed_m = layout.max_opening_m - width + force_n / FINGER_STIFFNESS_N_M
    counts = layout.open_counts + closed_m / layout.opening_per_count_m
    world.fingers = FingerPath.resting(counts)
    assert world.state_at(HELD_NS).force_n == pytest.approx(force_n, rel=0.05)
    return world


def test_grip_below_the_damage_force_leaves_no_mark() -> None:
    assert not gripped("banana", 5.0).damaged


def test_an_over_tight_grip_marks_a_soft_object_until_another_is_laid_down() -> None:
    world = gripped("banana", 8.0)
    assert world.damaged
    world.place(find_object("banana"))
    assert not world.damaged
