"""The handle of a simulated motion, for the arm and the gripper alike."""

from collections.abc import Callable

from drivers.clock import Clock, to_ns
from drivers.errors import DeviceTimeoutError
from drivers.interfaces import Motion

POLL_S = 0.008


class FakeMotion(Motion):
    """A motion whose device says when it is done (raising what is wrong) and how to stop it."""

    def __init__(
        self, device: str, clock: Clock, is_done: Callable[[], bool], stop: Callable[[], None]
    ) -> None:
        self._device = device
        self._clock = clock
        self._is_done = is_done
        self._stop = stop

    def done(self) -> bool:
        """Whether the motion has ended."""
        return self._is_done()

    def wait(self, timeout_s: float) -> None:
        """Block until the motion has ended, see `drivers.interfaces.Motion`."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while not self.done():
            if self._clock.now_ns() >= deadline:
                self._stop()
                raise DeviceTimeoutError(
                    f"{self._device}: motion not finished after {timeout_s:.1f} s; stopped it"
                )
            self._clock.sleep_until(self._clock.now_ns() + to_ns(POLL_S))
