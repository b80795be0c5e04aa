"""The one way to wait for a motion: its device is asked whether it goes on; a wait that fails stops it."""

from collections.abc import Callable
from contextlib import suppress

from drivers.clock import Clock, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError
from drivers.interfaces import Motion

POLL_S = 0.008


class PolledMotion(Motion):
    """A motion in progress, real or simulated.

    device: for messages. ended: whether the device has ended the motion, raising what is wrong with
    it. stop: stops the device.
    """

    def __init__(
        self, device: str, clock: Clock, ended: Callable[[], bool], stop: Callable[[], None]
    ) -> None:
        self._device = device
        self._clock = clock
        self._ended = ended
        self._stop = stop

    def done(self) -> bool:
        """Whether the motion has ended, see `drivers.interfaces.Motion`."""
        return self._ended()

    def wait(self, timeout_s: float) -> None:
        """Block until done, see `drivers.interfaces.Motion`."""
        try:
            if not wait_until(self._clock, self.done, timeout_s, POLL_S):
                raise DeviceTimeoutError(
                    f"{self._device}: motion not finished after {timeout_s:.1f} s; stopped it"
                )
        except BaseException:  # an interruption as well: what nobody watches does not go on
            with suppress(DeviceError):  # the first error says more
                self._stop()
            raise
