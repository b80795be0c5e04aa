"""An empty simulated bench: the tool at home, pointing down, and nothing on the table."""

from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.world.world import BenchLayout, World

DOWN = Rotation.from_euler("x", 180, degrees=True)
TABLE, HOME = Pose((0.45, 0.0, 0.06)), Pose.from_rotation((0.45, 0.0, 0.3), DOWN)


def empty_world(seed: int = 1) -> World:
    return World(BenchLayout(TABLE, HOME), seed)
