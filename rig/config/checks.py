"""What a bench cannot be although each key, taken alone, is possible: keys that contradict one another."""

from collections.abc import Iterator

import numpy as np

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
"""The true angle is taken between pictures at most 50 ms apart (contract); their times vary by a fifth."""


def inconsistencies(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key that cannot be so beside the others, and why."""
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
    """Real devices are somewhere; fakes that are started for the session fill in where."""
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
