"""Checks of a whole bench file: contradictory keys, missing keys of real benches, keys without effect."""

from collections.abc import Iterable, Iterator

import numpy as np
from pydantic import BaseModel

from drivers.named_classes import is_class_name
from rig.config.lines import KeyFault, KeyPath
from rig.config.models import (
    ArmConfig,
    BenchConfig,
    CameraConfig,
    GripperConfig,
    TactileConfig,
)

DIGIT_MODES = {(240, 320): (60.0, 30.0), (480, 640): (30.0, 15.0)}
"""Upright size in pixels, and the rates at which a DIGIT streams it (digit-interface's tables)."""
SLOWEST_CAMERA_HZ = 24.0
"""The true angle is interpolated between images at most 50 ms apart (contract); periods vary by a fifth."""
ON_THE_FLANGE = {
    "tcp_m": "the tool centre point as measured, as [0.0, 0.0, 0.28]",
    "payload_kg": "the hand's mass as weighed, as 2.5",
    "payload_cog_m": "the hand's centre of mass from the flange, as [0.0, 0.0, 0.08]",
}
"""Keys of [arm] that are set on the controller, and what to write."""
LIMITS = {
    "workspace_min_m": "the lowest x, y, z of the tool, as [0.15, -0.35, 0.01]",
    "workspace_max_m": "the highest x, y, z of the tool, as [0.75, 0.35, 0.60]",
    "max_speed_m_s": "the highest speed of the tool, as 0.5",
    "max_acceleration_m_s2": "the highest acceleration of the tool, as 1.5",
    "max_payload_kg": "the heaviest payload, as 5.0",
    "max_contact_force_n": "by how much the force may change on the way down, as 20.0",
}
"""Keys of [arm.limits], and what to write. Joint limits default to the arm's own range."""
FAKE_DIGIT_PX = (240, 320)
"""(width, height) of the images of a DIGIT simulated in this process."""

Sensor = TactileConfig | CameraConfig


def inconsistencies(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key that contradicts others, and why."""
    yield from _arm(config.arm)
    yield from _gripper(config.gripper)
    for number, tactile in enumerate(config.tactile):
        yield from _tactile(tactile, number)
    yield from _camera(config.camera)
    yield from _together(config)
    if config.fakes is None or config.fakes.control is not None:
        yield from _addresses(config)


def _arm(arm: ArmConfig) -> Iterator[KeyFault]:
    limits = arm.limits
    if any(np.less_equal(limits.workspace_max_m, limits.workspace_min_m)):
        yield ("arm", "limits", "workspace_max_m"), "is not above workspace_min_m on every axis"
    elif not _inside(arm.home_m, limits.workspace_min_m, limits.workspace_max_m):
        yield ("arm", "home_m"), "is outside the workspace of [arm.limits]"
    if any(np.less_equal(limits.joint_max_deg, limits.joint_min_deg)):
        yield ("arm", "limits", "joint_max_deg"), "is not above joint_min_deg for every joint"
    if arm.driver == "ur5e" and not arm.force_sensor:
        yield ("arm", "force_sensor"), "a UR5e has one, and its way down is guarded: remove the key"
    if arm.payload_kg > limits.max_payload_kg:
        yield ("arm", "payload_kg"), f"is above max_payload_kg, {limits.max_payload_kg:g}"


def _gripper(gripper: GripperConfig) -> Iterator[KeyFault]:
    if gripper.fingers[0] == gripper.fingers[1]:
        yield ("gripper", "fingers"), "names one finger twice"
    limits = gripper.limits
    if limits.max_counts <= limits.min_counts:
        yield ("gripper", "limits", "max_counts"), "is not above min_counts"
    if (limits.stroke_m is None) != (limits.resolution_m is None):
        has, lacks = ("stroke_m", "resolution_m") if limits.stroke_m else ("resolution_m", "stroke_m")
        yield ("gripper", "limits", has), f"needs {lacks} beside it"
    elif limits.stroke_m is not None and not limits.spec().steps:
        yield ("gripper", "limits", "stroke_m"), "is less than one step of resolution_m"
    for key in ("speed_m_s", "force_n"):
        low, high = getattr(limits, key)
        if high < low:
            yield ("gripper", "limits", key), "is not a range: the lowest first"
    if gripper.preset is not None and (gripper.preset == "rtu") != (gripper.transport == "rtu"):
        yield ("gripper", "preset"), f"'{gripper.preset}' is not a map of transport '{gripper.transport}'"


def _tactile(tactile: TactileConfig, number: int) -> Iterator[KeyFault]:
    if tactile.driver != "digit":
        return
    rates = DIGIT_MODES.get(tactile.size_px)
    if rates is None:
        known = " or ".join(f"[{w}, {h}]" for w, h in DIGIT_MODES)
        yield ("tactile", number, "size_px"), f"is no size of a DIGIT, upright {known}"
    elif tactile.rate_hz not in rates:
        listed = " or ".join(f"{rate:g}" for rate in rates)
        yield ("tactile", number, "rate_hz"), f"a DIGIT streams this size at {listed} Hz"


def _camera(camera: CameraConfig) -> Iterator[KeyFault]:
    import cv2

    if camera.rate_hz < SLOWEST_CAMERA_HZ:
        yield (
            ("camera", "rate_hz"),
            f"is too slow: the true angle is taken between pictures at most 50 ms apart, "
            f"so give {SLOWEST_CAMERA_HZ:g} or more",
        )
    number = getattr(cv2.aruco, camera.marker_dictionary, None)
    if not camera.marker_dictionary.startswith("DICT_") or number is None:
        yield ("camera", "marker_dictionary"), "is no ArUco dictionary, as DICT_4X4_50"
    elif max(camera.marker_ids) >= (size := len(cv2.aruco.getPredefinedDictionary(number).bytesList)):
        yield ("camera", "marker_ids"), f"{camera.marker_dictionary} has markers 0 to {size - 1}"
    if camera.marker_ids[0] == camera.marker_ids[1]:
        yield ("camera", "marker_ids"), "names one marker twice"
    sight = np.subtract(camera.look_at_m, camera.position_m)
    if np.linalg.norm(sight[:2]) < 1e-6:
        yield ("camera", "look_at_m"), "is straight above or below position_m: the picture has no upright"


def _addresses(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield missing addresses of real devices; fakes started for the session provide their own."""
    arm, gripper, camera = config.arm, config.gripper, config.camera
    if arm.driver == "ur5e" and not arm.host:
        yield ("arm",), "driver 'ur5e' needs host, the controller's address"
    if gripper.driver == "robotiq_3f" and gripper.transport == "tcp" and not gripper.host:
        yield ("gripper",), "transport 'tcp' needs host, the gripper's address"
    if gripper.driver == "robotiq_3f" and gripper.transport == "rtu" and not gripper.device:
        yield ("gripper",), "transport 'rtu' needs device, the serial port, as /dev/ttyUSB0"
    if camera.driver == "camera" and not camera.address:
        yield ("camera",), "driver 'camera' needs address: /dev/videoN, a URL, a video file or a folder"


def _together(config: BenchConfig) -> Iterator[KeyFault]:
    if sorted(t.finger for t in config.tactile) != sorted(config.gripper.fingers):
        yield ("tactile",), "each grasping finger of [gripper] needs exactly one [[tactile]] with its name"
    if config.tactile[0].sign == config.tactile[1].sign:
        yield ("tactile", 1, "sign"), "opposing fingertips see the object from two sides: signs differ"
    serials = [*(t.serial for t in config.tactile), config.camera.serial]
    for number, serial in enumerate(serials):
        if serial in serials[:number]:
            where: KeyPath = ("camera", "serial") if number == 2 else ("tactile", number, "serial")
            yield where, f"'{serial}' is another sensor's serial; each has its own"
    low, high = config.arm.limits.workspace_min_m, config.arm.limits.workspace_max_m
    if not _inside(config.table.position_m, low, high):
        yield ("table", "position_m"), "is outside the workspace of [arm.limits]: it cannot be reached"
    elif config.arm.home_m[2] <= config.table.position_m[2]:
        yield ("arm", "home_m"), "is not above position_m of [table]: the tool would wait in the object"
    if "fake" in config.drivers and config.drivers != {"fake"}:
        yield ("arm", "driver"), "some drivers are 'fake' and some are not: make all of them one or the other"
    if config.fakes is not None and config.own_drivers:
        named = ", ".join(sorted(config.own_drivers))
        yield ("fakes",), f"is for the rig's own drivers; with {named} this is a real bench: remove it"
    if config.faults and "fake" not in config.drivers:
        yield ("faults",), "are for simulated devices in this process; this bench has none"
    devices = {"arm", "gripper", "tactile", "camera", *serials}
    for number, fault in enumerate(config.faults):
        if fault.device not in devices:
            yield ("faults", number, "device"), f"'{fault.device}' is none of {', '.join(sorted(devices))}"


def _inside(point: tuple[float, ...], low: tuple[float, ...], high: tuple[float, ...]) -> bool:
    return all(lo <= value <= hi for lo, value, hi in zip(low, point, high, strict=True))


def required_limits(arm: ArmConfig) -> dict[str, str]:
    """Return the required keys of [arm.limits] of a real arm, and what to write."""
    if arm.force_sensor:
        return LIMITS
    return {key: write for key, write in LIMITS.items() if key != "max_contact_force_n"}


def missing_keys(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key that is missing in the file of a real bench, and what to write there.

    Defaults would be those of the simulated cell. Only for files: a session's stored copy has every key.
    """
    if config.simulated:
        return
    arm = config.arm
    for key, write in ON_THE_FLANGE.items():
        if key not in arm.model_fields_set:
            yield ("arm", key), f"is required of a real arm, on whose controller it is set: write {write}"
    if config.table.top_m is None:
        yield ("table", "top_m"), "is required of a real bench: write the height of the table's top, as 0.02"
    if "limits" not in arm.model_fields_set:
        yield (
            ("arm", "limits"),
            f"is required of a real arm: write [arm.limits] with {', '.join(required_limits(arm))}",
        )
        return
    for key, write in required_limits(arm).items():
        if key not in arm.limits.model_fields_set:
            yield ("arm", "limits", key), f"is required of a real arm: write {write}"


def unused_keys(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key in a bench file that would be ignored, and why.

    Only for files: a session's stored copy has every key.
    """
    if "calibrations" in config.model_fields_set:
        yield ("calibrations",), "are not written in a bench file; they are found beside it"
    if "objects" in config.model_fields_set:
        yield (
            ("objects",),
            "are not written in a bench file, but in files of their own (rig objects new FILE)",
        )
    if not config.simulated:
        why = "is for simulated lifts; real ones are as they are: remove it"
        yield from _written(config, (), ["difficulty"], why)
    yield from _unused_arm(config.arm)
    yield from _unused_gripper(config.gripper)
    for number, tactile in enumerate(config.tactile):
        yield from _unused_tactile(tactile, ("tactile", number), config)
    if config.camera.driver == "fake":
        yield from _written(config.camera, ("camera",), ["address"], _no_effect("fake"))
    yield from _unused_fakes(config)
    yield from _unused_options(config)


def _unused_arm(arm: ArmConfig) -> Iterator[KeyFault]:
    if not arm.force_sensor:
        why = "has no effect with force_sensor = false: nothing measures that force; remove it"
        yield from _written(arm.limits, ("arm", "limits"), ["max_contact_force_n"], why)
    if arm.driver != "fake":
        return
    why = _no_effect("fake")
    yield from _written(arm, ("arm",), ["host", "frequency_hz", "payload_kg", "payload_cog_m"], why)
    yield from _written(arm.limits, ("arm", "limits"), ["max_payload_kg"], why)
    for key in ("tcp_m", "tcp_rotation_vector_rad"):
        has = type(arm).model_fields[key].default
        if getattr(arm, key) != has:
            yield ("arm", key), f"the hand of driver 'fake' has {list(has)}, and no other; remove the key"


def _unused_gripper(gripper: GripperConfig) -> Iterator[KeyFault]:
    limits, where = gripper.limits, ("gripper", "limits")
    if not is_class_name(gripper.driver):
        why = f"is not for driver '{gripper.driver}', whose counts give stroke and resolution; remove it"
        yield from _written(limits, where, ["stroke_m", "resolution_m"], why)
    elif limits.stroke_m is not None:
        why = "has no effect beside stroke_m and resolution_m; remove it"
        yield from _written(limits, where, ["min_counts", "max_counts", "opening_per_count_m"], why)
    if gripper.driver == "fake":
        keys = ["transport", "host", "port", "device", "preset"]
        yield from _written(gripper, ("gripper",), keys, _no_effect("fake"))
    elif not is_class_name(gripper.driver):
        keys = ["device"] if gripper.transport == "tcp" else ["host", "port"]
        why = f"has no effect with transport '{gripper.transport}'; remove it"
        yield from _written(gripper, ("gripper",), keys, why)


def _unused_tactile(tactile: TactileConfig, where: KeyPath, config: BenchConfig) -> Iterator[KeyFault]:
    if tactile.driver == "fake":
        yield from _written(tactile, where, ["address"], _no_effect("fake"))
        if tactile.size_px != FAKE_DIGIT_PX:
            why = f"driver 'fake' draws {list(FAKE_DIGIT_PX)}, and no other; remove the key"
            yield (*where, "size_px"), why
    elif config.fakes is None:
        why = "is for simulated gels; a real one has dots or has none, whatever is written; remove it"
        yield from _written(tactile, where, ["markers"], why)


def _unused_fakes(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield keys without effect if fakes are simulated in this process or started for each session."""
    if config.fakes is None:
        return
    if config.in_process:
        yield ("fakes",), "is for the real drivers; these are 'fake': remove it, or name real drivers"
    elif config.fakes.control is None:
        why = "does not count: [fakes] starts devices with addresses of their own; remove it, or give control"
        for where, device in _devices(config):
            yield from _written(device, where, ["host", "port", "device", "address"], why)


def _unused_options(config: BenchConfig) -> Iterator[KeyFault]:
    why = "is for a class of your own, as driver = 'package.module:Class'; remove it"
    for where, device in _devices(config):
        if not is_class_name(device.driver):
            yield from _written(device, where, ["options"], why)


def _devices(config: BenchConfig) -> Iterator[tuple[KeyPath, ArmConfig | GripperConfig | Sensor]]:
    yield ("arm",), config.arm
    yield ("gripper",), config.gripper
    for number, tactile in enumerate(config.tactile):
        yield ("tactile", number), tactile
    yield ("camera",), config.camera


def _written(table: BaseModel, where: KeyPath, keys: Iterable[str], why: str) -> Iterator[KeyFault]:
    for key in keys:
        if key in table.model_fields_set:
            yield (*where, key), why


def _no_effect(driver: str) -> str:
    return f"has no effect with driver '{driver}'; remove it"
