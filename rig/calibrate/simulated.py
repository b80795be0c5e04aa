"""A camera of the simulated bench that sees a calibration target on the tool. SIMULATED."""

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.boards import Target
from calibration.camera_model import CameraModel
from calibration.sheets import target_picture
from drivers.bench import Bench
from drivers.clock import NS_PER_S, seconds
from drivers.errors import NotConnectedError, StaleFrameError
from drivers.interfaces import Camera
from drivers.types import Frame, Pose
from fakes.plan import CAMERA_MISALIGNMENT
from rig.benchmark.board_scenes import Optics, render_target
from rig.config import CameraConfig

_LATENCY_S = 0.006


class TargetCamera(Camera):
    """Draws the target where the simulated arm holds it, from where the camera truly stands."""

    def __init__(self, bench: Bench, config: CameraConfig, target: Target, seed: int) -> None:
        self._bench, self._config, self._target = bench, config, target
        self._rng = np.random.default_rng((seed, 31))
        nominal = config.base_T_camera()
        self.base_T_camera = Pose.from_rotation(nominal.position_m, nominal.rotation * CAMERA_MISALIGNMENT)
        self.tcp_T_target = _held(self.base_T_camera, target, self._rng)
        intrinsics = config.intrinsics()
        size = (config.size_px[0], config.size_px[1])
        self._camera = CameraModel(
            size, np.asarray(intrinsics.camera_matrix), np.asarray(intrinsics.distortion)
        )
        self._sequence: int | None = None

    @property
    def serial(self) -> str:
        """Serial number of the simulated unit."""
        return self._config.serial

    @property
    def rate_hz(self) -> float:
        """Frame rate."""
        return self._config.rate_hz

    def connect(self) -> None:
        """Start capturing."""
        self._sequence = 0

    def disconnect(self) -> None:
        """Stop capturing."""
        self._sequence = None

    def next_frame(self, timeout_s: float) -> Frame:
        """The next frame due, see `drivers.interfaces.FrameSource`."""
        clock = self._bench.clock
        clock.sleep_until(clock.now_ns() + round(NS_PER_S / self.rate_hz))
        captured = clock.now_ns()
        clock.sleep_until(captured + seconds(_LATENCY_S))
        return self._frame(captured)

    def newest_frame(self, max_age_s: float) -> Frame:
        """A frame of just now, see `drivers.interfaces.FrameSource`."""
        if max_age_s < _LATENCY_S:
            raise StaleFrameError(
                f"{self.serial}: newest frame is {_LATENCY_S} s old, asked for {max_age_s} s"
            )
        return self._frame(self._bench.clock.now_ns())

    def _frame(self, time_ns: int) -> Frame:
        if self._sequence is None:
            raise NotConnectedError(f"{self.serial}: read before connect; connect the bench first")
        self._sequence += 1
        base_T_tcp = self._bench.arm.state().base_T_tcp  # noqa: N806
        camera_T_target = self.base_T_camera.inverse() @ base_T_tcp @ self.tcp_T_target  # noqa: N806
        grey = render_target(self._target, self._camera, camera_T_target, self._rng, Optics(0.8, 1.5))
        return Frame(np.dstack([grey] * 3), time_ns, self._sequence, self.serial)


def _held(base_T_camera: Pose, target: Target, rng: np.random.Generator) -> Pose:  # noqa: N803
    """The target on a tool that points down: its middle a few cm off, facing the camera, not exactly."""
    facing = Rotation.from_euler("x", 180, degrees=True).inv() * base_T_camera.rotation
    tilt = Rotation.from_rotvec(rng.normal(0, 0.1, 3))
    turn = facing * tilt
    picture = target_picture(target.spec)
    middle = picture.origin_m + np.array(picture.grey.shape[::-1]) / picture.px_per_m / 2.0
    place = rng.normal((0.0, 0.0, -0.03), 0.005) - turn.apply([*middle, 0.0])
    return Pose.from_rotation(place, turn)
