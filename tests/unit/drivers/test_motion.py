"""Polled motions: they are polled until the device reports the end, and stopped at their time limit."""

import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.motion import POLL_S, PolledMotion
from fakes.clock import SimulatedClock


class Device:
    """A motion that ends at a given time, or by a stop."""

    def __init__(self, ends_s: float, breaks_s: float = 1e9) -> None:
        self.clock = SimulatedClock()
        self.stops = 0
        self._ends_ns, self._breaks_ns = to_ns(ends_s), to_ns(breaks_s)

    def ended(self) -> bool:
        if self.clock.now_ns() >= self._breaks_ns:
            raise DeviceError("hand: broken")
        return self.clock.now_ns() >= self._ends_ns

    def stop(self) -> None:
        self.stops += 1

    def motion(self) -> PolledMotion:
        return PolledMotion("hand", self.clock, self.ended, self.stop)


def test_motion_is_stopped_at_its_timeout() -> None:
    device = Device(ends_s=5.0)
    with pytest.raises(DeviceTimeoutError, match="not finished after"):
        device.motion().wait(1.0)
    assert 1.0 <= device.clock.now_ns() / 1e9 <= 1.0 + POLL_S
    assert device.stops == 1


def test_device_error_ends_the_wait_and_stops_the_motion() -> None:
    device = Device(ends_s=5.0, breaks_s=0.2)
    with pytest.raises(DeviceError, match="hand: broken"):
        device.motion().wait(1.0)
    assert device.stops == 1


def test_first_error_is_raised_if_the_stop_fails_too() -> None:
    device = Device(ends_s=5.0, breaks_s=0.2)

    def refuse() -> None:
        raise DeviceError("hand: does not listen")

    with pytest.raises(DeviceError, match="hand: broken"):
        PolledMotion("hand", device.clock, device.ended, refuse).wait(1.0)


def test_motion_is_stopped_if_its_wait_is_interrupted() -> None:
    device = Device(ends_s=5.0)

    def interrupted() -> bool:
        if device.clock.now_ns() >= to_ns(0.2):
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        PolledMotion("hand", device.clock, interrupted, device.stop).wait(1.0)
    assert device.stops == 1
