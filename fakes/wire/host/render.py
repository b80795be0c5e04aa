"""The rendering process: cameras and fingertips of a mirrored world, served as MJPEG streams."""

import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2
import numpy as np

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.clock import host_s
from drivers.errors import DeviceError, InputError, RigError
from drivers.realtime import ask_for_realtime
from drivers.types import Image
from fakes.clock import SharedClock
from fakes.devices.camera import FakeCamera, unit_seed
from fakes.devices.digit import BenchPlan, FakeDigit
from fakes.faults import FaultScript
from fakes.wire.mjpeg.server import MjpegServer
from fakes.wire.net import VitalThread
from fakes.world.mirror import PATIENCE_S, MirroredWorld, Snapshot

START_S = 120.0
"""Time limit for the start of the process and for its answers: longer than a loaded host takes."""
STOP_S = 5.0
LOOK_S = 0.25
"""Interval at which the process checks that all of its threads are alive."""
CAMERA_PHASE = 0.125
"""Share of its period at which the camera captures: a quarter of a fingertip's period after the first."""
SWITCH_S = 0.0005
"""Longest time for which a busy thread keeps the interpreter while the image of another is due."""


class Renderer:
    """The rendering process, in its parent."""

    def __init__(self, plan: BenchPlan, clock: SharedClock, first: Snapshot, host: str) -> None:
        context = spawn_context()
        self._feed, feed = context.Pipe()
        self._calls, calls = context.Pipe()
        self._lock = threading.Lock()
        self._process = context.Process(
            target=_render, args=(plan, clock, first, host, feed, calls), name="fake cameras"
        )
        self._process.start()
        feed.close()
        calls.close()

    def urls(self) -> dict[str, str]:
        """Wait until the streams are up; return where each serial is served."""
        return self._answer(START_S)

    def feed(self, snapshot: Snapshot) -> None:
        """Send the state of the world to the process. Raises `DeviceError` if the process has ended."""
        try:
            self._feed.send(snapshot)
        except OSError as error:
            raise self._reason() from error

    def call(self, serial: str, method: str, **arguments: Any) -> Any:
        """Call a method of the server of a stream. Raises its errors."""
        with self._lock:
            self._calls.send((serial, method, arguments))
            return self._answer(START_S)

    def stop(self) -> None:
        self._feed.close()
        self._calls.close()
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _reason(self) -> DeviceError:
        """Return why the process has ended: its own error if it sent one."""
        with self._lock, suppress(EOFError, OSError):
            while self._calls.poll(STOP_S):
                answer = self._calls.recv()
                if isinstance(answer, DeviceError):
                    return answer
        return DeviceError("fake cameras: their process has ended; start the fakes again")

    def _answer(self, timeout_s: float) -> Any:
        try:
            if self._calls.poll(timeout_s):
                answer = self._calls.recv()
                if isinstance(answer, Exception):
                    raise answer
                return answer
        except (EOFError, OSError) as error:
            raise DeviceError("fake cameras: their process has ended; start the fakes again") from error
        raise DeviceError(f"fake cameras: no answer from their process within {timeout_s:g} s")


def _render(
    plan: BenchPlan, clock: SharedClock, first: Snapshot, host: str, feed: Connection, calls: Connection
) -> None:
    """Run the process until the parent closes the pipes or ends."""
    leave_signals_to_parent()
    ask_for_realtime()
    sys.setswitchinterval(SWITCH_S)
    cv2.setNumThreads(1)
    world = MirroredWorld(plan.layout, first, host_s(clock, PATIENCE_S))

    def keep_fed() -> None:
        with suppress(EOFError, OSError):
            while True:
                world.feed(feed.recv())

    feeder = VitalThread(keep_fed, "updates of the mirrored world")
    feeder.start()
    servers: dict[str, MjpegServer] = {}
    try:
        # Real sensors run independently. Here they share one processor, so their captures alternate.
        phases = [i / len(plan.digits) for i in range(len(plan.digits))]
        for source, phase in zip((*plan.digits, plan.camera), (*phases, CAMERA_PHASE), strict=True):
            drawn = source.make(world, clock, FaultScript())
            servers[source.serial] = _serve(drawn, clock, host, phase)
        calls.send({serial: server.url for serial, server in servers.items()})
        while _answer_calls(servers, calls):
            for failure in (part.failure for part in (feeder, *servers.values())):
                if failure is not None:
                    raise DeviceError(f"fake cameras: {type(failure).__name__}: {failure}")
    except RigError as error:
        calls.send(error)
    finally:
        for server in servers.values():
            server.stop()


def _serve(source: FakeDigit | FakeCamera, clock: SharedClock, host: str, phase: float) -> MjpegServer:
    def render(time_ns: int) -> Image:  # its noise depends on the time
        return source.draw(time_ns, np.random.default_rng((unit_seed(source.serial), time_ns)))

    kind, on_light = ("digit", source.set_light) if isinstance(source, FakeDigit) else ("camera", None)
    server = MjpegServer(source.serial, render, source.rate_hz, clock, host, kind, on_light, phase)
    server.start()
    return server


def _answer_calls(servers: dict[str, MjpegServer], calls: Connection) -> bool:
    """Execute the next call of the parent; return False if the parent has closed the pipe or ended."""
    try:
        if not calls.poll(LOOK_S):
            return True
        serial, method, arguments = calls.recv()
    except (EOFError, OSError):
        return False
    try:
        calls.send(getattr(servers[serial], method)(**arguments))
    except (RigError, TypeError) as error:
        calls.send(InputError(f"{serial}: {error}") if isinstance(error, TypeError) else error)
    return True
