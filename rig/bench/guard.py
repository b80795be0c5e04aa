"""What the guards of all devices share: errors that name the driver, and states that are current."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from drivers.clock import NS_PER_S, Clock
from drivers.errors import DeviceError, DeviceTimeoutError, InvalidStateError, RigError
from drivers.interfaces import Diagnosable, Motion

Answer = TypeVar("Answer")
AHEAD_S = 0.05
"""By how much a state's time may be ahead of the clock, as a controller's time is mapped with an error."""
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
    """What is wrong with a driver, as an error."""
    return DeviceError(f"{whose}: {what}; mend the driver")


def answer(whose: str, what: str, given: object, kind: type[Answer]) -> Answer:
    """Return an answer of the right type. Raises `DeviceError`."""
    if not isinstance(given, kind):
        raise amiss(whose, f"{what} returned a {type(given).__name__}, no {kind.__name__}")
    return given


class Guard(Diagnosable):
    """What all guards do. device: its name in messages. driver: the guarded one; named: its class."""

    def __init__(self, device: str, driver: Any, named: str) -> None:
        self._driver, self._named = driver, named
        self._whose = f"{device}: driver '{named}'"

    def connect(self) -> None:
        """Reach the device."""
        with doing(self._whose, "connect"):
            self._driver.connect()

    def disconnect(self) -> None:
        """Let go of the device. Safe to call twice."""
        with doing(self._whose, "disconnect"):
            self._driver.disconnect()

    def identity(self) -> Mapping[str, str]:
        """What the driver says of the device, and which class it is."""
        return {**self._told("identity", {}), "driver": self._named}

    def counters(self) -> Mapping[str, int]:
        """How often something happened, by name."""
        return self._told("counters", {})

    def round_trips_s(self) -> Sequence[float]:
        """Durations of the newest answered requests, s."""
        return self._told("round_trips_s", ())

    def clock_offset_s(self) -> float | None:
        """The device's time minus this computer's monotonic time, s; None where it tells no time."""
        return self._told("clock_offset_s", None)

    def _told(self, what: str, nothing: Any) -> Any:
        ask = getattr(self._driver, what, None)
        if ask is None:
            return nothing
        with doing(self._whose, what):
            return ask()

    def _stop(self) -> None:
        """Stop; where the driver cannot, say so as loudly as can be."""
        try:
            with doing(self._whose, "stop"):
                self._driver.stop()
        except DeviceError as error:
            _log.critical("%s; press the emergency stop", error)
            raise


class StateGuard(Guard):
    """A guard of a device that reports states. clock: the one that the states' times are of."""

    def __init__(self, device: str, driver: Any, named: str, clock: Clock) -> None:
        super().__init__(device, driver, named)
        self._clock = clock

    def require_current(self, time_ns: int, limit_s: float) -> None:
        """Raise for a state that is too old, or from the future: nothing could be stopped by it in time."""
        age_s = (self._clock.now_ns() - time_ns) / NS_PER_S
        if age_s > limit_s:
            raise DeviceTimeoutError(
                f"{self._whose}: its newest state is {age_s:.2f} s old (limit {limit_s:g} s), so that the "
                "present one is unknown; look at the device, then check its driver"
            )
        if age_s < -AHEAD_S:
            raise InvalidStateError(
                f"{self._whose}: the time of its state is {-age_s:.2f} s in the future; use clock.now_ns()"
            )


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
