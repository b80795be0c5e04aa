"""The keys of a bench file."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from calibration.camera.model import CameraModel
from calibration.gel.look import GelLook
from drivers.errors import without_passwords
from drivers.named_classes import is_class_name
from drivers.types import ArmLimits, Box, GripperSpec, Pose
from protocols.grasps import GraspFile
from rig.config.fields import (
    MISSING,
    SECTIONS,
    ArmLimitsConfig,
    BenchParts,
    BenchSection,
    Coordinate,
    FileName,
    Finger,
    GripperLimitsConfig,
    Host,
    HostPort,
    KeyPath,
    MarkerId,
    MayBeMissing,
    Offset,
    Options,
    Pixels,
    Point,
    Rate,
    RotationVector,
    driver_names,
)
from rig.config.in_use import CalibrationsInUse

FAR_M = 10.0
"""Half size of an unbounded keep-out box; larger than any bench."""


class ArmConfig(BenchSection):
    """The arm: driver, address, payload, home position."""

    later = frozenset({"force_sensor", "options"})
    driver: Annotated[str, driver_names("fake", "ur5e")]
    options: Options = Field(default={})
    host: Host | None = None
    frequency_hz: float = Field(default=500.0, ge=10, le=500)
    home_m: Point
    tcp_m: Offset = (0.0, 0.0, 0.28)
    tcp_rotation_vector_rad: RotationVector = (0.0, 0.0, 0.0)
    payload_kg: float = Field(default=2.5, ge=0)
    payload_cog_m: Offset = (0.0, 0.0, 0.08)
    force_sensor: bool = True
    """Whether the arm measures the wrench at the tool; if not, downward motions are not guarded."""
    limits: ArmLimitsConfig = ArmLimitsConfig()

    def flange_T_tcp(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Pose of the tool centre point on the arm's flange."""
        from scipy.spatial.transform import Rotation

        return Pose.from_rotation(self.tcp_m, Rotation.from_rotvec(self.tcp_rotation_vector_rad))


class GripperConfig(BenchSection):
    """The gripper: its driver, its connection, and the two fingers that grasp."""

    later = frozenset({"below_tcp_m", "half_width_m", "options", "period_s"})
    driver: Annotated[str, driver_names("fake", "robotiq_3f")]
    options: Options = Field(default={})
    transport: Literal["tcp", "rtu"] = "tcp"
    host: Host | None = None
    port: int = Field(default=502, ge=1, le=65535)
    device: str | None = None
    preset: Literal["tcp", "tcp-2014", "rtu"] | None = None
    fingers: tuple[Finger, Finger]
    below_tcp_m: float = Field(default=0.015, ge=0, le=0.2)
    half_width_m: float = Field(default=0.10, ge=0, le=0.3)
    period_s: float = Field(default=0.0, ge=0, le=0.1)
    """Delay of a gripper simulated in this process, s (a real one: about 0.01)."""
    limits: GripperLimitsConfig = GripperLimitsConfig()


class TactileConfig(BenchSection):
    """A tactile sensor; without an address it is found by its serial number.

    finger, sign: the finger that it is mounted on, and its sign; needed if the bench has a gripper.
    """

    later = frozenset({"gel", "look", "look_seed", "options"})
    driver: Annotated[str, driver_names("fake", "digit")]
    options: Options = Field(default={})
    serial: FileName
    address: str | None = None
    finger: Finger = "A"
    sign: Literal[1, -1] = 1
    rate_hz: Rate = 60.0
    size_px: tuple[Pixels, Pixels] = (240, 320)
    pixel_aspect: float | None = Field(default=None, gt=0.5, lt=2.0)
    """Width over height of a pixel on the gel; None if not measured."""
    markers: bool = False
    """Whether dots are printed on the gel (for the estimator `kolamuri`)."""
    gel: str | None = None
    """Calibration of the gel for the estimator `slip`: the YAML of `rig calibrate tactile`, relative path."""
    look: str | None = None
    """Look of a simulated gel: the .npz of `rig calibrate tactile`, relative to the bench file."""
    look_seed: int | None = Field(default=None, ge=0, lt=1_000_000)
    """Seed of a plausible other sensor, drawn from that look: LEDs turned, gains and noise changed. Networks
    are trained with larger seeds."""


class CameraConfig(BenchSection):
    """The external camera and the markers that it observes.

    position_m, look_at_m: in the arm's base frame, needed if the bench has an arm. Defaults: the simulated
    cell.
    """

    later = frozenset({"options"})
    driver: Annotated[str, driver_names("fake", "camera")]
    options: Options = Field(default={})
    serial: FileName
    address: str | None = None
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


class TableConfig(BenchSection):
    """Where the operator places objects, and the height of the table top."""

    later = frozenset({"top_m", "feeder"})
    position_m: Point
    top_m: Coordinate | None = None
    feeder: FileName | None = Field(default=None, min_length=1)
    """Name of a machine that places each object before its lift, also one that fell; no person is asked."""


class KeepOutConfig(BenchSection):
    """A box that hand and fingers must not enter."""

    name: str = Field(min_length=1)
    min_m: Point
    max_m: Point


class FakesConfig(BenchSection):
    """Settings for a bench whose real drivers talk to simulated devices.

    control: "host:port" of the running fakes' side channel; without it they are started for the session, and
    the addresses in the file are ignored.
    """

    control: HostPort | None = None


class FaultConfig(BenchSection):
    """A scripted failure of a simulated device, see `fakes.faults.ScriptedFault`."""

    device: str
    kind: str
    at_s: float = Field(ge=0)
    duration_s: float = 3600.0
    lift: str | None = None
    attempt: int | None = 0


class LimitConfig(BenchSection):
    """A limit of a figure of each lift or of the session, for all objects or one: `rig.results.limits`."""

    figure: str
    lower: float | None = None
    upper: float | None = None
    unit: str | None = None
    """Unit of both, which must be the figure's."""
    object: str | None = None
    """Id or name."""

    @model_validator(mode="after")
    def _require_range(self) -> "LimitConfig":
        if self.lower is None and self.upper is None:
            raise ValueError("needs lower, upper or both")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise ValueError("lower is above upper")
        return self


class LimitsFile(BenchSection):
    """The file of `--limits`."""

    limits: Annotated[tuple[LimitConfig, ...], Field(min_length=1)]


DeviceConfig = ArmConfig | GripperConfig | TactileConfig | CameraConfig


class BenchConfig(BenchParts):
    """One bench file. Reading a section that it lacks raises `InputError`."""

    later = frozenset({"difficulty", "keep_out", "limits", "objects", "reactions_allowed", *SECTIONS})
    name: FileName
    reactions_allowed: bool | None = None
    """Whether arm and fingers may react to slip automatically; by default only in simulation."""
    difficulty: Literal["easy", "hard"] = "easy"
    """Difficulty of simulated lifts: hard ones have the disturbances of real recordings (`conditions.py`)."""
    arm: Annotated[ArmConfig, MayBeMissing()] = MISSING
    gripper: Annotated[GripperConfig, MayBeMissing()] = MISSING
    tactile: Annotated[tuple[TactileConfig, ...], Field(max_length=2)] = ()
    camera: Annotated[CameraConfig, MayBeMissing()] = MISSING
    table: Annotated[TableConfig, MayBeMissing()] = MISSING
    keep_out: tuple[KeepOutConfig, ...] = ()
    fakes: FakesConfig | None = None
    faults: tuple[FaultConfig, ...] = ()
    limits: tuple[LimitConfig, ...] = ()
    """Limits of figures, which decide whether lifts and sessions pass."""
    calibrations: CalibrationsInUse = CalibrationsInUse()
    """Measured values that replace the nominal ones above; found beside the file, never in it."""
    objects: tuple[GraspFile, ...] = ()
    """A lab's own objects; found beside the file or in a given folder, never in the file."""

    def camera_model(self) -> CameraModel:
        """Return the calibrated camera; without a calibration, a pinhole with the file's focal length."""
        size, calibrated = self.camera.size_px, self.calibrations.camera
        if calibrated is None:
            return CameraModel.pinhole(size, self.camera.focal_px)
        return calibrated.camera_model(size)

    def base_T_camera(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Return the calibrated `base_T_camera`; without a calibration, that of the file."""
        found = self.calibrations.base_T_camera
        return self.camera.base_T_camera() if found is None else found.pose()

    def camera_turn_sigma_rad(self) -> float:
        """Return one sigma of `base_T_camera`'s orientation from the calibration; 0 if unknown."""
        found = self.calibrations.base_T_camera
        return 0.0 if found is None else found.turn_sigma_rad

    def object_distance_m(self) -> float:
        """Return the distance from the camera (`base_T_camera`) to an object in its place, m.

        Without [table], the distance to the point that the camera looks at.
        """
        place = self.table.position_m if self.has("table") else self.camera.look_at_m
        return float(np.linalg.norm(np.subtract(self.base_T_camera().position_m, place)))

    def without_passwords(self) -> "BenchConfig":
        """Return a copy without the passwords in its addresses, as it is stored in sessions."""
        hidden: dict[str, object] = {"tactile": tuple(map(_without_passwords, self.tactile))}
        for where, device in self.devices:
            if where[0] != "tactile":
                hidden[str(where[0])] = _without_passwords(device)
        return self.model_copy(update=hidden)

    def fingertips_alone(self) -> "BenchConfig":
        """Return a bench with only the fingertips of this one, and their calibrations."""
        found = self.calibrations
        own = CalibrationsInUse(
            files={key: file for key, file in found.files.items() if key.startswith("tactile-")},
            pixel_aspect=found.pixel_aspect,
            gel=found.gel,
        )
        gone = dict.fromkeys(SECTIONS, MISSING)
        return self.model_copy(update={**gone, "keep_out": (), "calibrations": own})

    def pixel_aspects(self) -> dict[str, float | None]:
        """Return width over height of each fingertip's pixels by serial, calibrated or from the file."""
        measured = self.calibrations.pixel_aspect
        return {t.serial: measured.get(t.serial, t.pixel_aspect) for t in self.tactile}

    def gel_looks(self) -> dict[str, GelLook]:
        """Return the calibrated looks of the fingertips that the bench file names, by serial."""
        return {serial: gel.look() for serial, gel in self.calibrations.gel.items()}

    def arm_limits(self) -> ArmLimits:
        """Return the arm's limits with the keep-out boxes of the hand: the table and the boxes in the file.

        Each box is enlarged by the hand's extent around the tool centre point: the fingertips below, half the
        hand's width to every side, and the hand up to the flange above.
        """
        boxes: list[KeepOutConfig | Box] = [*self.keep_out]
        if self.table.top_m is not None:
            boxes.append(Box("table", (-FAR_M, -FAR_M, -FAR_M), (FAR_M, FAR_M, self.table.top_m)))
        hand = self.gripper if self.has("gripper") else GripperConfig(driver="fake", fingers=("A", "B"))
        side, below, above = hand.half_width_m, hand.below_tcp_m, self.arm.tcp_m[2]
        grown = tuple(
            Box(
                box.name,
                (box.min_m[0] - side, box.min_m[1] - side, box.min_m[2] - above),
                (box.max_m[0] + side, box.max_m[1] + side, box.max_m[2] + below),
            )
            for box in boxes
        )
        written: dict[str, Any] = {
            of.name: getattr(self.arm.limits, of.name) for of in fields(ArmLimits) if of.name != "keep_out"
        }
        if not self.arm.force_sensor:
            written["max_contact_force_n"] = None
        return ArmLimits(**written, keep_out=grown)

    def gripper_spec(self) -> GripperSpec:
        return self.gripper.limits.spec(self.calibrations.opening)

    @property
    def devices(self) -> Iterator[tuple[KeyPath, DeviceConfig]]:
        """The devices of the bench, each with its path in the file."""
        if self.has("arm"):
            yield ("arm",), self.arm
        if self.has("gripper"):
            yield ("gripper",), self.gripper
        for number, tactile in enumerate(self.tactile):
            yield ("tactile", number), tactile
        if self.has("camera"):
            yield ("camera",), self.camera

    @property
    def sensors(self) -> tuple[TactileConfig | CameraConfig, ...]:
        return (*self.tactile, self.camera) if self.has("camera") else self.tactile

    @property
    def drivers(self) -> frozenset[str]:
        return frozenset(device.driver for _, device in self.devices)

    @property
    def own_drivers(self) -> frozenset[str]:
        """The drivers that are user-defined classes: a bench with one counts as real."""
        return frozenset(filter(is_class_name, self.drivers))

    @property
    def in_process(self) -> bool:
        """Whether all devices are simulated in this process: only such benches run in parallel."""
        return self.drivers == {"fake"}

    @property
    def reacts(self) -> bool:
        """Whether arm and fingers may react to slip automatically."""
        return self.simulated if self.reactions_allowed is None else self.reactions_allowed

    @property
    def feeder(self) -> str | None:
        """Name of the machine that places objects, None if a person places them."""
        return self.table.feeder if self.has("table") else None

    @property
    def simulated(self) -> bool:
        """Whether any device is simulated, in this process or over the wire protocol."""
        return "fake" in self.drivers or self.fakes is not None

    @property
    def fake_devices(self) -> tuple[str, ...]:
        """Serials of the sensors simulated in this process, and "arm", "gripper" if they are simulated."""
        return tuple(name for name, driver in self._drivers_by_name() if driver == "fake")

    @property
    def real_devices(self) -> tuple[str, ...]:
        """The same for devices that are simulated neither in this process nor over the wire protocol."""
        pairs = () if self.fakes is not None else self._drivers_by_name()
        return tuple(name for name, driver in pairs if driver != "fake")

    def _drivers_by_name(self) -> Iterator[tuple[str, str]]:
        for where, device in self.devices:
            yield getattr(device, "serial", str(where[0])), device.driver

    @property
    def mixed(self) -> bool:
        """Whether some devices are simulated and some are real. A real arm or gripper is never among them."""
        return "fake" in self.drivers and not self.in_process

    @property
    def moves(self) -> bool:
        """Whether the arm may move: there are arm and gripper, and all devices are of one kind."""
        return self.has("arm", "gripper") and not self.mixed

    def gives_simulated(self, *devices: str) -> bool:
        """Return whether any of these devices (serials, "arm") is simulated; its data must then be marked."""
        return not {*devices} <= {*self.real_devices}


def _without_passwords(device: DeviceConfig) -> DeviceConfig:
    options = device.options.items()
    hidden = {key: without_passwords(value) if isinstance(value, str) else value for key, value in options}
    update: dict[str, object] = {"options": hidden}
    if isinstance(device, TactileConfig | CameraConfig):
        update["address"] = device.address and without_passwords(device.address)
    return device.model_copy(update=update)


def known_keys() -> set[str]:
    return {key for model in (BenchConfig, *BenchSection.__subclasses__()) for key in model.model_fields}
