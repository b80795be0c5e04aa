"""The simulated external camera: two markers on the object, or a calibration target that is mounted."""

import numpy as np

from drivers.clock import Clock
from drivers.interfaces import Camera
from drivers.types import Image, Pose
from fakes.camera.marker_scene import MarkerScene
from fakes.camera.target_scene import render_sheet
from fakes.devices.source import FakeSource, Shutter
from fakes.faults import FaultScript
from fakes.world.fixture import PrintedSheet, camera_T_target
from fakes.world.state import WorldView


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
        printed: PrintedSheet,
    ) -> None:
        super().__init__((serial, "camera"), shutter, self.draw, clock, faults, world.seed * 8)
        self._world = world
        self._scene = scene
        self._base_T_camera = base_T_camera
        self._camera_T_base = base_T_camera.inverse()
        self._printed = printed

    def draw(self, time_ns: int, rng: np.random.Generator) -> Image:
        """What the sensor sees at `time_ns`, (H, W, 3) uint8 RGB; `rng` makes its noise."""
        fixture = self._world.fixture
        if fixture is None:
            return self._scene.render(self._camera_T_base @ self._world.object_pose_at(time_ns), rng)
        sheet, tool = self._printed(fixture.spec), self._world.tool_pose_at(time_ns)
        table = self._world.layout.base_T_table
        place = camera_T_target(fixture, sheet, self._base_T_camera, table, tool, self._world.seed)
        return render_sheet(sheet, self._scene.camera_matrix, self._scene.size, place, rng)
