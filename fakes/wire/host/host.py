"""All fakes of a bench: world, controller and gripper in this process, cameras in a second one."""

import math
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from drivers.clock import host_s
from drivers.errors import DeviceError, InputError, unknown_name
from fakes.clock import SharedClock
from fakes.devices.digit import BenchPlan
from fakes.objects.catalogue import short_id
from fakes.wire.gripper.server import GripperRtu, GripperServer, WireGripper
from fakes.wire.host.render import Renderer
from fakes.wire.net import ControlServer, VitalThread
from fakes.wire.ur.controller import POLYSCOPE, URController
from fakes.world.fixture import parse_fixture
from fakes.world.mirror import Track, snapshot_of
from fakes.world.world import World

TICK_S = 0.004
SWITCH_S = 0.0005
"""Longest time for which a busy thread keeps the interpreter while the controller's next cycle is due."""
LOOK_S = 0.5
"""Interval at which `wait` checks that all parts are alive."""
JOIN_S = 2.0
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
        self._clock = SharedClock.started(slowness)
        self._world = World(plan.layout, seed)
        self._track = Track()
        self._devices: dict[str, URController | WireGripper | _Stream] = {}
        self._served: dict[str, Any] = {}
        """Address of each device: the arm, the gripper, and streams by their serials."""
        self._running = ExitStack()
        self._stopping = threading.Event()
        self._vital: list[URController | WireGripper | ControlServer | VitalThread] = []

    def start(self) -> Addresses:
        """Start everything and return the addresses. Raises `InputError` if a port is in use."""
        sys.setswitchinterval(SWITCH_S)
        try:
            return self._start()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        self._stopping.set()
        self._running.close()

    def wait(self) -> None:
        """Block until `stop`. Raises as `check` does."""
        while not self._stopping.wait(LOOK_S):
            self.check()

    def check(self) -> None:
        """Raise a `DeviceError` with the reason if a part of the fakes has ended."""
        for failure in (part.failure for part in self._vital):
            if isinstance(failure, DeviceError):
                raise failure
            if failure is not None:
                raise DeviceError(f"fakes: a part has ended: {type(failure).__name__}: {failure}")

    def _start(self) -> Addresses:
        wire, world, clock = self._wire, self._world, self._clock
        arm = self._arm = URController(world, clock, self._host, wire.polyscope)
        renderer = Renderer(self._plan, clock, snapshot_of(world, clock.now_ns()), self._host)
        self._running.callback(renderer.stop)
        if wire.rtu is not None:
            gripper = GripperRtu(world, clock, wire.rtu, wire.fingers)
        else:
            gripper = GripperServer(world, clock, self._host, preset=wire.preset, fingers=wire.fingers)
        for device in (arm, gripper):
            device.start()
            self._running.callback(device.stop)
        streams = renderer.urls()
        self._devices = {"arm": arm, "gripper": gripper}
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
        control.start()
        self._running.callback(control.stop)
        self._vital = [arm, gripper, control, self._ticker(renderer)]
        return Addresses(self._host, where, streams, control.address)

    def _ticker(self, renderer: Renderer) -> VitalThread:
        """Advance the world and send it to the cameras, whether or not a device asks."""
        tick_s = host_s(self._clock, TICK_S)

        def run() -> None:
            while not self._stopping.wait(tick_s):
                snapshot = snapshot_of(self._world, self._clock.now_ns())
                state, counts = snapshot.state, self._world.fingers.position_at(snapshot.state.time_ns)
                self._track.see(state.time_ns, snapshot.tool.position_m, counts, state.held)
                renderer.feed(snapshot)

        ticker = VitalThread(run, "world of the fakes")
        ticker.start()
        # with a limit: it may be blocked by cameras that read nothing more, whose process ends after it
        self._running.callback(ticker.join, JOIN_S)
        self._running.callback(self._stopping.set)
        return ticker

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
