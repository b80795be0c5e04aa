"""A gripper on the wire, in a world whose time runs five times as fast as ours, and what is asked of it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link
from drivers.robotiq_3f.modbus import Link
from drivers.types import Pose
from fakes.wire.gripper.server import GripperRtu, GripperServer
from fakes.world.world import BenchLayout, World
from support.finger_counts import counts_of

Wire = GripperServer | GripperRtu


class HurriedClock(SystemClock):
    """The world's time, so that nobody waits for fingers."""

    def now_ns(self) -> int:
        return 5 * super().now_ns()


@pytest.fixture
def world() -> World:
    return World(BenchLayout(base_T_table=Pose((0.45, 0.0, 0.06)), home=Pose((0.45, 0.0, 0.30))), seed=3)


@pytest.fixture(params=["tcp", "rtu"])
def wire(request: pytest.FixtureRequest, world: World, tmp_path: Path) -> Iterator[tuple[Wire, Link]]:
    """A gripper, served as the preset says, and the link to it."""
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
    """Over TCP, connected and activated, as fast as the gripper goes."""
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
    """The error that a repeated call raises sooner or later; how soon is for the benchmark."""

    def raised(call: Callable[[], object]) -> DeviceError:
        give_up = time.monotonic() + 10.0
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
    """Wait until the fingers have passed a position on their way."""

    def wait(gripper: Robotiq3F, counts: int) -> None:
        while counts_of(gripper) <= counts:
            time.sleep(0.005)

    return wait
