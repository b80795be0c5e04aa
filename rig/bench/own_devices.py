"""Create user-defined devices from a bench file by their class name.

A class named as `driver = "package.module:Class"` is called with keyword arguments: those of the rig's
arguments for such a device that its constructor accepts, and all keys of the subtable `options`. The bench
then checks every motion and state, see `rig.bench.checked`.
"""

import inspect
from collections.abc import Iterable, Mapping, Set
from typing import Any, cast

from drivers.clock import Clock
from drivers.errors import InputError, RigError
from drivers.interfaces import Arm, FrameSource, Gripper, TactileSensor
from drivers.named_classes import named_class, raised_text
from rig.bench.checked import CheckedArm, CheckedGripper, CheckedSource
from rig.config import BenchConfig, CameraConfig, TactileConfig

ARM_METHODS = ("connect", "disconnect", "state", "move_linear", "stop", "recover")
GRIPPER_METHODS = ("connect", "disconnect", "activate", "state", "move_to", "stop")
SOURCE_METHODS = ("connect", "disconnect", "next_frame", "newest_frame")
MAY_BE_IGNORED = frozenset({"fingers", "size_px"})
"""Keys that the bench file always has, and that a constructor need not accept."""


def own_arm(config: BenchConfig, clock: Clock) -> Arm:
    """Create a user-defined arm. Raises `InputError`.

    Its constructor must accept limits, flange_T_tcp, payload_kg and payload_cog_m, as `UR5e`. It may accept
    host, frequency_hz, joint_limits_rad (lowest and highest, rad) and clock.
    """
    arm, limits = config.arm, config.arm_limits()
    needed = {
        "limits": limits,
        "flange_T_tcp": arm.flange_T_tcp(),
        "payload_kg": arm.payload_kg,
        "payload_cog_m": arm.payload_cog_m,
    }
    known = {"host": arm.host, "frequency_hz": arm.frequency_hz, "clock": clock}
    known["joint_limits_rad"] = arm.limits.joint_limits_rad()
    written = set(arm.model_fields_set)
    if {"joint_min_deg", "joint_max_deg"} & arm.limits.model_fields_set:
        written.add("joint_limits_rad")
    driver = _made("arm", arm.driver, Arm, ARM_METHODS, needed, known, written, arm.options)
    return cast(Arm, CheckedArm(driver, arm.driver, limits, clock))


def own_gripper(config: BenchConfig, clock: Clock) -> Gripper:
    """Create a user-defined gripper. Raises `InputError`.

    Its constructor must accept spec. It may accept host, port, device, transport, preset, fingers and clock.
    """
    own, spec, needed = config.gripper, config.gripper_spec(), {"spec": config.gripper_spec()}
    keys = ("host", "port", "device", "transport", "preset", "fingers")
    known = {key: getattr(own, key) for key in keys} | {"clock": clock}
    methods, written = GRIPPER_METHODS, own.model_fields_set
    driver = _made("gripper", own.driver, Gripper, methods, needed, known, written, own.options)
    return cast(Gripper, CheckedGripper(driver, own.driver, spec, clock))


def own_source(config: TactileConfig | CameraConfig, clock: Clock) -> TactileSensor:
    """Create a user-defined tactile sensor or camera. Raises `InputError`.

    Its constructor must accept serial and rate_hz. It may accept address, size_px (width, height) and clock.
    """
    serial, rate_hz = config.serial, config.rate_hz
    needed = {"serial": serial, "rate_hz": rate_hz}
    known = {"address": config.address, "size_px": config.size_px, "clock": clock}
    kind = TactileSensor if isinstance(config, TactileConfig) else FrameSource
    written, options = config.model_fields_set, config.options
    driver = _made(serial, config.driver, kind, SOURCE_METHODS, needed, known, written, options)
    return cast(TactileSensor, CheckedSource(driver, config.driver, serial, rate_hz, config.size_px))


def _made(
    device: str,
    name: str,
    protocol: type[Any],
    methods: Iterable[str],
    needed: Mapping[str, Any],
    known: Mapping[str, Any],
    written: Set[str],
    options: Mapping[str, Any],
) -> Any:
    """Import a class and call it.

    methods: those of the Protocol that a class must implement. needed: arguments that it must accept.
    known: arguments that it may accept. written: keys in the bench file; those of `known` among them must not
    be ignored silently.
    """
    what = f"{device}: driver '{name}'"
    found = named_class(name, f"{device}: driver")
    try:
        takes = inspect.signature(found).parameters
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: its constructor cannot be inspected ({error}); write one") from error
    own = {method: getattr(found, method, None) for method in methods}
    # a method that is only inherited from the Protocol is an empty one
    missing = [each for each, of in own.items() if not callable(of) or of is getattr(protocol, each)]
    if missing:
        raise InputError(f"{what}: {found.__name__} does not implement {', '.join(missing)}")
    all_of_them = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in takes.values())
    for key in (*needed, *(known.keys() & written - MAY_BE_IGNORED), *options):
        if key not in takes and not all_of_them:
            own = "option" if key in options else "argument"
            raise InputError(
                f"{what}: {found.__name__} accepts no {own} {key}; it accepts {', '.join(takes)}"
            )
    if doubled := sorted({*needed, *known} & {*options}):
        raise InputError(f"{what}: options contains {doubled[0]}, which the rig sets itself; remove it there")
    given = {**needed, **{key: value for key, value in known.items() if key in takes or all_of_them}}
    try:
        return found(**given, **options)
    except RigError:
        raise
    except Exception as error:
        raise InputError(
            f"{what}: creating it raised {raised_text(error)}; see its options in the bench file"
        ) from error
