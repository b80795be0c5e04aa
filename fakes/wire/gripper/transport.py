"""What the simulated gripper's two transports share: registers, 200 Hz refresh, faults, the thread."""

import contextlib
import random
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError, nearest
from fakes.wire.gripper import modbus_frames as frames
from fakes.wire.gripper.model import IMAGE_BYTES, REFRESH_NS, GripperModel
from fakes.wire.net.background import VitalThread
from fakes.world.world import World

BASES = {"rtu": (0x03E8, 0x07D0), "tcp": (0x0000, 0x0000), "tcp-2014": (0x03E8, 0x07D0)}
"""First command and first status register by edition of the manual."""
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
"""Kinds of fault and the arguments they take, with their defaults; `duration_s` fits all."""
HIGHEST = {"delay_s": 3600, "duration_s": 3600, "size": 256, "seed": 2**31, "code": 255}
Send = Callable[[bytes], None]


class RegisterMap:
    """The model's two images at their addresses."""

    def __init__(self, model: GripperModel, preset: str) -> None:
        if preset not in BASES:
            raise InputError(f"simulated gripper: no preset '{preset}': use one of {', '.join(BASES)}")
        self._model = model
        self._command, self._status = BASES[preset]

    def read(self, function: int, address: int, count: int) -> list[int]:
        """Return status registers, or what was written where the two do not share addresses."""
        overlapping = self._command == self._status
        if not overlapping and self._command <= address < self._command + IMAGE_BYTES // 2:
            image, start = bytes(self._model.written), address - self._command
        else:
            image, start = self._model.image, address - self._status
        _require_inside(start, count)
        part = image[2 * start : 2 * (start + count)]
        return [part[at] << 8 | part[at + 1] for at in range(0, len(part), 2)]

    def write(self, address: int, values: list[int]) -> None:
        """Set command registers; the gripper takes them up at its next refresh."""
        start = address - self._command
        _require_inside(start, len(values))
        part = b"".join(value.to_bytes(2, "big") for value in values)
        self._model.written[2 * start : 2 * start + len(part)] = part


class WireGripper(ABC):
    """What both transports share: the model, its 200 Hz, the faults, the thread."""

    def __init__(
        self, world: World, clock: Clock, preset: str, fingers: tuple[str, ...], activation_s: float
    ) -> None:
        self._clock = clock
        self._model = GripperModel(world, clock.now_ns(), fingers, activation_s)
        self._registers = RegisterMap(self._model, preset)
        self._faults: dict[str, tuple[dict[str, Any], int | None]] = {}
        self._late: list[tuple[int, Send, bytes]] = []
        self._requests = self._replies = 0
        self._random = random.Random(0)  # noqa: S311 - noise on a line, not a secret
        self._stopping = threading.Event()
        self._thread: VitalThread | None = None
        self._lock = threading.RLock()
        self._next_tick_ns = 0

    def start(self) -> None:
        """Open the line and serve it from a thread. Raises `InputError` when it is taken."""
        self._stopping.clear()
        self._open()
        self._thread = VitalThread(self._serve, "simulated gripper")
        self._thread.start()

    @property
    def failure(self) -> Exception | None:
        """What ended the gripper by itself; None where nothing did."""
        return self._thread.failure if self._thread else None

    def stop(self) -> None:
        """Stop serving. Safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def inject(self, kind: str, **arguments: Any) -> None:
        """Begin a fault, for `duration_s` or until "clear". Raises `InputError` for an unknown one."""
        if kind == "clear":
            self._clear()
            return
        settings, duration_s = _checked(kind, arguments)
        with self._lock:
            now = self._clock.now_ns()
            ends = None if duration_s is None else now + round(duration_s * NS_PER_S)
            self._faults[kind] = (settings, ends)
            self._begin(kind, settings, now)
            self._apply()

    def _clear(self) -> None:
        with self._lock:
            self._faults = {}
            self._model.clear_fault()
            self._apply()

    def _begin(self, kind: str, settings: dict[str, Any], now_ns: int) -> None:
        if kind == "fault":
            self._model.fail(int(settings["code"]), now_ns)
        elif kind == "power_lost":
            self._model.lose_power(now_ns)
        elif kind == "garbage":
            self._random.seed(settings["seed"])

    def _apply(self) -> None:
        self._model.faults = frozenset(self._faults)

    def snapshot(self) -> dict[str, Any]:
        """What happened so far: requests and replies, both register images in hex, faults that are on."""
        with self._lock:
            return {
                "requests": self._requests,
                "replies": self._replies,
                "written": self._model.written.hex(),
                "status": self._model.image.hex(),
                "faults": sorted(self._faults),
            }

    @property
    def _refuses_silently(self) -> bool:
        return False

    @property
    @abstractmethod
    def _is_open(self) -> bool:
        """Whether the line is open."""

    @abstractmethod
    def _open(self) -> None:
        """Open the line. Raises `InputError` when it is taken."""

    @abstractmethod
    def _close(self) -> None:
        """Close the line."""

    @abstractmethod
    def _work(self, timeout_s: float) -> None:
        """Wait that long for bytes, and hand each complete request to `_handle`."""

    def _serve(self) -> None:
        while not self._stopping.is_set():
            if self._clock.now_ns() >= self._next_tick_ns:
                with self._lock:
                    self._tick(self._clock.now_ns())
            wait_s = max(self._next_tick_ns - self._clock.now_ns(), 0) / NS_PER_S
            if self._is_open:
                self._work(wait_s)
            else:
                self._stopping.wait(wait_s)
        self._close()

    def _tick(self, now_ns: int) -> None:
        self._next_tick_ns = now_ns // REFRESH_NS * REFRESH_NS + REFRESH_NS
        self._end_faults(now_ns)
        self._model.tick(now_ns)
        cut = "disconnect" in self._faults
        if cut and self._is_open:
            self._close()
        elif not cut and not self._is_open:
            with contextlib.suppress(InputError):  # taken meanwhile: tried again at the next refresh
                self._open()
        for _, send, frame in [item for item in self._late if item[0] <= now_ns]:
            self._deliver(send, frame)
        self._late = [item for item in self._late if item[0] > now_ns]

    def _end_faults(self, now_ns: int) -> None:
        for kind, (_, ends) in list(self._faults.items()):
            if ends is not None and now_ns >= ends:
                del self._faults[kind]
                self._apply()

    def _handle(self, request: frames.Request, send: Send) -> None:
        with self._lock:
            self._requests += 1
            if "silent" in self._faults or "power_lost" in self._faults:
                return
            if "exception" in self._faults:
                reply = frames.exception_reply(request.pdu, int(self._faults["exception"][0]["code"]))
            else:
                reply = frames.answer(request.pdu, self._registers)
                if reply[0] & 0x80 and self._refuses_silently:
                    return
            frame = self._spoilt(request.wrap(reply))
            if "delay" not in self._faults:
                self._deliver(send, frame)
                return
            delay_s = self._faults["delay"][0]["delay_s"]
            self._late.append((self._clock.now_ns() + round(delay_s * NS_PER_S), send, frame))

    def _spoilt(self, frame: bytes) -> bytes:
        if "garbage" in self._faults:
            frame = self._random.randbytes(len(frame))
        if "truncate" in self._faults:
            frame = frame[: int(self._faults["truncate"][0]["size"])]
        return frame

    def _deliver(self, send: Send, frame: bytes) -> None:
        with contextlib.suppress(OSError):  # the client has gone
            send(frame)
            self._replies += 1


def _checked(kind: str, arguments: dict[str, Any]) -> tuple[dict[str, Any], float | None]:
    """Settings and duration of a fault. Raises `InputError` naming what there is."""
    known = ", ".join(f"{name}({', '.join(takes)})" for name, takes in FAULTS.items())
    if kind not in FAULTS or not set(arguments) <= {*FAULTS[kind], "duration_s"}:
        near = nearest(kind, set(FAULTS) - {kind})
        given = f" with {', '.join(sorted(arguments))}" if arguments else ""
        raise InputError(f"simulated gripper: no fault '{kind}'{near}{given}; use {known}, clear")
    for name, value in arguments.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= HIGHEST[name]:
            raise InputError(
                f"simulated gripper: {kind}: {name} {value!r} is not a number to {HIGHEST[name]}"
            )
    duration_s = arguments.get("duration_s")
    return FAULTS[kind] | {n: v for n, v in arguments.items() if n != "duration_s"}, duration_s


def _require_inside(start: int, count: int) -> None:
    if start < 0 or start + count > IMAGE_BYTES // 2:
        raise LookupError(f"registers {start} to {start + count - 1} of 0 to {IMAGE_BYTES // 2 - 1}")
