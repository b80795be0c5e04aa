"""The simulated external camera: two markers on the object, seen at a slant."""

import numpy as np

from drivers.clock import Clock
from drivers.interfaces import Camera
from drivers.types import Image, Pose
from fakes.faults import FaultScript
from fakes.moment import WorldView
from fakes.scene import MarkerScene
from fakes.source import FakeSource, Shutter


class FakeCamera(FakeSource, Camera):
    """Looks along the base's y axis from `base_T_camera`, which is where it truly stands."""

    def __init__(
        self,
        world: WorldView,
        clock: Clock,
        faults: FaultScript,
        serial: str,
        shutter: Shutter,
        scene: MarkerScene,
        base_T_camera: Pose,  # noqa: N803
    ) -> None:
        super().__init__((serial, "camera"), shutter, self.draw, clock, faults, world.seed * 8)
        self._world = world
        self._scene = scene
        self._camera_T_base = base_T_camera.inverse()

    def draw(self, time_ns: int, rng: np.random.Generator) -> Image:
        """What the sensor sees at `time_ns`, (H, W, 3) uint8 RGB; `rng` makes its noise."""
        return self._scene.render(self._camera_T_base @ self._world.object_pose_at(time_ns), rng)
