"""The thread that owns a gripper's Modbus connection: polls the status and sends commands.

A pymodbus client must not be shared between threads. Other threads read the newest status or queue a command;
none of them waits longer than `ANSWER_S`, however the connection fails.
"""

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass

from drivers.clock import Clock, host_s, to_ns, wait_until
from drivers.errors import DeviceError, DeviceTimeoutError, NotConnectedError
from drivers.robotiq_3f.modbus import Link, StatusClient
from drivers.robotiq_3f.registers import REFRESH_S, Status, unpack_status

POLL_S = 0.01
"""Pause between two reads of the status, and between two checks of it by a waiting caller."""
RETRY_S = 0.1
"""Pause between attempts on a dead connection."""
ANSWER_S = 0.9
"""Longest wait of any caller; a request and its retry have failed by then, however they fail."""

Registers = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class StatusSample:
    """A status and the time of its request, ns; the status is not older than that, however late its reply."""

    time_ns: int
    status: Status


class GripperLine:
    """One connection, usable by any thread from `open` to `close`. It cannot be reopened."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._name = link.name
        self._clock = clock
        self._requests = StatusClient(link, clock)
        self._jobs: queue.Queue[tuple[Registers, Future[None]]] = queue.Queue()
        self._news = threading.Condition()
        self._newest: StatusSample | None = None
        self._error: DeviceError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._own, name=link.name, daemon=True)

    def open(self) -> StatusSample:
        """Open the connection and return a first status. Raises `DeviceError` with the connection closed."""
        self._thread.start()
        try:
            return self.sample()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection, within `ANSWER_S` even if it is dead."""
        self._closing.set()
        self._thread.join(host_s(self._clock, ANSWER_S))

    def send(self, registers: Registers) -> None:
        """Write a command image. Raises `DeviceError`; a command not sent in time is never sent later."""
        self._require_open()
        done: Future[None] = Future()
        self._jobs.put((registers, done))
        try:
            done.result(host_s(self._clock, ANSWER_S))
        except (TimeoutError, CancelledError):
            done.cancel()
            raise DeviceTimeoutError(
                f"{self._name}: command not acknowledged within {ANSWER_S} s; check power and cable"
            ) from None

    def sample(self) -> StatusSample:
        """Return the newest status; wait for the first one. Raises `DeviceError`, also if it is too old."""
        self._require_open()
        with self._news:
            answer_s = host_s(self._clock, ANSWER_S)
            self._news.wait_for(lambda: self._error is not None or self._newest is not None, answer_s)
            if self._error is not None:
                raise type(self._error)(*self._error.args) from self._error
            if self._newest is None or self._clock.now_ns() > self._newest.time_ns + to_ns(ANSWER_S):
                raise DeviceTimeoutError(f"{self._name}: no status for {ANSWER_S} s; check power and cable")
            return self._newest

    def watch(self, what: str, reached: Callable[[Status], bool], timeout_s: float) -> None:
        """Wait until `reached` is true for a status requested at least one register refresh from now.

        what: name of the condition in the `DeviceTimeoutError` raised after `timeout_s`.
        """
        start = self._clock.now_ns()

        def seen() -> bool:
            sample = self.sample()
            return sample.time_ns >= start + to_ns(REFRESH_S) and reached(sample.status)

        if not wait_until(self._clock, seen, timeout_s, POLL_S):
            raise DeviceTimeoutError(
                f"{self._name}: {what} not reached within {timeout_s} s; "
                "check power and preset, then activate again"
            )

    def round_trips_s(self) -> Sequence[float]:
        """Return the durations of the last answered requests, s; at most 1000."""
        return tuple(self._requests.round_trips_s)

    def failures(self) -> int:
        """Return the number of failed requests since the connection was opened, retried ones included."""
        return self._requests.failures

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise NotConnectedError(f"{self._name}: used after disconnect; connect the bench first")

    def _own(self) -> None:
        while not self._closing.is_set():
            self._carry_out_next()
            self._poll()
        self._requests.close()

    def _carry_out_next(self) -> None:
        try:
            pause_s = host_s(self._clock, RETRY_S if self._error else POLL_S)
            registers, done = self._jobs.get(timeout=pause_s)
        except queue.Empty:
            return
        if self._closing.is_set() or not done.set_running_or_notify_cancel():
            return
        try:
            self._requests.write_command(registers)
        except DeviceError as error:
            done.set_exception(error)
        else:
            done.set_result(None)

    def _poll(self) -> None:
        asked_ns = self._clock.now_ns()
        try:
            status = unpack_status(self._requests.read_status())
        except DeviceError as error:
            self._publish(self._newest, error)
        else:
            self._publish(StatusSample(asked_ns, status), None)

    def _publish(self, sample: StatusSample | None, error: DeviceError | None) -> None:
        with self._news:
            self._newest, self._error = sample, error
            self._news.notify_all()
