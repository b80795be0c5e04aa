"""Checks of a whole bench: keys that contradict each other, and keys that depend on other sections."""

from collections.abc import Iterator, Mapping

import numpy as np
from pydantic import BaseModel

from calibration.camera.model import LEAST_FOCAL
from rig.config.devices import (
    FORCE_CHANGE,
    MODBUS_PORT,
    ArmConfig,
    CameraConfig,
    DigitConfig,
    FakeArmConfig,
    FakeTactileConfig,
    GripperConfig,
    OwnArmConfig,
    RobotiqConfig,
    RobotiqRtuConfig,
    StrokeLimits,
    TactileConfig,
    UR5eConfig,
    VideoCameraConfig,
)
from rig.config.fields import KeyFault, KeyPath
from rig.config.models import BenchConfig

DIGIT_MODES = {(240, 320): (60.0, 30.0), (480, 640): (30.0, 15.0)}
"""Upright size in pixels, and the rates at which a DIGIT streams it (digit-interface's tables)."""
SLOWEST_CAMERA_HZ = 24.0
"""The true angle is interpolated between images at most 50 ms apart (contract); periods vary by a fifth."""
ADDRESSES: Mapping[type[BaseModel], tuple[str, str]] = {
    UR5eConfig: ("host", "the controller's address"),
    RobotiqConfig: ("host", "the gripper's address"),
    RobotiqRtuConfig: ("device", "the serial port, as /dev/ttyUSB0"),
    VideoCameraConfig: ("address", "/dev/videoN, a URL, a video file or a folder"),
}
"""Key of the address of a real device, and what to write; other devices are found without one."""
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
    yield from _keys_without_effect(config)
    yield from _parts(config)
    yield from _fingertips(config)
    yield from _kinds(config)
    if config.arm is not None and config.table is not None:
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
    force_n = limits.max_contact_force_n
    if isinstance(arm, OwnArmConfig) and arm.force_sensor and force_n is None:
        yield ("arm", "limits", "max_contact_force_n"), f"is missing: write {FORCE_CHANGE}"
    elif not arm.force_sensor and force_n is not None:
        why = "has no effect with force_sensor = false: nothing measures that force; remove it"
        yield ("arm", "limits", "max_contact_force_n"), why
    if not isinstance(arm, FakeArmConfig) and arm.payload_kg > arm.limits.max_payload_kg:
        yield ("arm", "payload_kg"), f"is above max_payload_kg, {arm.limits.max_payload_kg:g}"


def _gripper(gripper: GripperConfig) -> Iterator[KeyFault]:
    if gripper.fingers[0] == gripper.fingers[1]:
        yield ("gripper", "fingers"), "names one finger twice"
    limits = gripper.limits
    if isinstance(limits, StrokeLimits):
        if not limits.spec().steps:
            yield ("gripper", "limits", "stroke_m"), "is less than one step of resolution_m"
    elif limits.max_counts <= limits.min_counts:
        yield ("gripper", "limits", "max_counts"), "is not above min_counts"
    for key in ("speed_m_s", "force_n"):
        low, high = getattr(limits, key)
        if high < low:
            yield ("gripper", "limits", key), "is not a range: the lowest first"


def _tactile(tactile: TactileConfig, where: KeyPath) -> Iterator[KeyFault]:
    if isinstance(tactile, FakeTactileConfig | DigitConfig) and tactile.look is None:
        if tactile.look_seed is not None:
            why = "varies a look, and no look is named: add it, or remove this"
            yield (*where, "look_seed"), why
    if isinstance(tactile, FakeTactileConfig) and tactile.size_px != FAKE_DIGIT_PX:
        yield (*where, "size_px"), f"driver 'fake' draws only {list(FAKE_DIGIT_PX)}; remove the key"
    if not isinstance(tactile, DigitConfig):
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


def _keys_without_effect(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield the keys that [fakes] gives a meaning or takes it: addresses of devices, looks of their gels."""
    started = config.fakes is not None and config.fakes.control is None
    for where, device in config.devices:
        key, write = ADDRESSES.get(type(device), ("address", ""))
        given = getattr(device, key, None)
        if started and given:
            yield (*where, key), "does not count: [fakes] starts its own devices; remove it, or give control"
        elif started and getattr(device, "port", MODBUS_PORT) != MODBUS_PORT:
            yield (
                (*where, "port"),
                "does not count: [fakes] starts the devices; remove it",
            )
        elif not started and write and not given:
            yield (*where, key), f"is missing: write {write}"
        if config.fakes is None and isinstance(device, DigitConfig):
            why = "is only for simulated gels; it has no effect on a real one; remove it"
            for drawn in ("markers", "look", "look_seed"):
                if getattr(device, drawn) not in (None, False):
                    yield (*where, drawn), why


def _parts(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield the keys and sections that the devices of the bench require."""
    if not any(True for _ in config.devices):
        yield (), "has no device: a bench has [arm], [gripper], [[tactile]] or [camera], at least one"
    if config.arm is not None and config.table is None:
        yield ("table",), "is needed beside [arm]: write [table] with position_m, where objects are placed"
    elif config.arm is not None and config.table is not None:
        if not config.simulated and config.table.top_m is None:
            yield ("table", "top_m"), "is missing: write the height of the table's top, as 0.02"
    if config.arm is None:
        why = "is for benches with an arm; this one has no [arm]: remove it"
        given = {"keep_out": bool(config.keep_out), "reactions_allowed": config.reactions_allowed is not None}
        yield from (((key,), why) for key, written in given.items() if written)
    if config.difficulty != "easy" and not config.simulated:
        yield ("difficulty",), "is only for simulated lifts: remove it"
    if config.feeder is not None and config.simulated:
        why = "is only for real objects; simulated ones are placed by the simulation: remove it"
        yield ("table", "feeder"), why
    if config.arm is not None and config.camera is not None:
        why = "is needed beside [arm]: write a point in its base, m, as [0.45, 0.0, 0.1]"
        yield from _lacking(config.camera, ("camera",), dict.fromkeys(BESIDE_ARM, why))
    for number, tactile in enumerate(config.tactile if config.gripper is not None else ()):
        why = "is needed beside [gripper]: its finger, and the sign"
        yield from _lacking(tactile, ("tactile", number), dict.fromkeys(BESIDE_GRIPPER, why))
    if config.fakes is not None and not (config.has("arm", "gripper", "camera") and len(config.tactile) == 2):
        yield ("fakes",), "supports only complete benches: [arm], [gripper], two [[tactile]] and [camera]"


def _fingertips(config: BenchConfig) -> Iterator[KeyFault]:
    fingers = [t.finger for t in config.tactile]
    if config.gripper is not None and not {*fingers} <= {*config.gripper.fingers}:
        yield ("tactile",), "each [[tactile]] names exactly one of the grasping fingers of [gripper]"
    if len({*fingers}) < len(fingers):
        yield (
            ("tactile", 1, "finger"),
            "is the other fingertip's too: exactly one [[tactile]] for each finger",
        )
    if config.gripper is not None and len({t.sign for t in config.tactile}) < len(fingers):
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
    elif config.fakes is not None and config.in_process:
        yield ("fakes",), "is for the real drivers; these are 'fake': remove it, or name real drivers"
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


def _lacking(table: BaseModel, where: KeyPath, whys: Mapping[str, str]) -> Iterator[KeyFault]:
    for key, why in whys.items():
        if key not in table.model_fields_set:
            yield (*where, key), why
