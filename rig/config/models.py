"""The keys of a bench file."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal, overload

import numpy as np
from pydantic import Field, InstanceOf, model_validator

from calibration.camera.model import CameraModel
from drivers.errors import InputError, without_passwords
from drivers.named_classes import is_class_name
from drivers.types import ArmLimits, Box, GripperSpec, Pose
from protocols.grasps import GraspFile
from rig.config.devices import (
    FAKE_CONTACT_FORCE_N,
    ArmConfig,
    CameraConfig,
    DeviceConfig,
    FakeGripperConfig,
    GripperConfig,
    TactileConfig,
    by_driver,
)
from rig.config.fields import Coordinate, FileName, HostPort, KeyPath, Point, Section
from rig.config.measured_values import Calibrations

FAR_M = 10.0
TABLE = "table"
"""Name of the keep-out box below the table top."""
"""Half size of an unbounded keep-out box; larger than any bench."""


class TableConfig(Section):
    """Where the operator places objects, and the height of the table top."""

    position_m: Point
    top_m: Coordinate | None = None
    feeder: FileName | None = Field(default=None, min_length=1)
    """Name of a machine that places each object before its lift, also one that fell; no person is asked."""


class KeepOutConfig(Section):
    """A box that hand and fingers must not enter."""

    name: str = Field(min_length=1)
    min_m: Point
    max_m: Point


class FakesConfig(Section):
    """Settings for a bench whose real drivers talk to simulated devices.

    control: "host:port" of the running fakes' side channel; without it they are started for the session, and
    the sections of the devices have no addresses.
    """

    control: HostPort | None = None


class FaultConfig(Section):
    """A scripted failure of a simulated device, see `fakes.faults.ScriptedFault`."""

    device: str
    kind: str
    at_s: float = Field(ge=0)
    duration_s: float = 3600.0
    lift: str | None = None
    attempt: int | None = 0


class LimitConfig(Section):
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


class LimitsFile(Section):
    """The file of `--limits`."""

    limits: Annotated[tuple[LimitConfig, ...], Field(min_length=1)]


class BenchConfig(Section):
    """One bench file. arm, gripper, camera, table: None if the bench has none; see `require`."""

    name: FileName
    reactions_allowed: bool | None = None
    """Whether arm and fingers may react to slip automatically; by default only in simulation."""
    difficulty: Literal["easy", "hard"] = "easy"
    """Difficulty of simulated lifts: hard ones have the disturbances of real recordings (`conditions.py`)."""
    arm: Annotated[ArmConfig, by_driver(ArmConfig)] | None = None
    gripper: Annotated[GripperConfig, by_driver(GripperConfig)] | None = None
    tactile: Annotated[
        tuple[Annotated[TactileConfig, by_driver(TactileConfig)], ...], Field(max_length=2)
    ] = ()
    camera: Annotated[CameraConfig, by_driver(CameraConfig)] | None = None
    table: TableConfig | None = None
    keep_out: tuple[KeepOutConfig, ...] = ()
    fakes: FakesConfig | None = None
    faults: tuple[FaultConfig, ...] = ()
    limits: tuple[LimitConfig, ...] = ()
    """Limits of figures, which decide whether lifts and sessions pass."""
    calibrations: InstanceOf[Calibrations] = Field(default=Calibrations(), exclude=True)
    """Measured values that replace the nominal ones above; in files beside the bench file or in a session."""
    objects: tuple[GraspFile, ...] = ()
    """A lab's own objects; found beside the file or in a given folder, never in the file."""

    def has(self, *sections: str) -> bool:
        """Return whether the bench file has all of these sections, as "arm"."""
        return all(getattr(self, section) is not None for section in sections)

    @overload
    def require(self, section: Literal["arm"]) -> ArmConfig: ...
    @overload
    def require(self, section: Literal["gripper"]) -> GripperConfig: ...
    @overload
    def require(self, section: Literal["camera"]) -> CameraConfig: ...
    @overload
    def require(self, section: Literal["table"]) -> TableConfig: ...

    def require(self, section: str) -> Any:
        """Return a section. Raises `InputError` if the bench file lacks it."""
        found = getattr(self, section)
        if found is None:
            raise InputError(f"bench '{self.name}' has no [{section}]: add it to the bench file")
        return found

    def camera_model(self) -> CameraModel:
        """Return the calibrated camera; without a calibration, a pinhole with the file's focal length."""
        camera = self.require("camera")
        return self.calibrations.camera or CameraModel.pinhole(camera.size_px, camera.focal_px)

    def base_T_camera(self) -> Pose:  # noqa: N802 - frame names keep their case
        """Return the calibrated `base_T_camera`; without a calibration, that of the file."""
        return self.calibrations.base_T_camera or self.require("camera").base_T_camera()

    def object_distance_m(self) -> float:
        """Return the distance from the camera (`base_T_camera`) to an object in its place, m.

        Without [table], the distance to `look_at_m` of the camera.
        """
        place = self.table.position_m if self.table is not None else self.require("camera").look_at_m
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
        own = self.calibrations.of_fingertips()
        gone = dict.fromkeys(("arm", "gripper", "camera", "table", "reactions_allowed"))
        return self.model_copy(update={**gone, "keep_out": (), "calibrations": own})

    def pixel_aspects(self) -> dict[str, float | None]:
        """Return width over height of each fingertip's pixels by serial, calibrated or from the file."""
        measured = self.calibrations.pixel_aspect
        return {t.serial: measured.get(t.serial, t.pixel_aspect) for t in self.tactile}

    def arm_limits(self) -> ArmLimits:
        """Return the arm's limits with the keep-out boxes of the hand: the table and the boxes in the file.

        Each box is enlarged by the hand's extent around the tool centre point: the fingertips below, half the
        hand's width to every side, and the hand up to the flange above.
        """
        arm, top_m = self.require("arm"), self.require("table").top_m
        boxes: list[KeepOutConfig | Box] = [*self.keep_out]
        if top_m is not None:
            boxes.append(Box(TABLE, (-FAR_M, -FAR_M, -FAR_M), (FAR_M, FAR_M, top_m)))
        hand = self.gripper or FakeGripperConfig(driver="fake", fingers=("A", "B"))
        side, below, above = hand.half_width_m, hand.below_tcp_m, arm.tcp_m[2]
        grown = tuple(
            Box(
                box.name,
                (box.min_m[0] - side, box.min_m[1] - side, box.min_m[2] - above),
                (box.max_m[0] + side, box.max_m[1] + side, box.max_m[2] + below),
            )
            for box in boxes
        )
        written: dict[str, Any] = {
            of.name: getattr(arm.limits, of.name) for of in fields(ArmLimits) if of.name != "keep_out"
        }
        if not arm.force_sensor:
            written["max_contact_force_n"] = None
        elif written["max_contact_force_n"] is None:
            written["max_contact_force_n"] = FAKE_CONTACT_FORCE_N
        return ArmLimits(**written, keep_out=grown)

    def gripper_spec(self) -> GripperSpec:
        return self.require("gripper").limits.spec(self.calibrations.opening)

    @property
    def devices(self) -> Iterator[tuple[KeyPath, DeviceConfig]]:
        """The devices of the bench, each with its path in the file."""
        if self.arm is not None:
            yield ("arm",), self.arm
        if self.gripper is not None:
            yield ("gripper",), self.gripper
        for number, tactile in enumerate(self.tactile):
            yield ("tactile", number), tactile
        if self.camera is not None:
            yield ("camera",), self.camera

    @property
    def sensors(self) -> tuple[TactileConfig | CameraConfig, ...]:
        return self.tactile if self.camera is None else (*self.tactile, self.camera)

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
        return None if self.table is None else self.table.feeder

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
    """Return a copy of a section without the passwords in its address and its options."""
    hidden: dict[str, object] = {}
    if address := getattr(device, "address", None):
        hidden["address"] = without_passwords(address)
    if options := getattr(device, "options", None):
        texts = {key: without_passwords(each) for key, each in options.items() if isinstance(each, str)}
        hidden["options"] = options | texts
    return device.model_copy(update=hidden)
