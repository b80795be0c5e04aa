"""A simulated gripper server whose world runs at five times real time, and helpers to inspect it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link
from drivers.robotiq_3f.modbus import Link
from fakes.wire.gripper.server import GripperRtu, GripperServer
from fakes.world.world import World
from support.finger_counts import counts_of
from support.worlds import empty_world

Wire = GripperServer | GripperRtu


class HurriedClock(SystemClock):
    """World clock at five times real time, so that tests do not wait for fingers."""

    def now_ns(self) -> int:
        return 5 * super().now_ns()


@pytest.fixture
def world() -> World:
    return empty_world()


@pytest.fixture(params=["tcp", "rtu"])
def wire(request: pytest.FixtureRequest, world: World, tmp_path: Path) -> Iterator[tuple[Wire, Link]]:
    """A gripper server for a preset, and the link to it."""
    clock = HurriedClock()
    if request.param == "rtu":
        fake: Wire = GripperRtu(world, clock, tmp_path / "gripper", activation_s=0.1)
        fake.start()
        link = rtu_link(fake.device)
    else:
        fake = GripperServer(world, clock, preset=request.param, activation_s=0.1)
        fake.start()
        link = tcp_link(*fake.address, preset=request.param)
    yield fake, link
    fake.stop()


@pytest.fixture
def server(world: World) -> Iterator[GripperServer]:
    fake = GripperServer(world, HurriedClock(), activation_s=0.1)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def gripper(server: GripperServer) -> Iterator[Robotiq3F]:
    """A connected and activated gripper over TCP, at full speed."""
    gripper = Robotiq3F(tcp_link(*server.address), speed_m_s=0.11)
    gripper.connect()
    gripper.activate()
    yield gripper
    gripper.disconnect()


@pytest.fixture
def written() -> Callable[[Wire], bytes]:
    """The command registers of a gripper."""
    return lambda fake: bytes.fromhex(fake.snapshot()["written"])


@pytest.fixture
def raised_by() -> Callable[[Callable[[], object]], DeviceError]:
    """Repeat a call until it raises, and return the error. The benchmark measures the delay."""

    def raised(call: Callable[[], object]) -> DeviceError:
        give_up = time.monotonic() + 120.0
        while time.monotonic() < give_up:
            try:
                call()
            except DeviceError as error:
                return error
            time.sleep(0.005)
        pytest.fail("nothing was raised")

    return raised


@pytest.fixture
def reach() -> Callable[[Robotiq3F, int], None]:
    """Wait until the fingers have passed a position."""

    def wait(gripper: Robotiq3F, counts: int) -> None:
        while counts_of(gripper) <= counts:
            time.sleep(0.005)

    return wait
