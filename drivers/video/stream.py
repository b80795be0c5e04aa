"""What every source of frames delivers before it is decoded, and its capture time."""

from dataclasses import dataclass
from typing import Protocol

from drivers.clock import NS_PER_S
from drivers.types import Image

MAX_DELAY_NS = NS_PER_S
"""A first stamp this much older than its arrival, or newer, is of another clock than ours."""


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One image as it came: encoded bytes or pixels, never both.

    encoded: a JPEG, from files also a PNG. image: (H, W, 3) uint8 RGB. arrived_ns: monotonic
    time at which the last byte was here. stamped_ns: capture time the source gives, ns of a
    clock it does not name. number: how many images the source has captured, where it counts.
    """

    arrived_ns: int
    encoded: bytes | None = None
    image: Image | None = None
    stamped_ns: int | None = None
    number: int | None = None


class FrameStream(Protocol):
    """An open source. One thread reads and closes it, any other may interrupt it."""

    warm_up: int
    """Images to discard after opening, while exposure and light settle."""
    stamp: str
    """Who gives `stamped_ns`: "kernel", "peer" or "schedule"."""
    ends: bool
    """Whether it has a last image, as a file has; it is not opened again then."""

    def read(self) -> RawFrame:
        """Wait for the next image. Raises `DeviceError` when no more will come."""
        ...

    def interrupt(self) -> None:
        """End a `read` in progress if that can be done; it raises `DeviceError` then."""
        ...

    def close(self) -> None:
        """Let the source go. Safe to call twice."""
        ...


class CaptureTimes:
    """Chooses the capture time of one stream's images: the source's stamp, or the arrival.

    The first stamp decides: within a second before its arrival, it is of our own monotonic
    clock; anything else is another clock (a remote computer's, or the time of day).
    """

    def __init__(self, stamp: str) -> None:
        self._stamp = stamp
        self._trusted: bool | None = None
        self._last_ns = -1

    @property
    def kind(self) -> str:
        """What the times are: "kernel", "peer", "schedule", or "arrival"."""
        return self._stamp if self._trusted else "arrival"

    def time_of(self, raw: RawFrame) -> int:
        """Return an image's capture time, monotonic ns, later than the one before."""
        stamped = raw.stamped_ns
        if self._trusted is None:
            self._trusted = stamped is not None and 0 <= raw.arrived_ns - stamped < MAX_DELAY_NS
        usable = self._trusted and stamped is not None and self._last_ns < stamped <= raw.arrived_ns
        time_ns = stamped if usable and stamped is not None else raw.arrived_ns
        self._last_ns = max(time_ns, self._last_ns + 1)
        return self._last_ns
