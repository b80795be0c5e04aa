"""Keys that a person wrote in a bench file and that would do nothing there: no key is ignored in silence."""

from collections.abc import Iterable, Iterator

from pydantic import BaseModel

from drivers.named_classes import is_class_name
from rig.config.lines import KeyFault, KeyPath
from rig.config.models import ArmConfig, BenchConfig, CameraConfig, GripperConfig, TactileConfig

FAKE_DIGIT_PX = (240, 320)
"""What a simulated DIGIT in this process draws."""


def unused_keys(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key of a file's bench that would be ignored, and why.

    Only what was written counts: a session's stored copy, which holds every key, is not looked at here.
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
    yield from _arm(config.arm)
    yield from _gripper(config.gripper)
    for number, tactile in enumerate(config.tactile):
        yield from _tactile(tactile, ("tactile", number), config)
    if config.camera.driver == "fake":
        yield from _written(config.camera, ("camera",), ["address"], _no_effect("fake"))
    yield from _fakes(config)
    yield from _options(config)


def _arm(arm: ArmConfig) -> Iterator[KeyFault]:
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


def _gripper(gripper: GripperConfig) -> Iterator[KeyFault]:
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


def _tactile(tactile: TactileConfig, where: KeyPath, config: BenchConfig) -> Iterator[KeyFault]:
    if tactile.driver == "fake":
        yield from _written(tactile, where, ["address"], _no_effect("fake"))
        if tactile.size_px != FAKE_DIGIT_PX:
            why = f"driver 'fake' draws {list(FAKE_DIGIT_PX)}, and no other; remove the key"
            yield (*where, "size_px"), why
    elif config.fakes is None:
        why = "is for simulated gels; a real one has dots or has none, whatever is written; remove it"
        yield from _written(tactile, where, ["markers"], why)


def _fakes(config: BenchConfig) -> Iterator[KeyFault]:
    """What does not count where fakes are simulated in this process, or started for each session."""
    if config.fakes is None:
        return
    if config.in_process:
        yield ("fakes",), "is for the real drivers; these are 'fake': remove it, or name real drivers"
    elif config.fakes.control is None:
        why = "does not count: [fakes] starts devices with addresses of their own; remove it, or give control"
        yield from _written(config.arm, ("arm",), ["host"], why)
        yield from _written(config.gripper, ("gripper",), ["host", "port", "device"], why)
        for number, tactile in enumerate(config.tactile):
            yield from _written(tactile, ("tactile", number), ["address"], why)
        yield from _written(config.camera, ("camera",), ["address"], why)


def _options(config: BenchConfig) -> Iterator[KeyFault]:
    why = "is for a class of your own, as driver = 'package.module:Class'; remove it"
    places: list[tuple[KeyPath, ArmConfig | GripperConfig | TactileConfig | CameraConfig]] = [
        (("arm",), config.arm),
        (("gripper",), config.gripper),
    ]
    places += [(("tactile", number), tactile) for number, tactile in enumerate(config.tactile)]
    for where, device in (*places, (("camera",), config.camera)):
        if not is_class_name(device.driver):
            yield from _written(device, where, ["options"], why)


def _written(table: BaseModel, where: KeyPath, keys: Iterable[str], why: str) -> Iterator[KeyFault]:
    for key in keys:
        if key in table.model_fields_set:
            yield (*where, key), why


def _no_effect(driver: str) -> str:
    return f"has no effect with driver '{driver}'; remove it"
