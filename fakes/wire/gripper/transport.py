"""What the two transports of the simulated gripper share: registers, 200 Hz refresh, faults, the thread."""

import contextlib
import random
import selectors
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import InputError
from fakes.wire.gripper import modbus_frames as frames
from fakes.wire.gripper.model import REFRESH_NS, GripperModel
from fakes.wire.injection import Faults
from fakes.wire.net import VitalThread
from fakes.world.world import World

FAULTS: dict[str, dict[str, Any]] = {
    "silent": {},
    "delay": {"delay_s": 0.35},
    "truncate": {"size": 4},
    "garbage": {"seed": 0},
    "exception": {"code": 4},
    "disconnect": {},
    "power_lost": {},
    "fault": {"code": 0x0D},
    "blocked": {},
    "stuck": {},
    "false_success": {},
    "overshoot": {},
    "deaf": {},
}
"""Kinds of fault and the defaults of their arguments."""
Send = Callable[[bytes], None]


class WireGripper(ABC):
    """The gripper behind a transport, which opens a line, closes it, and reads requests from it."""

    refuses_silently = False
    """Whether a refused request gets no answer, instead of an exception reply."""

    def __init__(
        self, world: World, clock: Clock, preset: str, fingers: tuple[str, ...], activation_s: float
    ) -> None:
        self._clock = clock
        self._model = GripperModel(world, clock.now_ns(), fingers, activation_s)
        self._registers = frames.Registers(self._model, preset)
        self._faults = Faults("simulated gripper", FAULTS, clock.now_ns)
        self._late: list[tuple[int, Send, bytes]] = []
        self._requests = self._replies = 0
        self._random = random.Random(0)  # noqa: S311 - noise on a line, not a secret
        self._selector = selectors.DefaultSelector()
        self._stopping = threading.Event()
        self._thread: VitalThread | None = None
        self._lock = threading.RLock()
        self._next_tick_ns = 0

    def start(self) -> None:
        """Open the line and serve it from a thread. Raises `InputError` if it is in use."""
        self._stopping.clear()
        self._open()
        self._thread = VitalThread(self._serve, "simulated gripper")
        self._thread.start()

    @property
    def failure(self) -> Exception | None:
        """The error that ended the gripper, None if there was none."""
        return self._thread.failure if self._thread else None

    def stop(self) -> None:
        """Stop serving. Safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def inject(self, kind: str, **arguments: Any) -> None:
        """Start a fault of `FAULTS`, or end all with "clear". Raises `InputError` for an unknown one."""
        with self._lock:
            if kind == "clear":
                self._faults.clear()
                self._model.clear_fault()
            else:
                settings, now_ns = self._faults.begin(kind, arguments), self._clock.now_ns()
                if kind == "fault":
                    self._model.fail(settings["code"], now_ns)
                elif kind == "power_lost":
                    self._model.lose_power(now_ns)
                elif kind == "garbage":
                    self._random.seed(settings["seed"])
            self._model.faults = self._faults.names()

    def snapshot(self) -> dict[str, Any]:
        """Return the counts of requests and replies, both register images in hex, and the active faults."""
        with self._lock:
            return {
                "requests": self._requests,
                "replies": self._replies,
                "written": self._model.written.hex(),
                "status": self._model.image.hex(),
                "faults": sorted(self._faults.names()),
            }

    @abstractmethod
    def _open(self) -> None:
        """Open the line and register it with the selector. Raises `InputError` if it is in use."""

    @abstractmethod
    def _close(self) -> None:
        """Close everything that is registered with the selector."""

    @abstractmethod
    def _receive(self, key: selectors.SelectorKey) -> None:
        """Read from what has become readable, and pass each complete request to `_handle`."""

    def _serve(self) -> None:
        while not self._stopping.is_set():
            if self._clock.now_ns() >= self._next_tick_ns:
                with self._lock:
                    self._tick(self._clock.now_ns())
            wait_s = max(self._next_tick_ns - self._clock.now_ns(), 0) / NS_PER_S
            if self._is_open:
                for key, _ in self._selector.select(wait_s):
                    self._receive(key)
            else:
                self._stopping.wait(wait_s)
        self._close()

    @property
    def _is_open(self) -> bool:
        return bool(self._selector.get_map())

    def _tick(self, now_ns: int) -> None:
        self._next_tick_ns = now_ns // REFRESH_NS * REFRESH_NS + REFRESH_NS
        self._model.faults = active = self._faults.names()
        self._model.tick(now_ns)
        if "disconnect" in active and self._is_open:
            self._close()
        elif "disconnect" not in active and not self._is_open:
            with contextlib.suppress(InputError):  # in use meanwhile: tried again at the next refresh
                self._open()
        for _, send, frame in [item for item in self._late if item[0] <= now_ns]:
            self._deliver(send, frame)
        self._late = [item for item in self._late if item[0] > now_ns]

    def _handle(self, request: frames.Request, send: Send) -> None:
        with self._lock:
            self._requests += 1
            active = self._faults.names()
            if active & {"silent", "power_lost"}:
                return
            if exception := self._faults.get("exception"):
                reply = frames.exception_reply(request.pdu, exception["code"])
            else:
                reply = frames.answer(request.pdu, self._registers)
                if reply[0] & 0x80 and self.refuses_silently:
                    return
            frame = self._damaged(request.wrap(reply))
            if delay := self._faults.get("delay"):
                self._late.append((self._clock.now_ns() + to_ns(delay["delay_s"]), send, frame))
            else:
                self._deliver(send, frame)

    def _damaged(self, frame: bytes) -> bytes:
        if self._faults.get("garbage"):
            frame = self._random.randbytes(len(frame))
        if truncate := self._faults.get("truncate"):
            frame = frame[: truncate["size"]]
        return frame

    def _deliver(self, send: Send, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # the client has disconnected
            send(frame)
            self._replies += 1
