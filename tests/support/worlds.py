"""Simulated benches: the tool at home, pointing down, and nothing on the table; and a lift of an object."""

from scipy.spatial.transform import Rotation

from drivers.clock import to_ns
from drivers.types import Pose
from fakes.objects.catalogue import find_object
from fakes.world.motion import FingerPath, ToolPath, TrapezoidProfile
from fakes.world.world import BenchLayout, World

DOWN = Rotation.from_euler("x", 180, degrees=True)
TABLE, HOME = Pose((0.45, 0.0, 0.06)), Pose.from_rotation((0.45, 0.0, 0.3), DOWN)


def empty_world(seed: int = 1) -> World:
    return World(BenchLayout(TABLE, HOME), seed)


def lifting_world(name: str, seed: int = 1) -> World:
    """Return a world in which the fingers have closed on an object and lift it from 0.5 s on."""
    model = find_object(name)
    site = model.sites[0]
    start = Pose.from_rotation(TABLE.translated(x_m=site.offset_m).position_m, DOWN)
    world = World(BenchLayout(base_T_table=TABLE, home=start), seed)
    world.place(model)
    layout = world.layout
    counts = layout.open_counts + (layout.max_opening_m - site.width_m) / layout.opening_per_count_m + 4
    world.fingers = FingerPath.resting(counts)
    rising = TrapezoidProfile(to_ns(0.5), 0.08, 0.05, 0.5)
    world.tool = ToolPath.between(start, start.translated(z_m=0.08), rising)
    return world
