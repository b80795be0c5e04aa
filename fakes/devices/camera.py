"""Base class of all simulated cameras (capture schedule, backlog, faults, JPEG), and the external camera."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError, StaleFrameError
from drivers.interfaces import Camera
from drivers.types import Frame, Image, Pose
from fakes.camera.marker_scene import MarkerScene
from fakes.camera.target_scene import render_sheet
from fakes.faults import FaultScript
from fakes.world.fixture import PrintedSheet, camera_T_target
from fakes.world.mirror import WorldView

BACKLOG_FRAMES = 32
"""Number of unread frames that are kept."""
JPEG_QUALITY = 95
Render = Callable[[int, np.random.Generator], Image]


@dataclass(frozen=True, slots=True)
class Shutter:
    """Schedule of a camera: rate, phase relative to other cameras, transport time, and jitter."""

    rate_hz: float
    phase_s: float
    latency_s: float = 0.004
    jitter_s: float = 0.0004


class FakeSource:
    """A source of frames on a schedule, which are rendered when they are read.

    names: serial, then other names that faults may use for it. render: returns the image for a time in ns
    and a generator. seed: of the noise and the jitter. The noise of a frame depends on seed and frame number
    only, so the frame does not depend on when it is read.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        shutter: Shutter,
        render: Render,
        clock: Clock,
        faults: FaultScript,
        seed: int,
    ) -> None:
        self._names = names
        self._shutter = shutter
        self._render = render
        self._clock = clock
        self._faults = faults
        self._seed = seed
        self._next: int | None = None
        self._frozen: Frame | None = None
        self._wobble = np.random.default_rng(seed).uniform(-1.0, 1.0, 509).tolist()

    @property
    def serial(self) -> str:
        """Serial number of the simulated unit."""
        return self._names[0]

    @property
    def rate_hz(self) -> float:
        """Frame rate."""
        return self._shutter.rate_hz

    def connect(self) -> None:
        """Start capturing with the next frame that is due."""
        self._next = max(self._newest_index() + 1, 0)

    def disconnect(self) -> None:
        """Stop capturing."""
        self._next = None

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the oldest unread frame; see `drivers.interfaces.FrameSource`."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while True:
            index = max(self._due_index(), self._newest_index() - BACKLOG_FRAMES + 1)
            arrival = self._captured_ns(index) + to_ns(self._shutter.latency_s)
            if arrival > deadline:
                self._clock.sleep_until(deadline)
                raise DeviceTimeoutError(
                    f"{self.serial}: no frame within {timeout_s:.3g} s; check its cable and USB port"
                )
            self._clock.sleep_until(arrival)
            self._next = index + 1
            if not self._active("drop", index):
                return self._capture(index)

    def newest_frame(self, max_age_s: float) -> Frame:
        """Return the newest frame; see `drivers.interfaces.FrameSource`."""
        self._due_index()
        now_ns = self._clock.now_ns()
        index = max(self._newest_index(), 0)
        # A frame that was dropped leaves the one before it the newest.
        while index > 0 and self._active("drop", index) and self._age_s(index, now_ns) <= max_age_s:
            index -= 1
        age = self._age_s(index, now_ns)
        if age > max_age_s or age < 0 or self._active("drop", index):
            raise StaleFrameError(
                f"{self.serial}: newest frame is {age:.3f} s old, over the limit of {max_age_s:.3f} s; "
                "check that the sensor still streams"
            )
        self._next = index + 1
        return self._capture(index)

    def _age_s(self, index: int, now_ns: int) -> float:
        return (now_ns - self._captured_ns(index)) / NS_PER_S

    def _due_index(self) -> int:
        if self._next is None:
            raise NotConnectedError(f"{self.serial}: read before connect; connect the bench first")
        return self._next

    def _newest_index(self) -> int:
        elapsed_s = self._clock.now_ns() / NS_PER_S - self._shutter.phase_s - self._shutter.latency_s
        return int(np.floor(elapsed_s * self._shutter.rate_hz - 0.5))

    def _captured_ns(self, index: int) -> int:
        wobble_s = self._wobble[index % len(self._wobble)] * self._shutter.jitter_s
        return to_ns(self._shutter.phase_s + (index + 0.5) / self._shutter.rate_hz + wobble_s)

    def _active(self, kind: str, index: int) -> bool:
        return self._faults.active(kind, self._captured_ns(index), *self._names)

    def _capture(self, index: int) -> Frame:
        time_ns = self._captured_ns(index)
        if self._active("disconnect", index):
            raise DeviceError(f"{self.serial}: the device is disconnected; check its cable, then start again")
        if self._active("freeze", index) and self._frozen is not None:
            old = self._frozen
            return Frame(old.image, time_ns, index, self.serial, old.jpeg)
        rng = np.random.Generator(np.random.Philox(key=self._seed, counter=index << 64))
        image = self._render(time_ns, rng)
        self._frozen = _compressed(image, time_ns, index, self.serial)
        return self._frozen


def _compressed(image: Image, time_ns: int, sequence: int, serial: str) -> Frame:
    """Return the frame with its JPEG, encoded as by the device; its image is the decoded JPEG."""
    ok, encoded = cv2.imencode(
        ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    decoded = cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB) if ok else None
    if decoded is None:
        raise DeviceError(f"{serial}: a simulated frame could not be encoded")
    return Frame(np.asarray(decoded, np.uint8), time_ns, sequence, serial, encoded.tobytes())


class FakeCamera(FakeSource, Camera):
    """The external camera; it shows two markers on the object, or the mounted calibration target.

    base_T_camera: its true pose; it looks along the base's y axis. printed: prints the sheets of targets.
    """

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
        """Return the image at `time_ns`, (H, W, 3) uint8 RGB. rng: draws the noise."""
        fixture = self._world.fixture
        if fixture is None:
            return self._scene.render(self._camera_T_base @ self._world.object_pose_at(time_ns), rng)
        sheet, tool = self._printed(fixture.spec), self._world.tool_pose_at(time_ns)
        table = self._world.layout.base_T_table
        place = camera_T_target(fixture, sheet, self._base_T_camera, table, tool, self._world.seed)
        return render_sheet(sheet, self._scene.camera_matrix, self._scene.size, place, rng)
