"""Guards around user-defined drivers: they enforce limits, typed errors and valid return values.

A guard forwards each call. It rejects a motion beyond the bench file's limits before the driver is called,
converts any other exception of the driver to a `DeviceError` with the driver's name, and rejects invalid
values.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.errors import (
    DamagedFrameError,
    DeviceError,
    DeviceTimeoutError,
    InvalidStateError,
    RigError,
)
from drivers.interfaces import Arm, Diagnosable, Gripper, Motion, TactileSensor
from drivers.motion import check_motion, check_way
from drivers.named_classes import raised_text
from drivers.types import ArmLimits, ArmState, Frame, GripperSpec, GripperState, Pose
from drivers.values import require_fraction, require_integer

AHEAD_S = 0.05
"""Largest accepted time of a state in the future: converting a controller's time has an error."""
Answer = TypeVar("Answer")
Limits = TypeVar("Limits", ArmLimits, GripperSpec)
_log = logging.getLogger("rig.bench.guard")


@contextmanager
def doing(whose: str, what: str) -> Iterator[None]:
    """Convert a driver's exceptions to `DeviceError`; add the driver's name to an `InvalidStateError`."""
    try:
        yield
    except InvalidStateError as error:
        raise InvalidStateError(f"{whose}: {what}: {error}") from error
    except RigError:
        raise
    except Exception as error:
        raise amiss(whose, f"{what} raised {raised_text(error)}") from error


def amiss(whose: str, what: str) -> DeviceError:
    """Return the error for a bug in a driver."""
    return DeviceError(f"{whose}: {what}; fix the driver")


class Guard(Diagnosable):
    """Base class of all guards. device: name in messages. driver: the guarded object. named: its class."""

    def __init__(self, device: str, driver: Any, named: str) -> None:
        self._driver, self._named = driver, named
        self._whose = f"{device}: driver '{named}'"

    def connect(self) -> None:
        """Connect to the device."""
        self._ask("connect")

    def disconnect(self) -> None:
        """Close the connection. Safe to call twice."""
        self._ask("disconnect")

    def identity(self) -> Mapping[str, str]:
        """Return the driver's description of the device, and the name of the driver's class."""
        return {**self._ask("identity", otherwise=super().identity), "driver": self._named}

    def counters(self) -> Mapping[str, int]:
        """Return event counts by name."""
        return self._ask("counters", otherwise=super().counters)

    def round_trips_s(self) -> Sequence[float]:
        """Return the durations of the newest answered requests, s."""
        return self._ask("round_trips_s", otherwise=super().round_trips_s)

    def clock_offset_s(self) -> float | None:
        """Return the device's time minus this computer's monotonic time, s; None without a device clock."""
        return self._ask("clock_offset_s", otherwise=super().clock_offset_s)

    def _ask(self, what: str, *given: Any, otherwise: Callable[..., Any] | None = None) -> Any:
        """Call a method of the driver; `otherwise` replaces a method that the driver may lack."""
        with doing(self._whose, what):
            method = getattr(self._driver, what, None) or otherwise or getattr(self._driver, what)
            return method(*given)

    def _typed(self, what: str, given: object, kind: type[Answer]) -> Answer:
        """Return an answer of the right type. Raises `DeviceError`."""
        if not isinstance(given, kind):
            raise amiss(self._whose, f"{what} returned {type(given).__name__}, expected {kind.__name__}")
        return given


class GuardedMotion(Motion):
    """A motion of a guarded device. whose: for messages. stop: stops the device."""

    def __init__(self, motion: Any, whose: str, stop: Callable[[], None]) -> None:
        for what in ("done", "wait"):
            if not callable(getattr(motion, what, None)):
                raise amiss(whose, f"returned {type(motion).__name__} without {what}(), expected a Motion")
        self._motion, self._whose, self._stop = motion, whose, stop

    def done(self) -> bool:
        """Whether the motion has ended."""
        with doing(self._whose, "a motion's done"):
            return bool(self._motion.done())

    def wait(self, timeout_s: float) -> None:
        """Block until done. If the wait ends early, stop the device, also if the driver's wait did not."""
        try:
            with doing(self._whose, "a motion's wait"):
                self._motion.wait(timeout_s)
        except BaseException:
            with suppress(DeviceError):  # the first error is more informative
                self._stop()
            raise


class GuardedActuator(Guard, Generic[Limits]):
    """Base class of the guards of arm and gripper. clock: the clock of the states' times.

    kind: its name in messages. stale_s: largest age of a state, as in the rig's own drivers
    (`drivers.ur5e.link`, `drivers.robotiq_3f.poller`).
    """

    kind: ClassVar[str]
    stale_s: ClassVar[float]

    def __init__(self, driver: Any, named: str, limits: Limits, clock: Clock) -> None:
        super().__init__(self.kind, driver, named)
        self._limits, self._clock = limits, clock

    def stop(self) -> None:
        """Stop the device as fast as it can; if the driver fails to, log it as critical."""
        try:
            self._ask("stop")
        except DeviceError as error:
            _log.critical("%s; press the emergency stop", error)
            raise

    def _move(self, what: str, *given: Any) -> Motion:
        return GuardedMotion(self._ask(what, *given), f"{self._whose}: {what}", self.stop)

    def _require_current(self, time_ns: int) -> None:
        """Raise if a state is too old or from the future: monitoring could not stop a motion in time."""
        age_s = (self._clock.now_ns() - time_ns) / NS_PER_S
        if age_s > self.stale_s:
            raise DeviceTimeoutError(
                f"{self._whose}: its newest state is {age_s:.2f} s old (limit {self.stale_s:g} s), so its "
                "present state is unknown; inspect the device, then check its driver"
            )
        if age_s < -AHEAD_S:
            raise InvalidStateError(
                f"{self._whose}: the time of its state is {-age_s:.2f} s in the future; use clock.now_ns()"
            )


class GuardedArm(GuardedActuator[ArmLimits], Arm):
    """Guard of a user-defined arm, with the bench file's limits."""

    kind, stale_s = "arm", 0.4

    @property
    def limits(self) -> ArmLimits:
        """The bench file's limits; the driver's own are ignored."""
        return self._limits

    def state(self) -> ArmState:
        """Return the newest state. Raises `DeviceError`."""
        state = self._typed("state", self._ask("state"), ArmState)
        self._require_current(state.time_ns)
        has_sensor = self._limits.max_contact_force_n is not None
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
        """Start a straight motion. Raises `OutOfLimitsError` before the driver is called."""
        check_motion(self._limits, base_T_tcp, speed_m_s, acceleration_m_s2)
        check_way(self._limits, (self.state().base_T_tcp, base_T_tcp))
        return self._move("move_linear", base_T_tcp, speed_m_s, acceleration_m_s2)

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand. Raises `DeviceError` if the driver does not support it."""
        self._ask("begin_guiding", otherwise=super().begin_guiding)

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands."""
        self._ask("end_guiding", otherwise=super().end_guiding)

    def speed_fraction(self) -> float | None:
        """Return the speed fraction at which motions would run, None if unknown. Raises `DeviceError`."""
        fraction = self._ask("speed_fraction", otherwise=super().speed_fraction)
        with doing(self._whose, "speed_fraction"):
            if fraction is not None:
                require_fraction("the arm's speed_fraction", fraction)
        return fraction

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop after a person agrees."""
        self._ask("recover", confirm)


class GuardedGripper(GuardedActuator[GripperSpec], Gripper):
    """Guard of a user-defined gripper, with the bench file's limits."""

    kind, stale_s = "gripper", 0.9

    @property
    def spec(self) -> GripperSpec:
        """The bench file's range and resolution; the driver's own are ignored."""
        return self._limits

    def activate(self) -> None:
        """Run the activation sequence; only on request."""
        self._ask("activate")

    def state(self) -> GripperState:
        """Return the newest state. Raises `DeviceError`, also for an opening outside the range."""
        state = self._typed("state", self._ask("state"), GripperState)
        with doing(self._whose, "state"):
            self._limits.require_possible(state.opening_m)
        self._require_current(state.time_ns)
        return state

    def move_to(
        self, opening_m: float, speed_m_s: float | None = None, force_n: float | None = None
    ) -> Motion:
        """Start moving the fingers. Raises `OutOfLimitsError` before the driver is called."""
        self._limits.require_command(opening_m, speed_m_s, force_n)
        return self._move("move_to", opening_m, speed_m_s, force_n)


class GuardedSource(Guard, TactileSensor):
    """Guard of a user-defined tactile sensor or camera. size_px: required width and height of its frames."""

    def __init__(
        self, driver: Any, named: str, serial: str, rate_hz: float, size_px: tuple[int, int]
    ) -> None:
        super().__init__(serial, driver, named)
        self._serial, self._rate_hz, self._shape = serial, rate_hz, (size_px[1], size_px[0], 3)

    @property
    def serial(self) -> str:
        """Serial number in the bench file."""
        return self._serial

    @property
    def rate_hz(self) -> float:
        """Requested frame rate in the bench file."""
        return self._rate_hz

    def next_frame(self, timeout_s: float) -> Frame:
        """Return the oldest frame not read yet; wait for one. Raises `DeviceError`."""
        return self._frame("next_frame", timeout_s)

    def newest_frame(self, max_age_s: float) -> Frame:
        """Return the newest frame. Raises `DeviceError`."""
        return self._frame("newest_frame", max_age_s)

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1, if the driver supports it."""
        self._ask("set_light", red, green, blue, otherwise=lambda *_: None)

    def _frame(self, what: str, limit_s: float) -> Frame:
        frame = self._typed(what, self._ask(what, limit_s), Frame)
        self._typed(f"{what}: image", frame.image, np.ndarray)
        with doing(self._whose, what):
            require_integer("the frame's time_ns", frame.time_ns)
            require_integer("the frame's sequence", frame.sequence)
        if frame.image.dtype != np.uint8 or frame.image.shape != self._shape:
            raise DamagedFrameError(
                f"{self._whose}: a frame is {frame.image.dtype} {frame.image.shape}, but size_px requires "
                f"uint8 {self._shape}; correct size_px in the bench file, or the driver"
            )
        if frame.serial != self._serial:
            raise amiss(self._whose, f"{what}: a frame of '{frame.serial}'")
        return frame
