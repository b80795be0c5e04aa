"""Devices whose drivers are somebody's own: made from a bench file by name, and held to the rig's rules.

A class named as `driver = "package.module:Class"` is called with keyword arguments: of those that the rig
knows for such a device the ones that its constructor has, and all keys of the subtable `options`. The rules
that guard the rig's own drivers stand in front of it: limits before anything is sent, typed errors, values of
the right type.
"""

import inspect
from collections.abc import Iterable, Mapping
from typing import Any

from drivers.clock import Clock
from drivers.errors import InputError, RigError
from drivers.interfaces import Arm, FrameSource, Gripper, TactileSensor
from drivers.named_classes import named_class
from rig.bench.guards import GuardedArm, GuardedGripper, GuardedSource
from rig.config import BenchConfig, CameraConfig, TactileConfig

ARM_METHODS = ("connect", "disconnect", "state", "move_linear", "stop", "recover")
GRIPPER_METHODS = ("connect", "disconnect", "activate", "state", "move_to", "stop")
SOURCE_METHODS = ("connect", "disconnect", "next_frame", "newest_frame")


def own_arm(config: BenchConfig, clock: Clock) -> Arm:
    """Make an arm of somebody's own. Raises `InputError`.

    Its constructor has limits, flange_T_tcp, payload_kg and payload_cog_m, as `UR5e`, and of host,
    frequency_hz, joint_limits_rad (lowest and highest, rad) and clock what it needs.
    """
    arm, limits = config.arm, config.arm_limits()
    needed = {
        "limits": limits,
        "flange_T_tcp": arm.flange_T_tcp(),
        "payload_kg": arm.payload_kg,
        "payload_cog_m": arm.payload_cog_m,
    }
    known = {
        "host": arm.host,
        "frequency_hz": arm.frequency_hz,
        "joint_limits_rad": arm.limits.joint_limits_rad(),
        "clock": clock,
    }
    written = {"host", "frequency_hz"} & arm.model_fields_set
    if {"joint_min_deg", "joint_max_deg"} & arm.limits.model_fields_set:
        written |= {"joint_limits_rad"}
    driver = _made("arm", arm.driver, (Arm, ARM_METHODS), needed, known, written, arm.options)
    return GuardedArm(driver, arm.driver, limits, clock)


def own_gripper(config: BenchConfig, clock: Clock) -> Gripper:
    """Make a gripper of somebody's own. Raises `InputError`.

    Its constructor has limits, and of host, port, device, transport, preset, fingers and clock what it needs.
    """
    gripper, limits = config.gripper, config.gripper_limits()
    addresses = ("host", "port", "device", "transport", "preset")
    known = {key: getattr(gripper, key) for key in addresses} | {"fingers": gripper.fingers, "clock": clock}
    written = set(addresses) & gripper.model_fields_set
    kind = (Gripper, GRIPPER_METHODS)
    driver = _made("gripper", gripper.driver, kind, {"limits": limits}, known, written, gripper.options)
    return GuardedGripper(driver, gripper.driver, limits, clock)


def own_source(config: TactileConfig | CameraConfig, clock: Clock) -> TactileSensor:
    """Make a tactile sensor or a camera of somebody's own. Raises `InputError`.

    Its constructor has serial and rate_hz, and of address, size_px (width, height) and clock what it needs.
    """
    needed = {"serial": config.serial, "rate_hz": config.rate_hz}
    known = {"address": config.address, "size_px": config.size_px, "clock": clock}
    written = {"address"} & config.model_fields_set
    base = TactileSensor if isinstance(config, TactileConfig) else FrameSource
    driver = _made(
        config.serial, config.driver, (base, SOURCE_METHODS), needed, known, written, config.options
    )
    return GuardedSource(driver, config.driver, config.serial, config.rate_hz, config.size_px)


def _made(
    device: str,
    name: str,
    kind: tuple[type[Any], Iterable[str]],
    needed: Mapping[str, Any],
    known: Mapping[str, Any],
    written: Iterable[str],
    options: Mapping[str, Any],
) -> Any:
    """Import a class and call it.

    kind: the Protocol, and the methods of it that a class has to say. needed: arguments that it has to take.
    known: those that it may take. written: those of them that stand in the file, and may not be ignored.
    """
    what = f"{device}: driver '{name}'"
    found = named_class(name, f"{device}: driver")
    takes = _parameters(found, what)
    _require_methods(found, *kind, what)
    all_of_them = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in takes.values())
    for key in (*needed, *written, *options):
        if key not in takes and not all_of_them:
            own = "option" if key in options else "argument"
            raise InputError(f"{what}: {found.__name__} takes no {own} {key}; it takes {', '.join(takes)}")
    if doubled := sorted({*needed, *known} & {*options}):
        raise InputError(f"{what}: options names {doubled[0]}, which the rig gives it; remove it there")
    given = {**needed, **{key: value for key, value in known.items() if key in takes or all_of_them}}
    try:
        return found(**given, **options)
    except RigError:
        raise
    except Exception as error:
        raise InputError(
            f"{what}: making it raised {type(error).__name__}: {error}; see its options in the bench file"
        ) from error


def _parameters(found: type[Any], what: str) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(found).parameters
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: its constructor cannot be looked at ({error}); write one") from error


def _require_methods(found: type[Any], protocol: type[Any], methods: Iterable[str], what: str) -> None:
    """Refuse a class that leaves out what the rig calls, or only inherits the Protocol's empty method."""
    missing = [
        name
        for name in methods
        if not callable(getattr(found, name, None)) or getattr(found, name) is getattr(protocol, name, None)
    ]
    if missing:
        raise InputError(f"{what}: {found.__name__} does not say how to {', '.join(missing)}")
