"""Checks of a whole bench file: contradictory keys, missing keys of real benches, keys without effect."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from pydantic import BaseModel

from calibration.camera.model import LEAST_FOCAL
from drivers.named_classes import is_class_name
from rig.config.fields import KeyFault, KeyPath
from rig.config.models import (
    ArmConfig,
    BenchConfig,
    CameraConfig,
    DeviceConfig,
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
BESIDE_ARM, BESIDE_GRIPPER = ("position_m", "look_at_m"), ("finger", "sign")
"""Keys of [camera] that are needed beside an arm, and of [[tactile]] beside a gripper."""
FAKE_DIGIT_PX = (240, 320)
"""(width, height) of the images of a DIGIT simulated in this process."""


def inconsistencies(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key that contradicts others, and why."""
    for where, device in config.devices:
        if isinstance(device, ArmConfig):
            yield from _arm(device)
        elif isinstance(device, GripperConfig):
            yield from _gripper(device)
        elif isinstance(device, TactileConfig):
            yield from _tactile(device, where)
        else:
            yield from _camera(device)
        if config.fakes is None or config.fakes.control is not None:
            yield from _address(device)
    yield from _parts(config)
    yield from _fingertips(config)
    yield from _kinds(config)
    if config.has("arm", "table"):
        arm, place_m = config.arm, config.table.position_m
        if not _inside(place_m, arm.limits.workspace_min_m, arm.limits.workspace_max_m):
            why = "is outside the workspace of [arm.limits]: the arm cannot reach it"
            yield ("table", "position_m"), why
        elif arm.home_m[2] <= place_m[2]:
            yield (
                ("arm", "home_m"),
                "is not above position_m of [table]: the tool would wait inside the object",
            )


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


def _tactile(tactile: TactileConfig, where: KeyPath) -> Iterator[KeyFault]:
    if tactile.driver != "digit":
        return
    rates = DIGIT_MODES.get(tactile.size_px)
    if rates is None:
        known = " or ".join(f"[{w}, {h}]" for w, h in DIGIT_MODES)
        yield (*where, "size_px"), f"is not a size of a DIGIT, upright {known}"
    elif tactile.rate_hz not in rates:
        listed = " or ".join(f"{rate:g}" for rate in rates)
        yield (*where, "rate_hz"), f"a DIGIT streams this size at {listed} Hz"


def _camera(camera: CameraConfig) -> Iterator[KeyFault]:
    import cv2

    if camera.rate_hz < SLOWEST_CAMERA_HZ:
        yield (
            ("camera", "rate_hz"),
            f"is too slow: the true angle is taken between pictures at most 50 ms apart, "
            f"so give {SLOWEST_CAMERA_HZ:g} or more",
        )
    if camera.focal_px < LEAST_FOCAL * max(camera.size_px):
        yield (
            ("camera", "focal_px"),
            "is too short for pictures of size_px: is it in mm? Write it in px",
        )
    number = getattr(cv2.aruco, camera.marker_dictionary, None)
    if not camera.marker_dictionary.startswith("DICT_") or number is None:
        yield ("camera", "marker_dictionary"), "is not an ArUco dictionary, such as DICT_4X4_50"
    elif max(camera.marker_ids) >= (size := len(cv2.aruco.getPredefinedDictionary(number).bytesList)):
        yield ("camera", "marker_ids"), f"{camera.marker_dictionary} has markers 0 to {size - 1}"
    if camera.marker_ids[0] == camera.marker_ids[1]:
        yield ("camera", "marker_ids"), "names one marker twice"
    sight = np.subtract(camera.look_at_m, camera.position_m)
    if np.linalg.norm(sight[:2]) < 1e-6:
        yield (
            ("camera", "look_at_m"),
            "is straight above or below position_m: the picture has no upright axis",
        )


def _address(device: DeviceConfig) -> Iterator[KeyFault]:
    """Yield the missing address of a real device; fakes started for the session provide their own."""
    if isinstance(device, ArmConfig):
        if device.driver == "ur5e" and not device.host:
            yield ("arm",), "driver 'ur5e' needs host, the controller's address"
    elif isinstance(device, GripperConfig):
        if device.driver == "robotiq_3f" and device.transport == "tcp" and not device.host:
            yield ("gripper",), "transport 'tcp' needs host, the gripper's address"
        if device.driver == "robotiq_3f" and device.transport == "rtu" and not device.device:
            yield ("gripper",), "transport 'rtu' needs device, the serial port, as /dev/ttyUSB0"
    elif device.driver == "camera" and not device.address:
        yield ("camera",), "driver 'camera' needs address: /dev/videoN, a URL, a video file or a folder"


def _parts(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield the keys and sections that the devices of the bench require."""
    if not any(True for _ in config.devices):
        yield (), "has no device: a bench has [arm], [gripper], [[tactile]] or [camera], at least one"
    if config.has("arm") and not config.has("table"):
        yield ("table",), "is needed beside [arm]: write [table] with position_m, where objects are placed"
    if config.has("arm", "camera"):
        why = "is needed beside [arm]: write a point in its base, m, as [0.45, 0.0, 0.1]"
        yield from _lacking(config.camera, ("camera",), dict.fromkeys(BESIDE_ARM, why))
    for number, tactile in enumerate(config.tactile if config.has("gripper") else ()):
        why = "is needed beside [gripper]: its finger, and the sign"
        yield from _lacking(tactile, ("tactile", number), dict.fromkeys(BESIDE_GRIPPER, why))
    if config.fakes is not None and not (config.has("arm", "gripper", "camera") and len(config.tactile) == 2):
        yield ("fakes",), "supports only complete benches: [arm], [gripper], two [[tactile]] and [camera]"


def _fingertips(config: BenchConfig) -> Iterator[KeyFault]:
    fingers = [t.finger for t in config.tactile]
    if config.has("gripper") and not {*fingers} <= {*config.gripper.fingers}:
        yield ("tactile",), "each [[tactile]] names exactly one of the grasping fingers of [gripper]"
    if len({*fingers}) < len(fingers):
        yield (
            ("tactile", 1, "finger"),
            "is the other fingertip's too: exactly one [[tactile]] for each finger",
        )
    if config.has("gripper") and len({t.sign for t in config.tactile}) < len(fingers):
        yield ("tactile", 1, "sign"), "opposing fingertips see the object from opposite sides: signs differ"
    serials = [sensor.serial for sensor in config.sensors]
    for number, serial in enumerate(serials):
        if serial in serials[:number]:
            of_camera = number == len(config.tactile)
            where: KeyPath = ("camera", "serial") if of_camera else ("tactile", number, "serial")
            yield where, f"'{serial}' is another sensor's serial; each sensor has its own"


def _kinds(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield the devices that must not be simulated, or real, in combination with the others.

    A simulated bench moves without confirmation, has the simulated cell's limits by default, and may
    react to slip; a real arm or gripper beside a simulated device would do the same.
    """
    if config.mixed:
        fakes = ", ".join(config.fake_devices)
        for where, device in config.devices:
            if isinstance(device, ArmConfig | GripperConfig) and device.driver != "fake":
                yield (
                    (*where, "driver"),
                    f"is real and would react to data of simulated devices ({fakes}): a real arm or "
                    "gripper needs only real devices: make all of them real or all simulated",
                )
        if len({tactile.driver == "fake" for tactile in config.tactile}) == 2:
            yield ("tactile", 1, "driver"), "one fingertip is 'fake' and the other is not: make both the same"
        if config.fakes is not None:
            yield ("fakes",), f"is for the real drivers; {fakes} would be simulated twice: name real drivers"
    if config.fakes is not None and config.own_drivers:
        named = ", ".join(sorted(config.own_drivers))
        yield ("fakes",), f"is for the rig's own drivers; with {named} this is a real bench: remove it"
    if config.faults and not config.in_process:
        yield ("faults",), "work only if all devices are simulated in this process; some here are not"
    devices = {*(str(where[0]) for where, _ in config.devices), *(s.serial for s in config.sensors)}
    for number, fault in enumerate(config.faults):
        if fault.device not in devices:
            yield ("faults", number, "device"), f"'{fault.device}' is not one of {', '.join(sorted(devices))}"


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
    if config.simulated or not config.has("arm"):
        return
    arm = config.arm
    why = "is required of a real arm, on whose controller it is set: write"
    yield from _lacking(arm, ("arm",), {key: f"{why} {write}" for key, write in ON_THE_FLANGE.items()})
    if config.has("table") and config.table.top_m is None:
        yield ("table", "top_m"), "is required of a real bench: write the height of the table's top, as 0.02"
    limits, why = required_limits(arm), "is required of a real arm: write"
    if "limits" in arm.model_fields_set:
        asked = {key: f"{why} {write}" for key, write in limits.items()}
        yield from _lacking(arm.limits, ("arm", "limits"), asked)
    else:
        yield ("arm", "limits"), f"{why} [arm.limits] with {', '.join(limits)}"


def unused_keys(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key in a bench file that would be ignored, and why.

    Only for files: a session's stored copy has every key.
    """
    if "calibrations" in config.model_fields_set:
        yield ("calibrations",), "must not be in a bench file; they are found beside it"
    if "objects" in config.model_fields_set:
        yield (
            ("objects",),
            "must not be in a bench file, but in separate files (rig objects new FILE)",
        )
    if not config.simulated:
        why = "is only for simulated lifts: remove it"
        yield from _written(config, (), ["difficulty"], why)
    elif config.has("table"):
        why = "is only for real objects; simulated ones are placed by the simulation: remove it"
        yield from _written(config.table, ("table",), ["feeder"], why)
    if not config.has("arm"):
        why = "is for benches with an arm; this one has no [arm]: remove it"
        yield from _written(config, (), ["keep_out", "reactions_allowed"], why)
    for where, device in config.devices:
        if isinstance(device, ArmConfig):
            yield from _unused_arm(device)
        elif isinstance(device, GripperConfig):
            yield from _unused_gripper(device)
        elif isinstance(device, TactileConfig):
            yield from _unused_tactile(device, where, config)
        elif device.driver == "fake":
            yield from _written(device, where, ["address"], _no_effect("fake"))
        if not is_class_name(device.driver):
            why = "is for a class of your own, as driver = 'package.module:Class'; remove it"
            yield from _written(device, where, ["options"], why)
    if config.fakes is not None and config.in_process:
        yield ("fakes",), "is for the real drivers; these are 'fake': remove it, or name real drivers"
    elif config.fakes is not None and config.fakes.control is None:
        why = "does not count: [fakes] starts devices with addresses of their own; remove it, or give control"
        for where, device in config.devices:
            yield from _written(device, where, ["host", "port", "device", "address"], why)


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
            yield ("arm", key), f"the hand of driver 'fake' has only {list(has)}; remove the key"


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
            why = f"driver 'fake' draws only {list(FAKE_DIGIT_PX)}; remove the key"
            yield (*where, "size_px"), why
    elif config.fakes is None:
        why = "is only for simulated gels; it has no effect on a real one; remove it"
        yield from _written(tactile, where, ["markers"], why)
        why = "draws a simulated gel; a real one looks as it does: remove it"
        yield from _written(tactile, where, ["look", "look_seed"], why)
    if tactile.look is None:
        yield from _written(
            tactile, where, ["look_seed"], "varies a look, and no look is named: add it, or remove this"
        )


def _lacking(table: BaseModel, where: KeyPath, whys: Mapping[str, str]) -> Iterator[KeyFault]:
    for key, why in whys.items():
        if key not in table.model_fields_set:
            yield (*where, key), why


def _written(table: BaseModel, where: KeyPath, keys: Iterable[str], why: str) -> Iterator[KeyFault]:
    for key in keys:
        if key in table.model_fields_set:
            yield (*where, key), why


def _no_effect(driver: str) -> str:
    return f"has no effect with driver '{driver}'; remove it"
