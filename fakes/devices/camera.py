"""Base class of all simulated cameras (capture schedule, backlog, faults, JPEG), and the external camera."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError, StaleFrameError
from drivers.interfaces import Camera
from drivers.types import Frame, Image, Pose
from fakes.camera.marker_scene import MarkerScene, render_sheet
from fakes.faults import FaultScript
from fakes.gel.variation import decode_jpeg, encode_jpeg
from fakes.world.fixture import PrintedSheet, camera_T_target, nothing_printed
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
        self.serial, self.rate_hz = names[0], shutter.rate_hz
        self._names, self._shutter, self._render = names, shutter, render
        self._clock, self._faults, self._seed = clock, faults, seed
        self._next: int | None = None
        self._frozen: Frame | None = None
        self._wobble = np.random.default_rng(seed).uniform(-1.0, 1.0, 509).tolist()

    def connect(self) -> None:
        self._next = max(self._newest_index() + 1, 0)

    def disconnect(self) -> None:
        self._next = None

    def next_frame(self, timeout_s: float) -> Frame:
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
        self._due_index()
        now_ns, index = self._clock.now_ns(), max(self._newest_index(), 0)

        def age_s() -> float:
            return (now_ns - self._captured_ns(index)) / NS_PER_S

        # A frame that was dropped leaves the one before it the newest.
        while index > 0 and self._active("drop", index) and age_s() <= max_age_s:
            index -= 1
        age = age_s()
        if age > max_age_s or age < 0 or self._active("drop", index):
            raise StaleFrameError(
                f"{self.serial}: newest frame is {age:.3f} s old, over the limit of {max_age_s:.3f} s; "
                "check that the sensor still streams"
            )
        self._next = index + 1
        return self._capture(index)

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
            return replace(self._frozen, time_ns=time_ns, sequence=index)
        rng = np.random.Generator(np.random.Philox(key=self._seed, counter=index << 64))
        data = encode_jpeg(self._render(time_ns, rng), JPEG_QUALITY)
        self._frozen = Frame(decode_jpeg(data), time_ns, index, self.serial, data)
        return self._frozen


CAMERA_MISALIGNMENT = Rotation.from_euler("xyz", (0.8, -0.6, 0.4), degrees=True)
"""Rotation from the camera's pose in the bench file to its true pose; a real bench has such an error too."""

_scene = cache(MarkerScene)
"""Cached, because a scene takes as long as a hundred frames and is the same on every bench."""


@dataclass(frozen=True, slots=True)
class CameraPlan:
    """Description of the external camera, which can be sent to another process.

    base_T_camera: its pose in the bench file. printed: prints the sheets of calibration targets.
    """

    serial: str
    rate_hz: float
    size_px: tuple[int, int]
    focal_px: float
    marker_ids: tuple[int, int]
    marker_side_m: float
    marker_dictionary: str
    base_T_camera: Pose  # noqa: N815
    printed: PrintedSheet = nothing_printed

    def make(self, world: WorldView, clock: Clock, faults: FaultScript) -> "FakeCamera":
        return FakeCamera(self, world, clock, faults)


class FakeCamera(FakeSource, Camera):
    """The external camera; it shows two markers on the object, or the mounted calibration target.

    Its true pose differs from the bench file's by about 1 degree; it looks along the base's y axis.
    """

    def __init__(self, plan: CameraPlan, world: WorldView, clock: Clock, faults: FaultScript) -> None:
        shutter = Shutter(plan.rate_hz, phase_s=0.009, latency_s=0.006)
        super().__init__((plan.serial, "camera"), shutter, self.draw, clock, faults, world.seed * 8)
        self._world, self._printed = world, plan.printed
        self._scene = _scene(
            size=plan.size_px, focal_px=plan.focal_px, marker_ids=plan.marker_ids,
            marker_side_m=plan.marker_side_m, dictionary=plan.marker_dictionary,
            unit_seed=unit_seed(plan.serial),
        )  # fmt: skip
        nominal = plan.base_T_camera
        self._base_T_camera = Pose.from_rotation(nominal.position_m, nominal.rotation * CAMERA_MISALIGNMENT)
        self._camera_T_base = self._base_T_camera.inverse()

    def draw(self, time_ns: int, rng: np.random.Generator) -> Image:
        """Return the image at `time_ns`, (H, W, 3) uint8 RGB. rng: draws the noise."""
        fixture = self._world.fixture
        if fixture is None:
            return self._scene.render(self._camera_T_base @ self._world.object_pose_at(time_ns), rng)
        sheet, tool = self._printed(fixture.spec), self._world.tool_pose_at(time_ns)
        table = self._world.layout.base_T_table
        place = camera_T_target(fixture, sheet, self._base_T_camera, table, tool, self._world.seed)
        return render_sheet(sheet, self._scene.camera_matrix, self._scene.size, place, rng)


def unit_seed(serial: str) -> int:
    """Return the seed of the individual properties of a device."""
    return int.from_bytes(hashlib.sha256(serial.encode()).digest()[:4], "big")
