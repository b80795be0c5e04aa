"""Create user-defined devices from a bench file by their class name.

A class named as `driver = "package.module:Class"` is called with keyword arguments: those of the rig's
arguments for such a device that its constructor accepts, and all keys of the subtable `options`. The bench
then checks limits before a motion, answers and errors (`CheckedDevice`).
"""

import inspect
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.errors import (
    DamagedFrameError,
    DeviceError,
    DeviceTimeoutError,
    InputError,
    InvalidStateError,
    RigError,
)
from drivers.interfaces import Arm, FrameSource, Gripper, TactileSensor
from drivers.motion import Motion, check_motion
from drivers.named_classes import named_class, raised_text
from drivers.types import ArmLimits, ArmState, Frame, GripperSpec, GripperState, Pose
from drivers.values import require_fraction, require_integer
from rig.config.devices import OwnArmConfig, OwnCameraConfig, OwnGripperConfig, OwnTactileConfig

ARM_STALE_S, GRIPPER_STALE_S = 0.4, 0.9
"""Largest age of a state, as in the rig's own drivers (`drivers.ur5e.link`, `drivers.robotiq_3f.modbus`)."""
AHEAD_S = 0.05
"""Largest accepted time of a state in the future: converting a controller's time has an error."""
_log = logging.getLogger("rig.bench.own_devices")


class CheckedDevice:
    """A lab's device: each method of the driver, with its exceptions converted to `DeviceError`.

    driver: the lab's object. named: its class, as in the bench file. device: name in messages. kind: the
    interface, whose defaults replace methods that the driver lacks.
    """

    def __init__(self, driver: Any, named: str, device: str, kind: type[Any]) -> None:
        self._driver, self._named, self._device, self._kind = driver, named, device, kind
        self._whose = f"{device}: driver '{named}'"

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return a method of the driver, or the interface's default of it."""
        if name.startswith("_") or not (hasattr(self._driver, name) or hasattr(self._kind, name)):
            raise AttributeError(name)
        return lambda *given: self._ask(name, *given)

    def identity(self) -> Mapping[str, str]:
        """Return the driver's description of the device, and the name of the driver's class."""
        return {**self._ask("identity"), "driver": self._named}

    def stop(self) -> None:
        """Stop the device as fast as it can; if the driver fails to, log it as critical."""
        try:
            self._ask("stop")
        except DeviceError as error:
            _log.critical("%s; press the emergency stop", error)
            raise

    def _ask(self, what: str, *given: Any) -> Any:
        with self._reporting(what):
            own = getattr(self._driver, what, None)
            return own(*given) if own else getattr(self._kind, what)(self, *given)

    @contextmanager
    def _reporting(self, what: str) -> Iterator[None]:
        """Convert the driver's exceptions to `DeviceError`; add its name to an `InvalidStateError`."""
        try:
            yield
        except InvalidStateError as error:
            raise InvalidStateError(f"{self._whose}: {what}: {error}") from error
        except RigError:
            raise
        except Exception as error:
            raise DeviceError(f"{self._whose}: {what} raised {raised_text(error)}; fix the driver") from error

    def _move(self, clock: Clock, what: str, *given: Any) -> Motion:
        """Begin a motion of the driver; the rig polls its `is_done`, and stops the device if that fails."""
        motion = self._ask(what, *given)
        with self._reporting(what):
            if not callable(getattr(motion, "is_done", None)):
                raise TypeError(f"{type(motion).__name__} instead of Motion")

        def is_done() -> bool:
            with self._reporting("a motion's is_done"):
                return bool(motion.is_done())

        return Motion(self._device, clock, is_done, self.stop)

    def _current_state(self, kind: type[Any], now_ns: int, stale_s: float) -> Any:
        """Return the newest state. Raise if it is old or from the future: no motion would stop in time."""
        with self._reporting("state"):
            state = self._driver.state()
            _require_type(state, kind)  # only these types validate their values
            age_s = (now_ns - state.time_ns) / NS_PER_S
        if age_s > stale_s:
            raise DeviceTimeoutError(
                f"{self._whose}: its newest state is {age_s:.2f} s old (limit {stale_s:g} s), so its "
                "present state is unknown; inspect the device, then check its driver"
            )
        if age_s < -AHEAD_S:
            raise InvalidStateError(
                f"{self._whose}: the time of its state is {-age_s:.2f} s in the future; use clock.now_ns()"
            )
        return state


class CheckedArm(CheckedDevice):
    """A lab's arm. limits: those of the bench file; the driver's own are ignored."""

    def __init__(self, driver: Any, named: str, limits: ArmLimits, clock: Clock) -> None:
        super().__init__(driver, named, "arm", Arm)
        self.limits, self._clock = limits, clock

    def state(self) -> ArmState:
        """Return the newest state. Raises `DeviceError` if it is invalid, too old, or lacks the wrench."""
        state: ArmState = self._current_state(ArmState, self._clock.now_ns(), ARM_STALE_S)
        has_sensor = self.limits.max_contact_force_n is not None
        if has_sensor and state.wrench is None:
            raise InvalidStateError(
                f"{self._whose}: its state has no wrench, so a downward motion would not stop at contact; "
                "return the wrench, or write force_sensor = false in [arm] of the bench file"
            )
        if not has_sensor and state.wrench is not None:
            raise InvalidStateError(
                f"{self._whose}: its state has a wrench, but the bench file has force_sensor = false; "
                "remove that key, or return None as wrench"
            )
        return state

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        check_motion(self.limits, self.state().base_T_tcp, base_T_tcp, speed_m_s, acceleration_m_s2)
        return self._move(self._clock, "move_linear", base_T_tcp, speed_m_s, acceleration_m_s2)

    def speed_fraction(self) -> float | None:
        """Return the speed fraction at which motions would run, None if unknown. Raises `DeviceError`."""
        fraction: float | None = self._ask("speed_fraction")
        if fraction is not None:
            with self._reporting("speed_fraction"):
                require_fraction("the arm's speed_fraction", fraction)
        return fraction


class CheckedGripper(CheckedDevice):
    """A lab's gripper. spec: range and resolution of the bench file; the driver's own are ignored."""

    def __init__(self, driver: Any, named: str, spec: GripperSpec, clock: Clock) -> None:
        super().__init__(driver, named, "gripper", Gripper)
        self.spec, self._clock = spec, clock

    def state(self) -> GripperState:
        """Return the newest state. Raises `DeviceError`, also for an opening outside the range."""
        state: GripperState = self._current_state(GripperState, self._clock.now_ns(), GRIPPER_STALE_S)
        with self._reporting("state"):
            self.spec.require_possible(state.opening_m)
        return state

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        self.spec.require_command(opening_m, speed_m_s, force_n)
        return self._move(self._clock, "move_to", opening_m, speed_m_s, force_n)


class CheckedSource(CheckedDevice):
    """A lab's tactile sensor or camera, with the serial, rate and size in px of the bench file."""

    waits = False

    def __init__(
        self, driver: Any, named: str, serial: str, rate_hz: float, size_px: tuple[int, int]
    ) -> None:
        super().__init__(driver, named, serial, TactileSensor)
        self.serial, self.rate_hz, self._shape = serial, rate_hz, (size_px[1], size_px[0], 3)

    def next_frame(self, timeout_s: float) -> Frame:
        return self._frame("next_frame", timeout_s)

    def newest_frame(self, max_age_s: float) -> Frame:
        return self._frame("newest_frame", max_age_s)

    def _frame(self, what: str, limit_s: float) -> Frame:
        frame = self._ask(what, limit_s)
        with self._reporting(what):
            _require_type(frame, Frame)
            _require_type(frame.image, np.ndarray)
            given = (frame.image.dtype, frame.image.shape, frame.serial)
            require_integer("the frame's time_ns", frame.time_ns)
            require_integer("the frame's sequence", frame.sequence)
        if given != (np.uint8, self._shape, self.serial):
            raise DamagedFrameError(
                f"{self._whose}: a frame of '{given[2]}' is {given[0]} {given[1]}, but the bench file "
                f"requires uint8 {self._shape} of '{self.serial}'; correct size_px, serial or the driver"
            )
        return frame


def _require_type(answer: object, kind: type[Any]) -> None:
    if not isinstance(answer, kind):
        raise TypeError(f"{type(answer).__name__} instead of {kind.__name__}")


ARM_METHODS = ("connect", "disconnect", "state", "move_linear", "stop", "recover")
GRIPPER_METHODS = ("connect", "disconnect", "activate", "state", "move_to", "stop")
SOURCE_METHODS = ("connect", "disconnect", "next_frame", "newest_frame")
MAY_BE_IGNORED = frozenset({"fingers", "size_px"})
"""Keys that the bench file always has, and that a constructor need not accept."""


def own_arm(arm: OwnArmConfig, limits: ArmLimits, clock: Clock) -> Arm:
    """Create a user-defined arm. Raises `InputError`.

    Its constructor must accept limits, flange_T_tcp, payload_kg and payload_cog_m, as `UR5e`. It may accept
    host, frequency_hz, joint_limits_rad (lowest and highest, rad) and clock.
    """
    needed = {"limits": limits, "flange_T_tcp": arm.flange_T_tcp()}
    needed |= {"payload_kg": arm.payload_kg, "payload_cog_m": arm.payload_cog_m}
    known = {"host": arm.host, "frequency_hz": arm.frequency_hz, "clock": clock}
    known["joint_limits_rad"] = arm.limits.joint_limits_rad()
    joints = {"joint_min_deg", "joint_max_deg"} & arm.limits.model_fields_set
    driver = _make_device(
        "arm", arm, Arm, ARM_METHODS, needed, known, {"joint_limits_rad"} if joints else set()
    )
    return cast(Arm, CheckedArm(driver, arm.driver, limits, clock))


def own_gripper(own: OwnGripperConfig, spec: GripperSpec, clock: Clock) -> Gripper:
    """Create a user-defined gripper. Raises `InputError`.

    Its constructor must accept spec. It may accept host, port, device, transport, preset, fingers and clock.
    """
    keys = ("host", "port", "device", "transport", "preset", "fingers")
    known = {key: getattr(own, key) for key in keys} | {"clock": clock}
    driver = _make_device("gripper", own, Gripper, GRIPPER_METHODS, {"spec": spec}, known)
    return cast(Gripper, CheckedGripper(driver, own.driver, spec, clock))


def own_source(config: OwnTactileConfig | OwnCameraConfig, clock: Clock) -> TactileSensor:
    """Create a user-defined tactile sensor or camera. Raises `InputError`.

    Its constructor must accept serial and rate_hz. It may accept address, size_px (width, height) and clock.
    """
    serial, rate_hz = config.serial, config.rate_hz
    known = {"address": config.address, "size_px": config.size_px, "clock": clock}
    kind = TactileSensor if isinstance(config, OwnTactileConfig) else FrameSource
    driver = _make_device(serial, config, kind, SOURCE_METHODS, {"serial": serial, "rate_hz": rate_hz}, known)
    return cast(TactileSensor, CheckedSource(driver, config.driver, serial, rate_hz, config.size_px))


def _make_device(
    device: str,
    section: OwnArmConfig | OwnGripperConfig | OwnTactileConfig | OwnCameraConfig,
    protocol: type[Any],
    methods: Iterable[str],
    needed: Mapping[str, Any],
    known: Mapping[str, Any],
    written: Set[str] = frozenset(),
) -> Any:
    """Import the class that a section of the bench file names, and call it.

    methods: those of the Protocol that a class must implement. needed: arguments that it must accept.
    known: arguments that it may accept; those that are keys in the section, or in `written`, must not be
    ignored silently.
    """
    options, what = section.options, f"{device}: driver '{section.driver}'"
    found = named_class(section.driver, f"{device}: driver")
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
    in_file = (section.model_fields_set | written) - MAY_BE_IGNORED
    for key in (*needed, *(known.keys() & in_file), *options):
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
