"""Bench files: what a bench is made of, checked key by key."""

import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from calibration.planar import Intrinsics
from drivers.errors import InputError
from drivers.types import Pose

BENCHES = Path(__file__).parent / "benches"
Point = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ArmConfig(_Strict):
    """The arm: which driver, where it is reached, where it waits."""

    driver: Literal["fake", "ur5e"]
    host: str | None = None
    home_m: Point


class GripperConfig(_Strict):
    """The gripper: which driver, and which two fingers grasp."""

    driver: Literal["fake", "robotiq_3f"]
    fingers: tuple[str, str]


class TactileConfig(_Strict):
    """A tactile sensor on a grasping finger."""

    driver: Literal["fake", "digit"]
    serial: str
    finger: str
    sign: Literal[1, -1]
    rate_hz: float = Field(gt=0, le=240)


class CameraConfig(_Strict):
    """The external camera and the markers it watches."""

    driver: Literal["fake", "camera"]
    serial: str
    rate_hz: float = Field(gt=0, le=240)
    size_px: tuple[int, int]
    focal_px: float = Field(gt=0)
    position_m: Point
    look_at_m: Point
    marker_dictionary: str
    marker_ids: tuple[int, int]
    marker_side_m: float = Field(gt=0, lt=0.5)

    def base_T_camera(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Pose of the camera in the arm's base: z towards `look_at_m`, x level to the right."""
        forward = np.subtract(self.look_at_m, self.position_m)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(forward, right), forward])
        return Pose.from_rotation(self.position_m, Rotation.from_matrix(axes))

    def intrinsics(self) -> Intrinsics:
        """Return the pinhole of this file: focal length, centre in the middle, no distortion."""
        width, height = self.size_px
        matrix = [
            [self.focal_px, 0.0, (width - 1) / 2],
            [0.0, self.focal_px, (height - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
        return Intrinsics(np.array(matrix), np.zeros(5))


class TableConfig(_Strict):
    """Where the operator places objects."""

    position_m: Point


class FaultConfig(_Strict):
    """A scripted failure of a simulated device, see `fakes.faults.Fault`."""

    device: str
    kind: str
    at_s: float = Field(ge=0)
    duration_s: float = 3600.0
    lift: str | None = None
    attempt: int | None = 0


class BenchConfig(_Strict):
    """One bench file."""

    name: str
    arm: ArmConfig
    gripper: GripperConfig
    tactile: tuple[TactileConfig, TactileConfig]
    camera: CameraConfig
    table: TableConfig
    faults: tuple[FaultConfig, ...] = ()

    @model_validator(mode="after")
    def _fingers_fit(self) -> "BenchConfig":
        if sorted(t.finger for t in self.tactile) != sorted(self.gripper.fingers):
            raise ValueError("each grasping finger of [gripper] needs exactly one [[tactile]] with its name")
        if self.tactile[0].serial == self.tactile[1].serial:
            raise ValueError("two [[tactile]] share a serial; each sensor has its own")
        return self

    @property
    def simulated(self) -> bool:
        """Whether any device of this bench is simulated."""
        drivers = {
            self.arm.driver,
            self.gripper.driver,
            self.camera.driver,
            *(t.driver for t in self.tactile),
        }
        return "fake" in drivers


def load_bench(name_or_path: str) -> BenchConfig:
    """Read a bench by name (`fake`) or from a file. Raises `InputError` naming file and key."""
    path = BENCHES / f"{name_or_path}.toml"
    if not path.exists():
        path = Path(name_or_path)
    if not path.is_file():
        raise InputError(f"no bench '{name_or_path}': use 'fake' or the path of a bench file (see README)")
    try:
        return BenchConfig.model_validate(tomllib.loads(path.read_text()))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    except ValidationError as error:
        raise InputError(f"{path}: {validation_text(error)}") from error


def validation_text(error: ValidationError) -> str:
    """Say in one line which keys are wrong and why."""
    faults = [(".".join(map(str, fault["loc"])) or "file", fault["msg"]) for fault in error.errors()]
    return "; ".join(f"{where}: {why}" for where, why in faults[:4])
