"""Frame buffer of one connection between the reader thread and its users."""

import threading
from collections import deque

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError, StaleFrameError
from drivers.types import Frame

_HINT = "check that it still streams, its cable and its port"


class FrameBuffer:
    """The newest frame, the unread frames, and the reason if no more frames arrive.

    backlog: largest number of unread frames. waits: whether a frame waits for room, instead of replacing the
    oldest unread frame.
    """

    def __init__(self, serial: str, clock: Clock, backlog: int, waits: bool = False) -> None:
        self._serial = serial
        self._clock = clock
        self._waits = waits
        self._changed = threading.Condition()
        self._backlog: deque[Frame] = deque(maxlen=backlog)
        self._newest: Frame | None = None
        self._trouble = ""
        self._remark = _HINT
        self._over = False
        self._closed = False

    def put(self, frame: Frame) -> bool:
        """Add a frame. Return whether the oldest unread frame was dropped for it."""
        with self._changed:
            while self._waits and self._full and not self._closed:
                self._changed.wait()
            full = self._full
            self._backlog.append(frame)
            self._newest, self._trouble, self._remark = frame, "", _HINT
            self._changed.notify_all()
            return full

    def fail(self, trouble: str, over: bool) -> None:
        """Note why no frames arrive. over: no more frames will arrive."""
        with self._changed:
            self._trouble, self._over = trouble, over
            self._changed.notify_all()

    def withhold(self, remark: str) -> None:
        with self._changed:
            self._remark = remark

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def next(self, timeout_s: float) -> Frame:
        """Return the oldest unread frame. Raises `DeviceTimeoutError`, `DeviceError` after the last frame."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        with self._changed:
            while not self._backlog:
                if self._closed:
                    raise NotConnectedError(f"{self._serial}: disconnected; connect the bench first")
                if self._over:
                    raise DeviceError(self._named(self._trouble))
                self._wait(deadline, f"no frame within {timeout_s:.3g} s")
            self._changed.notify_all()
            return self._backlog.popleft()

    def newest(self, max_age_s: float) -> Frame:
        """Return the newest frame and discard the unread ones. Raises `StaleFrameError`."""
        with self._changed:
            frame = self._newest
            if frame is None:
                raise StaleFrameError(f"{self._serial}: no frame received yet; {self._why()}")
            age_s = (self._clock.now_ns() - frame.time_ns) / NS_PER_S
            if age_s > max_age_s:
                raise StaleFrameError(
                    f"{self._serial}: newest frame is {age_s:.3f} s old, over the limit of "
                    f"{max_age_s:.3f} s; {self._why()}"
                )
            self._backlog.clear()
            self._changed.notify_all()
            return frame

    def await_first(self, timeout_s: float) -> None:
        """Wait for the first frame. Raises `DeviceError` if the reader fails before it."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        with self._changed:
            while self._newest is None:
                if self._trouble:
                    raise DeviceError(self._named(self._trouble))
                self._wait(deadline, f"no frame within {timeout_s:.3g} s of opening")

    @property
    def _full(self) -> bool:
        return len(self._backlog) == self._backlog.maxlen

    def _wait(self, deadline_ns: int, missed: str) -> None:
        remaining_ns = deadline_ns - self._clock.now_ns()
        if remaining_ns <= 0:
            raise DeviceTimeoutError(f"{self._serial}: {missed}; {self._why()}")
        self._changed.wait(host_s(self._clock, remaining_ns / NS_PER_S))

    def _named(self, trouble: str) -> str:
        return trouble if trouble.startswith(f"{self._serial}:") else f"{self._serial}: {trouble}"

    def _why(self) -> str:
        return f"{self._trouble}; opening it again" if self._trouble else self._remark
