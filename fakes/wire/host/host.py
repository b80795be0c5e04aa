"""All fakes of a bench: world, controller and gripper in this process, cameras in a second one."""

import math
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import cv2
import numpy as np

from drivers.children import leave_signals_to_parent, spawn_context
from drivers.clock import host_s
from drivers.errors import DeviceError, InputError, RigError, unknown_name
from drivers.realtime import ask_for_realtime
from drivers.types import Image
from fakes.clock import SharedClock
from fakes.devices.camera import FakeCamera, unit_seed
from fakes.devices.digit import BenchPlan, FakeDigit
from fakes.faults import FaultScript
from fakes.objects.catalogue import short_id
from fakes.wire.gripper.server import GripperRtu, GripperServer, WireGripper
from fakes.wire.mjpeg.server import MjpegServer
from fakes.wire.net import ControlServer, Part
from fakes.wire.ur.controller import POLYSCOPE, URController
from fakes.world.fixture import parse_fixture
from fakes.world.mirror import PATIENCE_S, MirroredWorld, Snapshot, Track, snapshot_of
from fakes.world.world import World

START_S = 120.0
"""Time limit for the start of the rendering process and for its answers: longer than a loaded host takes."""
STOP_S = 5.0
ENDED = "fake cameras: their process has ended; start the fakes again"
ALIVE_S = 0.25
"""Interval at which the rendering process checks that all of its threads are alive."""
CAMERA_PHASE = 0.125
"""Share of its period at which the camera captures: a quarter of a fingertip's period after the first."""
SWITCH_S = 0.0005
"""Longest time for which a busy thread keeps the interpreter while the next control cycle or image is due."""


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

    def feed(self, snapshot: Snapshot) -> None:
        """Send the state of the world to the process. Raises `DeviceError` if the process has ended."""
        try:
            self._feed.send(snapshot)
        except OSError as error:
            with self._lock, suppress(EOFError, OSError):
                while self._calls.poll(STOP_S):
                    if isinstance(answer := self._calls.recv(), DeviceError):  # why the process has ended
                        raise answer from error
            raise DeviceError(ENDED) from error

    def call(self, serial: str, method: str, **arguments: Any) -> Any:
        """Call a method of the server of a stream. Raises its errors."""
        with self._lock:
            self._calls.send((serial, method, arguments))
            return self.answer()

    def stop(self) -> None:
        self._feed.close()
        self._calls.close()
        self._process.join(STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def answer(self) -> Any:
        """Return the answer to a call; the first one is where each serial is served. Raises its errors."""
        try:
            if not self._calls.poll(START_S):
                raise DeviceError(f"fake cameras: no answer from their process within {START_S:g} s")
            answer = self._calls.recv()
        except (EOFError, OSError) as error:
            raise DeviceError(ENDED) from error
        if isinstance(answer, Exception):
            raise answer
        return answer


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

    feeder = Part("updates of the mirrored world", keep_fed)
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
            _require_alive("fake cameras", feeder, *servers.values())
    except RigError as error:
        calls.send(error)
    finally:
        for server in servers.values():
            server.stop()


def _require_alive(whose: str, *parts: Part) -> None:
    """Raise a `DeviceError` with the reason if one of the parts has ended."""
    for failure in (part.failure for part in parts):
        if isinstance(failure, DeviceError):
            raise failure
        if failure is not None:
            raise DeviceError(f"{whose}: {type(failure).__name__}: {failure}")


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
        if not calls.poll(ALIVE_S):
            return True
        serial, method, arguments = calls.recv()
    except (EOFError, OSError):
        return False
    try:
        calls.send(getattr(servers[serial], method)(**arguments))
    except (RigError, TypeError) as error:
        calls.send(InputError(f"{serial}: {error}") if isinstance(error, TypeError) else error)
    return True


TICK_S = 0.004
LOOK_S = 0.5
"""Interval at which `wait` checks that all parts are alive."""
MOST_SEED = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Addresses:
    """The addresses of the fakes. gripper: (host, port), or the path of a serial device."""

    arm: str
    gripper: tuple[str, int] | str
    streams: dict[str, str]
    control: str


@dataclass(frozen=True, slots=True)
class WirePlan:
    """The arm and the gripper on the wire.

    polyscope: the version that the controller announces. fingers: those of the gripper that carry fingertips.
    preset: its register map over TCP. rtu: path of a pseudo-terminal on which it is served instead, None for
    TCP.
    """

    polyscope: str = POLYSCOPE
    fingers: tuple[str, str] = ("B", "C")
    preset: str = "tcp"
    rtu: str | None = None


class FakesHost:
    """Starts and stops the fakes of a bench.

    host: the loopback address of all of them; the ports of a controller are fixed, so a second bench needs
    another address (127.0.0.2). slowness: of the devices' clock (`drivers.clock.SystemClock`).
    """

    def __init__(
        self, plan: BenchPlan, wire: WirePlan, host: str = "127.0.0.1", seed: int = 0, slowness: int = 1
    ) -> None:
        self._plan, self._wire, self._host = plan, wire, host
        self._clock = SharedClock.start(slowness)
        self._world = World(plan.layout, seed)
        self._track = Track()
        self._devices: dict[str, URController | WireGripper | _Stream] = {}
        self._served: dict[str, Any] = {}
        """Address of each device: the arm, the gripper, and streams by their serials."""
        self._running = ExitStack()
        self._stopping = threading.Event()
        self._vital: list[Part] = []

    def start(self) -> Addresses:
        """Start everything and return the addresses. Raises `InputError` if a port is in use."""
        sys.setswitchinterval(SWITCH_S)
        with ExitStack() as running:
            addresses = self._start(running)
            self._running = running.pop_all()
        return addresses

    def stop(self) -> None:
        self._stopping.set()
        self._running.close()

    def wait(self) -> None:
        """Block until `stop`. Raises as `check` does."""
        while not self._stopping.wait(LOOK_S):
            self.check()

    def check(self) -> None:
        """Raise a `DeviceError` with the reason if a part of the fakes has ended."""
        _require_alive("fakes: a part has ended", *self._vital)

    def _start(self, running: ExitStack) -> Addresses:
        wire, world, clock = self._wire, self._world, self._clock
        arm = self._arm = URController(world, clock, self._host, wire.polyscope)
        renderer = Renderer(self._plan, clock, snapshot_of(world, clock.now_ns()), self._host)
        running.callback(renderer.stop)
        if wire.rtu is not None:
            gripper = GripperRtu(world, clock, wire.rtu, fingers=wire.fingers)
        else:
            gripper = GripperServer(world, clock, self._host, preset=wire.preset, fingers=wire.fingers)
        for device in (arm, gripper):
            device.start()
            running.callback(device.stop)
        streams = renderer.answer()
        self._devices |= {"arm": arm, "gripper": gripper}
        self._devices |= {serial: _Stream(renderer, serial) for serial in streams}
        commands = {
            "place": self._place, "fault": self._fault, "world": self._state, "track": self._since,
            "guide": self._guide, "gap": lambda: {"gap_m": world.gap_at(clock.now_ns())},
            "status": lambda: {
                **self._state(), "devices": {name: d.snapshot() for name, d in self._devices.items()},
            },
            "identity": lambda: self._served,
        }  # fmt: skip
        control = ControlServer(commands, self._host)
        where = gripper.device if isinstance(gripper, GripperRtu) else gripper.address
        self._served = {"arm": self._host, "gripper": where, **streams}
        # the ticker may be blocked by cameras that read nothing more; their process ends after it
        ticker = Part("world of the fakes", lambda: self._tick(renderer))
        for part in (control, ticker):
            part.start()
            running.callback(part.stop)
        self._vital = [arm, gripper, control, ticker]
        return Addresses(self._host, where, streams, control.address)

    def _tick(self, renderer: Renderer) -> None:
        """Advance the world and send it to the cameras, whether or not a device asks."""
        while not self._stopping.wait(host_s(self._clock, TICK_S)):
            snapshot = snapshot_of(self._world, self._clock.now_ns())
            state, counts = snapshot.state, self._world.fingers.position_at(snapshot.state.time_ns)
            self._track.see(state.time_ns, snapshot.tool.position_m, counts, state.held)
            renderer.feed(snapshot)

    def _place(self, object: str, seed: int | None = None) -> None:
        """Lay an object down or mount a target, as an operator does, if it can be drawn."""
        if not isinstance(object, str):
            raise InputError(f"an object has an id or a name, not {object!r}")
        if seed is not None and (type(seed) is not int or not 0 <= seed <= MOST_SEED):
            raise InputError(f"seed: {seed!r}: give a whole number from 0 to {MOST_SEED}")
        fixture = parse_fixture(object)
        if fixture is not None:
            self._plan.camera.printed(fixture.spec)
        self._world.lay(object, seed)

    def _guide(self, to: Sequence[float], over_s: float) -> None:
        """Let a person's hand guide the tool to a pose: x y z in m, rotation vector in rad, base axes."""
        try:
            x, y, z, a, b, c = map(float, to)
            self._arm.guide((x, y, z, a, b, c), float(over_s))
        except (TypeError, ValueError) as error:
            raise InputError(f"a pose is six numbers, and a time one, not {to!r} and {over_s!r}") from error

    def _fault(self, device: str, kind: str, **arguments: Any) -> None:
        if not isinstance(device, str) or not isinstance(kind, str):
            raise InputError(f"device and kind are names, not {device!r} and {kind!r}")
        groups = {
            "tactile": [digit.serial for digit in self._plan.digits],
            "camera": [self._plan.camera.serial],
            "all": list(self._devices),
        }
        names = groups.get(device, [device])
        if not set(names) <= set(self._devices):
            raise unknown_name("device", device, [*self._devices, *groups])
        for name in names:
            self._devices[name].inject(kind, **arguments)

    def _since(self, since_ns: int) -> dict[str, Any]:
        """Return the true motion of tool and fingers since a time of the bench's system clock."""
        start_ns = self._clock.start_ns
        samples = self._track.since(since_ns - start_ns)
        return {"samples": [(time_ns + start_ns, *rest) for time_ns, *rest in samples]}

    def _state(self) -> dict[str, Any]:
        now = self._clock.now_ns()
        state, model = self._world.state_at(now), self._world.model
        return {
            "start_ns": self._clock.start_ns,
            "now_ns": now,
            "tool_m": self._world.tool.position_at(now),
            "tool_moving": self._track.moving,
            "finger_counts": self._world.fingers.position_at(now),
            "object": short_id(model.id) if model else None,
            "held": state.held,
            "force_n": state.force_n,
            "turn_deg": math.degrees(state.object_turn_rad),
        }


@dataclass(frozen=True, slots=True)
class _Stream:
    """The server of a stream, in the rendering process."""

    renderer: Renderer
    serial: str

    def inject(self, kind: str, **arguments: Any) -> None:
        self.renderer.call(self.serial, "inject", kind=kind, **arguments)

    def snapshot(self) -> dict[str, Any]:
        return self.renderer.call(self.serial, "snapshot")
