"""A simulated gripper server whose world runs at five times real time."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link
from drivers.robotiq_3f.modbus import Link
from fakes.wire.gripper.server import GripperRtu, GripperServer
from fakes.world.world import World
from support.connected import connected
from support.gripper_on_wire import HurriedClock, Wire
from support.worlds import empty_world


@pytest.fixture
def world() -> World:
    return empty_world()


@pytest.fixture(params=["tcp", "rtu"])
def wire(request: pytest.FixtureRequest, world: World, tmp_path: Path) -> Iterator[tuple[Wire, Link]]:
    """A gripper server for a preset, and the link to it."""
    clock, preset = HurriedClock(5), request.param
    if preset == "rtu":
        fake: Wire = GripperRtu(world, clock, tmp_path / "gripper", activation_s=0.1)
    else:
        fake = GripperServer(world, clock, preset=preset, activation_s=0.1)
    fake.start()
    yield fake, rtu_link(fake.device) if preset == "rtu" else tcp_link(*fake.address, preset=preset)
    fake.stop()


@pytest.fixture
def server(world: World) -> Iterator[GripperServer]:
    fake = GripperServer(world, HurriedClock(5), activation_s=0.1)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def gripper(server: GripperServer) -> Iterator[Robotiq3F]:
    """A connected and activated gripper over TCP, at full speed."""
    with connected(Robotiq3F(tcp_link(*server.address), speed_m_s=0.11)) as gripper:
        gripper.activate()
        yield gripper
