"""The one wrapper in front of a lab's own driver: limits, typed errors, valid answers.

A guard forwards each call. It rejects a motion beyond the bench file's limits before the driver is called,
turns any other exception of the driver into a `DeviceError` that names it, and rejects invalid answers.
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
from drivers.types import ArmLimits, ArmState, Frame, GripperSpec, GripperState, Pose
from drivers.values import require_fraction, require_integer

AHEAD_S = 0.05
"""By how much a state's time may be ahead of the clock, as a controller's time is mapped with an error."""
Answer = TypeVar("Answer")
Limits = TypeVar("Limits", ArmLimits, GripperSpec)
_log = logging.getLogger("rig.bench.guard")


@contextmanager
def doing(whose: str, what: str) -> Iterator[None]:
    """Turn a driver's own exceptions into a `DeviceError`; add its name to an `InvalidStateError`."""
    try:
        yield
    except InvalidStateError as error:
        raise InvalidStateError(f"{whose}: {what}: {error}") from error
    except RigError:
        raise
    except Exception as error:
        raise amiss(whose, f"{what} raised {type(error).__name__}: {error}") from error


def amiss(whose: str, what: str) -> DeviceError:
    """Return the error for a defect of a driver."""
    return DeviceError(f"{whose}: {what}; mend the driver")


class Guard(Diagnosable):
    """Common part of all guards. device: its name in messages. driver: the guarded one; named: its class."""

    def __init__(self, device: str, driver: Any, named: str) -> None:
        self._driver, self._named = driver, named
        self._whose = f"{device}: driver '{named}'"

    def connect(self) -> None:
        """Reach the device."""
        self._ask("connect")

    def disconnect(self) -> None:
        """Let go of the device. Safe to call twice."""
        self._ask("disconnect")

    def identity(self) -> Mapping[str, str]:
        """Return the driver's description of the device, and the name of the driver's class."""
        return {**self._ask("identity", otherwise=super().identity), "driver": self._named}

    def counters(self) -> Mapping[str, int]:
        """How often something happened, by name."""
        return self._ask("counters", otherwise=super().counters)

    def round_trips_s(self) -> Sequence[float]:
        """Durations of the newest answered requests, s."""
        return self._ask("round_trips_s", otherwise=super().round_trips_s)

    def clock_offset_s(self) -> float | None:
        """The device's time minus this computer's monotonic time, s; None if the device reports no time."""
        return self._ask("clock_offset_s", otherwise=super().clock_offset_s)

    def _ask(self, what: str, *given: Any, otherwise: Callable[..., Any] | None = None) -> Any:
        """Call a method of the driver; `otherwise` replaces a method that the driver may lack."""
        with doing(self._whose, what):
            method = getattr(self._driver, what, None) or otherwise or getattr(self._driver, what)
            return method(*given)

    def _typed(self, what: str, given: object, kind: type[Answer]) -> Answer:
        """Return an answer of the right type. Raises `DeviceError`."""
        if not isinstance(given, kind):
            raise amiss(self._whose, f"{what} returned a {type(given).__name__}, no {kind.__name__}")
        return given


class GuardedMotion(Motion):
    """A motion of a guarded device. whose: for messages. stop: stops the device."""

    def __init__(self, motion: Any, whose: str, stop: Callable[[], None]) -> None:
        for what in ("done", "wait"):
            if not callable(getattr(motion, what, None)):
                raise amiss(whose, f"returned a {type(motion).__name__} that has no {what}(), no Motion")
        self._motion, self._whose, self._stop = motion, whose, stop

    def done(self) -> bool:
        """Whether the motion has ended."""
        with doing(self._whose, "a motion's done"):
            return bool(self._motion.done())

    def wait(self, timeout_s: float) -> None:
        """Block until done. A wait that ends early stops the device, also if the driver's own did not."""
        try:
            with doing(self._whose, "a motion's wait"):
                self._motion.wait(timeout_s)
        except BaseException:
            with suppress(DeviceError):  # the first error says more
                self._stop()
            raise


class GuardedActuator(Guard, Generic[Limits]):
    """Common part of the guards of arm and gripper. clock: the one that the states' times are of.

    kind: its name in messages. stale_s: largest age of a state, as in the rig's own drivers
    (`drivers.ur5e.link`, `drivers.robotiq_3f.poller`).
    """

    kind: ClassVar[str]
    stale_s: ClassVar[float]

    def __init__(self, driver: Any, named: str, limits: Limits, clock: Clock) -> None:
        super().__init__(self.kind, driver, named)
        self._limits, self._clock = limits, clock

    def stop(self) -> None:
        """Stop the device as fast as it can; log as critical if the driver fails to."""
        try:
            self._ask("stop")
        except DeviceError as error:
            _log.critical("%s; press the emergency stop", error)
            raise

    def _move(self, what: str, *given: Any) -> Motion:
        return GuardedMotion(self._ask(what, *given), f"{self._whose}: {what}", self.stop)

    def _require_current(self, time_ns: int) -> None:
        """Raise if a state is too old or from the future: with it nothing could be stopped in time."""
        age_s = (self._clock.now_ns() - time_ns) / NS_PER_S
        if age_s > self.stale_s:
            raise DeviceTimeoutError(
                f"{self._whose}: its newest state is {age_s:.2f} s old (limit {self.stale_s:g} s), so that "
                "the present one is unknown; look at the device, then check its driver"
            )
        if age_s < -AHEAD_S:
            raise InvalidStateError(
                f"{self._whose}: the time of its state is {-age_s:.2f} s in the future; use clock.now_ns()"
            )


class GuardedArm(GuardedActuator[ArmLimits], Arm):
    """A lab's own arm, within the bench file's limits."""

    kind, stale_s = "arm", 0.4

    @property
    def limits(self) -> ArmLimits:
        """The bench file's limits, whatever the driver's own are."""
        return self._limits

    def state(self) -> ArmState:
        """Newest state. Raises `DeviceError`."""
        state = self._typed("state", self._ask("state"), ArmState)
        self._require_current(state.time_ns)
        has_sensor = self._limits.max_contact_force_n is not None
        if has_sensor and state.wrench is None:
            raise InvalidStateError(
                f"{self._whose}: its state has no wrench, so that nothing would stop it on its way down; "
                "return the wrench, or write force_sensor = false in [arm] of the bench file"
            )
        if not has_sensor and state.wrench is not None:
            raise InvalidStateError(
                f"{self._whose}: its state has a wrench, and the bench file says force_sensor = false; "
                "remove that key, or return None as wrench"
            )
        return state

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Start a straight motion. Raises `OutOfLimitsError` before the driver is called."""
        check_motion(self._limits, base_T_tcp, speed_m_s, acceleration_m_s2)
        check_way(self._limits, (self.state().base_T_tcp, base_T_tcp))
        return self._move("move_linear", base_T_tcp, speed_m_s, acceleration_m_s2)

    def begin_guiding(self) -> None:
        """Let a person lead the arm by hand. Raises `DeviceError` if the driver cannot do that."""
        self._ask("begin_guiding", otherwise=super().begin_guiding)

    def end_guiding(self) -> None:
        """Hold the arm where it is, and return when it stands."""
        self._ask("end_guiding", otherwise=super().end_guiding)

    def speed_fraction(self) -> float | None:
        """Share of their speed at which motions would run, None if unknown. Raises `DeviceError`."""
        fraction = self._ask("speed_fraction", otherwise=super().speed_fraction)
        with doing(self._whose, "speed_fraction"):
            if fraction is not None:
                require_fraction("the arm's speed_fraction", fraction)
        return fraction

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Release a protective stop, once a person agrees."""
        self._ask("recover", confirm)


class GuardedGripper(GuardedActuator[GripperSpec], Gripper):
    """A lab's own gripper, within the bench file's limits."""

    kind, stale_s = "gripper", 0.9

    @property
    def spec(self) -> GripperSpec:
        """The bench file's range and resolution, whatever the driver's own are."""
        return self._limits

    def activate(self) -> None:
        """Run the activation sequence, on request only."""
        self._ask("activate")

    def state(self) -> GripperState:
        """Newest state. Raises `DeviceError`, also for an opening that the bench file's range excludes."""
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
    """A lab's own tactile sensor or camera. size_px: width and height that its frames have."""

    def __init__(
        self, driver: Any, named: str, serial: str, rate_hz: float, size_px: tuple[int, int]
    ) -> None:
        super().__init__(serial, driver, named)
        self._serial, self._rate_hz, self._shape = serial, rate_hz, (size_px[1], size_px[0], 3)

    @property
    def serial(self) -> str:
        """Serial number, as the bench file says."""
        return self._serial

    @property
    def rate_hz(self) -> float:
        """Requested frame rate, as the bench file says."""
        return self._rate_hz

    def next_frame(self, timeout_s: float) -> Frame:
        """Oldest frame not read yet; waits for one. Raises `DeviceError`."""
        return self._frame("next_frame", timeout_s)

    def newest_frame(self, max_age_s: float) -> Frame:
        """Newest frame. Raises `DeviceError`."""
        return self._frame("newest_frame", max_age_s)

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1, if the driver can."""
        self._ask("set_light", red, green, blue, otherwise=lambda *_: None)

    def _frame(self, what: str, limit_s: float) -> Frame:
        frame = self._typed(what, self._ask(what, limit_s), Frame)
        self._typed(f"{what}: image", frame.image, np.ndarray)
        with doing(self._whose, what):
            require_integer("the frame's time_ns", frame.time_ns)
            require_integer("the frame's sequence", frame.sequence)
        if frame.image.dtype != np.uint8 or frame.image.shape != self._shape:
            raise DamagedFrameError(
                f"{self._whose}: a frame is {frame.image.dtype} {frame.image.shape}, and size_px asks for "
                f"uint8 {self._shape}; correct size_px in the bench file, or the driver"
            )
        if frame.serial != self._serial:
            raise amiss(self._whose, f"{what}: a frame of '{frame.serial}'")
        return frame
