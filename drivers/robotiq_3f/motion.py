"""The handle of a motion of the Robotiq 3-Finger gripper."""

from collections.abc import Callable

from drivers.clock import Clock, to_ns
from drivers.errors import DeviceTimeoutError
from drivers.interfaces import Motion

WATCH_S = 0.01


class GripperMotion(Motion):
    """A motion of the fingers; ends at the request, at a contact, or by a stop."""

    def __init__(self, clock: Clock, moving: Callable[[], bool], stop: Callable[[], None]) -> None:
        self._clock = clock
        self._moving = moving
        self._stop = stop

    def done(self) -> bool:
        """Whether the fingers have stopped. Raises what is wrong with the gripper."""
        return not self._moving()

    def wait(self, timeout_s: float) -> None:
        """Block until done, see `drivers.interfaces.Motion`."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        while not self.done():
            if self._clock.now_ns() >= deadline:
                self._stop()
                raise DeviceTimeoutError(f"gripper: motion not finished after {timeout_s:.1f} s; stopped it")
            self._clock.sleep_until(self._clock.now_ns() + to_ns(WATCH_S))
