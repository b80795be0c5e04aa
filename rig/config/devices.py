"""The sections of a bench file that describe a device: a class for each driver, with the keys that it has.

A key without effect is therefore an unknown key, and a required key is a field without default. The
`description` of a field is what a message asks for if the key is missing.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from drivers.named_classes import is_class_name
from drivers.types import GripperSpec, Pose, Vector6
from rig.config.fields import (
    ClassName,
    FileName,
    Finger,
    Host,
    JointAngles,
    MarkerId,
    Offset,
    Options,
    Pixels,
    Point,
    Range,
    Rate,
    RotationVector,
    Section,
)

OWN = "a class of your own"
FORCE_CHANGE = "by how much the force may change on the way down, as 20.0"
FAKE_CONTACT_FORCE_N = 20.0
MODBUS_PORT = 502
FAKE_TCP_M: Offset = (0.0, 0.0, 0.28)
NO_ROTATION: RotationVector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class OneOf:
    """Marks a union of sections. choose: returns the name of the class for a section's values."""

    choose: Callable[[Any], str | None]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schemas = {member.__name__: handler.generate_schema(member) for member in get_args(source)}
        return core_schema.tagged_union_schema(schemas, self.choose)


class Device(Section):
    """A section with a driver. chosen: what selects this class, for messages. over: its transport."""

    chosen: ClassVar[str] = OWN
    over: ClassVar[str | None] = None

    @classmethod
    def accepts(cls, driver: str) -> bool:
        """Return whether this class describes a device of a driver."""
        kind = cls.model_fields["driver"].annotation
        return is_class_name(driver) if kind is str else driver in get_args(kind)


class JointLimits(Section):
    """Limits of the joints, by default the arm's own range."""

    joint_min_deg: JointAngles = (-360.0, -360.0, -360.0, -360.0, -360.0, -360.0)
    joint_max_deg: JointAngles = (360.0, 360.0, 360.0, 360.0, 360.0, 360.0)

    def joint_limits_rad(self) -> tuple[Vector6, Vector6]:
        """Return lowest and highest joint angles, rad."""
        return _radians(self.joint_min_deg), _radians(self.joint_max_deg)


Speed = Annotated[float, Field(gt=0, le=1.0)]
Acceleration = Annotated[float, Field(gt=0, le=2.5)]
Payload = Annotated[float, Field(gt=0, le=5.0)]
ContactForce = Annotated[float, Field(ge=5, le=100)]


class FakeArmLimits(JointLimits):
    """Limits of a simulated arm, checked before a command is sent; by default those of its cell.

    max_contact_force_n: None for `FAKE_CONTACT_FORCE_N`, or without a force sensor.
    """

    workspace_min_m: Point = (0.15, -0.35, 0.01)
    workspace_max_m: Point = (0.75, 0.35, 0.60)
    max_speed_m_s: Speed = 0.5
    max_acceleration_m_s2: Acceleration = 1.5
    max_payload_kg: ClassVar[float] = 5.0
    max_contact_force_n: ContactForce | None = None


class RealArmLimits(JointLimits):
    """Limits of a real arm, checked before a command is sent."""

    workspace_min_m: Point = Field(description="the lowest x, y, z of the tool, as [0.15, -0.35, 0.01]")
    workspace_max_m: Point = Field(description="the highest x, y, z of the tool, as [0.75, 0.35, 0.60]")
    max_speed_m_s: Speed = Field(description="the highest speed of the tool, as 0.5")
    max_acceleration_m_s2: Acceleration = Field(description="the highest acceleration of the tool, as 1.5")
    max_payload_kg: Payload = Field(description="the heaviest payload, as 5.0")


class UR5eLimits(RealArmLimits):
    """Limits of a UR5e, whose force sensor guards the way down."""

    max_contact_force_n: ContactForce = Field(description=FORCE_CHANGE)


class OwnArmLimits(RealArmLimits):
    """Limits of an arm with a driver class of the user's own, which may have no force sensor."""

    max_contact_force_n: ContactForce | None = None


def _only(value: Any) -> AfterValidator:
    """Return a validator that rejects any other value."""

    def check(given: Any) -> Any:
        if given != value:
            raise ValueError(f"driver 'fake' has only {list(value)}; remove the key")
        return given

    return AfterValidator(check)


class ArmSection(Device):
    """What all arms have: where the arm waits, and the tool centre point on its flange."""

    home_m: Point
    tcp_m: Offset = Field(description="the tool centre point as measured, as [0.0, 0.0, 0.28]")
    tcp_rotation_vector_rad: RotationVector = NO_ROTATION

    def flange_T_tcp(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Pose of the tool centre point on the arm's flange."""
        from scipy.spatial.transform import Rotation

        return Pose.from_rotation(self.tcp_m, Rotation.from_rotvec(self.tcp_rotation_vector_rad))


class FakeArmConfig(ArmSection):
    """An arm that is simulated in this process.

    force_sensor: whether it measures the wrench at the tool; if not, downward motions are not guarded.
    """

    chosen: ClassVar[str] = "driver 'fake'"
    driver: Literal["fake"]
    tcp_m: Annotated[Offset, _only(FAKE_TCP_M)] = FAKE_TCP_M
    tcp_rotation_vector_rad: Annotated[RotationVector, _only(NO_ROTATION)] = NO_ROTATION
    force_sensor: bool = True
    limits: FakeArmLimits = FakeArmLimits()


class RealArmSection(ArmSection):
    """Address of a controller, rate of its states, and the payload that is set on it."""

    host: Host | None = None
    frequency_hz: float = Field(default=500.0, ge=10, le=500)
    payload_kg: float = Field(ge=0, description="the hand's mass as weighed, as 2.5")
    payload_cog_m: Offset = Field(
        description="the hand's centre of mass from the flange, as [0.0, 0.0, 0.08]"
    )


class UR5eConfig(RealArmSection):
    """A UR5e. Only if [fakes] starts simulated devices it has no host."""

    chosen: ClassVar[str] = "driver 'ur5e'"
    driver: Literal["ur5e"]
    force_sensor: ClassVar[bool] = True
    limits: UR5eLimits


class OwnArmConfig(RealArmSection):
    """An arm with a driver class of the user's own. force_sensor: as in `FakeArmConfig`."""

    driver: ClassName
    options: Options = Field(default={})
    force_sensor: bool = True
    limits: OwnArmLimits


class FingerLimits(Section):
    """What all grippers have: opening of the open fingers, and permitted speeds and forces."""

    max_opening_m: float = Field(default=0.120, gt=0, le=0.155)
    speed_m_s: Range = (0.022, 0.110)
    force_n: Range = (15.0, 60.0)


class GripperLimitsConfig(FingerLimits):
    """Range of a Robotiq's fingers by its counts: min_counts open, max_counts closed."""

    min_counts: int = Field(default=6, ge=0, le=255)
    max_counts: int = Field(default=255, ge=0, le=255)
    opening_per_count_m: float = Field(default=0.155 / 249.0, gt=0, le=0.005)

    def spec(self, opening: tuple[tuple[float, float], ...] = ()) -> GripperSpec:
        """Return range and resolution of the gripper. opening: measured pairs of counts and m."""
        step_m = self.opening_per_count_m
        stroke_m = (self.max_counts - self.min_counts) * step_m
        return _spec(self, stroke_m, step_m, opening, self.min_counts)


class StrokeLimits(FingerLimits):
    """Range of the fingers of any other gripper. min_counts: what its open position counts as."""

    min_counts: ClassVar[int] = 6
    stroke_m: float = Field(gt=0, le=0.3, description="the stroke of the closing fingers, as 0.1")
    resolution_m: float = Field(ge=0.00005, le=0.005, description="the step size of the opening, as 0.0005")

    def spec(self, opening: tuple[tuple[float, float], ...] = ()) -> GripperSpec:
        """Return range and resolution of the gripper. opening: as in `GripperLimitsConfig`."""
        return _spec(self, self.stroke_m, self.resolution_m, opening, self.min_counts)


def _spec(
    limits: FingerLimits,
    stroke_m: float,
    step_m: float,
    opening: tuple[tuple[float, float], ...],
    open_counts: int,
) -> GripperSpec:
    measured = tuple((counts - open_counts, opening_m) for counts, opening_m in opening)
    return GripperSpec(limits.max_opening_m, stroke_m, step_m, limits.speed_m_s, limits.force_n, measured)


def _limits_of(values: Any) -> str:
    """Return the name of the class for the limits of a user-defined gripper."""
    if not isinstance(values, Mapping):
        return type(values).__name__
    return (StrokeLimits if {"stroke_m", "resolution_m"} & values.keys() else GripperLimitsConfig).__name__


class GripperSection(Device):
    """What all grippers have: the two fingers that grasp, and the extent of the hand around them."""

    fingers: tuple[Finger, Finger]
    below_tcp_m: float = Field(default=0.015, ge=0, le=0.2)
    half_width_m: float = Field(default=0.10, ge=0, le=0.3)


class FakeGripperConfig(GripperSection):
    """A gripper that is simulated in this process. period_s: its delay (a real one: about 0.01)."""

    chosen: ClassVar[str] = "driver 'fake'"
    driver: Literal["fake"]
    period_s: float = Field(default=0.0, ge=0, le=0.1)
    limits: GripperLimitsConfig = GripperLimitsConfig()


class RobotiqConfig(GripperSection):
    """A Robotiq 3-Finger on the network. Only if [fakes] starts simulated devices it has no host."""

    chosen: ClassVar[str] = "transport 'tcp'"
    over: ClassVar[str | None] = "tcp"
    driver: Literal["robotiq_3f"]
    transport: Literal["tcp"] = "tcp"
    host: Host | None = None
    port: int = Field(default=MODBUS_PORT, ge=1, le=65535)
    preset: Literal["tcp", "tcp-2014"] = "tcp"
    limits: GripperLimitsConfig = GripperLimitsConfig()


class RobotiqRtuConfig(GripperSection):
    """A Robotiq 3-Finger on a serial port. Only if [fakes] starts simulated devices it has no device."""

    chosen: ClassVar[str] = "transport 'rtu'"
    over: ClassVar[str | None] = "rtu"
    driver: Literal["robotiq_3f"]
    transport: Literal["rtu"]
    device: str | None = None
    preset: Literal["rtu"] = "rtu"
    limits: GripperLimitsConfig = GripperLimitsConfig()


class OwnGripperConfig(GripperSection):
    """A gripper with a driver class of the user's own, whose constructor may accept these keys."""

    driver: ClassName
    options: Options = Field(default={})
    transport: Literal["tcp", "rtu"] = "tcp"
    host: Host | None = None
    port: int = Field(default=MODBUS_PORT, ge=1, le=65535)
    device: str | None = None
    preset: Literal["tcp", "tcp-2014", "rtu"] | None = None
    limits: Annotated[GripperLimitsConfig | StrokeLimits, OneOf(_limits_of)] = GripperLimitsConfig()


class TactileSection(Device):
    """What all tactile sensors have.

    finger, sign: the finger that it is mounted on, and its sign; needed if the bench has a gripper.
    pixel_aspect: width over height of a pixel on the gel; None if not measured. gel: calibration of the gel
    for the estimator `slip`, the YAML of `rig calibrate tactile`, relative to the bench file.
    """

    serial: FileName
    finger: Finger = "A"
    sign: Literal[1, -1] = 1
    rate_hz: Rate = 60.0
    size_px: tuple[Pixels, Pixels] = (240, 320)
    pixel_aspect: float | None = Field(default=None, gt=0.5, lt=2.0)
    gel: str | None = None


class DrawnTactileSection(TactileSection):
    """A gel that is drawn.

    markers: whether dots are printed on it (for the estimator `kolamuri`). look: its look, the .npz of `rig
    calibrate tactile`, relative to the bench file. look_seed: of a plausible other sensor, drawn from that
    look: LEDs turned, gains and noise changed. Networks are trained with larger seeds.
    """

    markers: bool = False
    look: str | None = None
    look_seed: int | None = Field(default=None, ge=0, lt=1_000_000)


class FakeTactileConfig(DrawnTactileSection):
    """A tactile sensor that is simulated in this process."""

    chosen: ClassVar[str] = "driver 'fake'"
    driver: Literal["fake"]


class DigitConfig(DrawnTactileSection):
    """A DIGIT; without an address it is found by its serial number. Its gel is drawn with [fakes]."""

    chosen: ClassVar[str] = "driver 'digit'"
    driver: Literal["digit"]
    address: str | None = None


class OwnTactileConfig(TactileSection):
    """A tactile sensor with a driver class of the user's own."""

    driver: ClassName
    options: Options = Field(default={})
    address: str | None = None


class CameraSection(Device):
    """What all external cameras have, and the markers that they observe.

    position_m, look_at_m: in the arm's base frame, needed if the bench has an arm. Defaults: the simulated
    cell.
    """

    serial: FileName
    rate_hz: Rate
    size_px: tuple[Pixels, Pixels]
    focal_px: float = Field(gt=0)
    position_m: Point = (0.45, -0.62, 0.16)
    look_at_m: Point = (0.45, 0.0, 0.10)
    marker_dictionary: str
    marker_ids: tuple[MarkerId, MarkerId]
    marker_side_m: float = Field(gt=0, lt=0.5)

    def base_T_camera(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Return the pose of the camera in the arm's base: z towards `look_at_m`, x level to the right."""
        from scipy.spatial.transform import Rotation

        forward = np.subtract(self.look_at_m, self.position_m)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(forward, right), forward])
        return Pose.from_rotation(self.position_m, Rotation.from_matrix(axes))


class FakeCameraConfig(CameraSection):
    """A camera that is simulated in this process."""

    chosen: ClassVar[str] = "driver 'fake'"
    driver: Literal["fake"]


class VideoCameraConfig(CameraSection):
    """A camera, stream, video or folder. Only if [fakes] starts simulated devices it has no address."""

    chosen: ClassVar[str] = "driver 'camera'"
    driver: Literal["camera"]
    address: str | None = None


class OwnCameraConfig(CameraSection):
    """A camera with a driver class of the user's own."""

    driver: ClassName
    options: Options = Field(default={})
    address: str | None = None


ArmConfig = FakeArmConfig | UR5eConfig | OwnArmConfig
GripperConfig = FakeGripperConfig | RobotiqConfig | RobotiqRtuConfig | OwnGripperConfig
TactileConfig = FakeTactileConfig | DigitConfig | OwnTactileConfig
CameraConfig = FakeCameraConfig | VideoCameraConfig | OwnCameraConfig
DeviceConfig = ArmConfig | GripperConfig | TactileConfig | CameraConfig


def by_driver(section: Any) -> OneOf:
    """Mark a union of sections whose member is chosen by the keys `driver` and `transport`."""
    members: tuple[type[Device], ...] = get_args(section)

    def choose(values: Any) -> str | None:
        """Return the name of the class; None without a driver, the driver if it is unknown."""
        if not isinstance(values, Mapping):
            return type(values).__name__
        driver = values.get("driver")
        if not isinstance(driver, str):
            return None
        found = [member for member in members if member.accepts(driver)]
        first = [member for member in found if member.over == values.get("transport")]
        return next((member.__name__ for member in (*first, *found)), driver)

    return OneOf(choose)


def _radians(angles_deg: JointAngles) -> Vector6:
    a, b, c, d, e, f = (math.radians(angle) for angle in angles_deg)
    return a, b, c, d, e, f
