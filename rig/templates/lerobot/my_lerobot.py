"""The rig's tactile sensors as LeRobot cameras, and their angle in the observations of any LeRobot robot.

For lerobot 0.4 to 0.6. `tactile` is a camera: a sensor of a bench file. `with_touch` is a robot: one of
LeRobot's robots, with tactile sensors whose images and angles are added to its observations.
"""

from dataclasses import dataclass, field
from typing import Any

import draccus
from lerobot.cameras import Camera, CameraConfig
from lerobot.robots import Robot, RobotConfig, make_robot_from_config

from drivers.errors import DeviceTimeoutError, StaleFrameError
from rig.python.fingertip import LiveFingertip

UNKNOWN_SIGMA_DEG = 180.0  # of an unknown angle, as in data sets of rig export


@CameraConfig.register_subclass("tactile")
@dataclass(kw_only=True)
class TactileConfig(CameraConfig):
    """A tactile sensor. bench: as in rig's --bench. finger: name of its finger in the bench file."""

    bench: str = "fake"
    finger: str = "B"
    estimator: str | None = None

    def __post_init__(self) -> None:
        """Take rate and size from the bench file."""
        tip = LiveFingertip(self.bench, self.finger, None)
        self.fps, (self.width, self.height) = round(tip.rate_hz), tip.size_px


class Tactile(Camera):
    """Images are (H, W, 3) uint8 RGB. Nothing may touch the gel while it connects."""

    def __init__(self, config: TactileConfig) -> None:
        super().__init__(config)
        self.config = config
        self.fingertip = LiveFingertip(config.bench, config.finger, config.estimator)

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is open."""
        return self.fingertip.is_connected

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return an empty list: a bench file names its sensors; `rig doctor` lists connected ones."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Open the sensor."""
        self.fingertip.connect()

    def read(self, *args: Any, **kwargs: Any) -> Any:
        """Return the next frame."""
        return self.async_read()

    def async_read(self, timeout_ms: float = 200.0) -> Any:
        """Return the newest frame that was not returned yet. Raises `TimeoutError`."""
        try:
            return self.fingertip.next(timeout_ms / 1e3).image
        except DeviceTimeoutError as error:
            raise TimeoutError(str(error)) from error

    def read_latest(self, max_age_ms: int = 500) -> Any:
        """Return the newest frame immediately. Raises `TimeoutError` if it is too old."""
        try:
            return self.fingertip.newest(max_age_ms / 1e3).image
        except StaleFrameError as error:
            raise TimeoutError(str(error)) from error

    def disconnect(self) -> None:
        """Close the sensor."""
        self.fingertip.disconnect()


@RobotConfig.register_subclass("with_touch")
@dataclass(kw_only=True)
class WithTouchConfig(RobotConfig):
    """robot: any robot of LeRobot, its type and options. touch: cameras of the type tactile, by name.

    The robot is a dict, because LeRobot's parser would recurse endlessly into a RobotConfig here.
    """

    robot: dict[str, Any]
    touch: dict[str, CameraConfig] = field(default_factory=dict)
    estimator: str = "slip"


class WithTouch(Robot):
    """Forwards all calls to its robot; adds `NAME`, `NAME.angle_deg` and `NAME.sigma_deg` to observations."""

    config_class = WithTouchConfig
    name = "with_touch"

    def __init__(self, config: WithTouchConfig) -> None:
        super().__init__(config)
        self.robot = make_robot_from_config(draccus.decode(RobotConfig, config.robot))
        self.tips: dict[str, Tactile] = {}
        for name, touch in config.touch.items():
            if not isinstance(touch, TactileConfig):
                raise ValueError(f"touch {name}: give a camera of the type tactile")
            touch.estimator = touch.estimator or config.estimator
            self.tips[name] = Tactile(touch)
        self.cameras = {**getattr(self.robot, "cameras", {}), **self.tips}

    @property
    def observation_features(self) -> dict[str, Any]:
        """The robot's features, images as (height, width, 3), and angles as numbers."""
        images = {name: (tip.height, tip.width, 3) for name, tip in self.tips.items()}
        angles = {f"{name}.{what}": float for name in self.tips for what in ("angle_deg", "sigma_deg")}
        return {**self.robot.observation_features, **angles, **images}

    @property
    def action_features(self) -> dict[str, Any]:
        """The robot's features."""
        return self.robot.action_features

    def get_observation(self) -> dict[str, Any]:
        """Return the robot's observation, with images and angles."""
        observation = dict(self.robot.get_observation())
        for name, tip in self.tips.items():
            found = tip.fingertip.angle()
            known = found.angle_deg is not None and found.sigma_deg is not None
            observation[f"{name}.angle_deg"] = found.angle_deg or 0.0
            observation[f"{name}.sigma_deg"] = found.sigma_deg if known else UNKNOWN_SIGMA_DEG
            observation[name] = tip.read_latest()
        return observation

    @property
    def is_connected(self) -> bool:
        """Whether the robot and every sensor are connected."""
        return self.robot.is_connected and all(tip.is_connected for tip in self.tips.values())

    def connect(self, calibrate: bool = True) -> None:
        """Connect the sensors, then the robot."""
        for tip in self.tips.values():
            tip.connect()
        self.robot.connect(calibrate)

    @property
    def is_calibrated(self) -> bool:
        """The robot's."""
        return self.robot.is_calibrated

    def calibrate(self) -> None:
        """Calibrate the robot."""
        self.robot.calibrate()

    def configure(self) -> None:
        """Configure the robot."""
        self.robot.configure()

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Pass an action on to the robot."""
        return self.robot.send_action(action)

    def disconnect(self) -> None:
        """Disconnect the robot and the sensors."""
        self.robot.disconnect()
        for tip in self.tips.values():
            tip.disconnect()
