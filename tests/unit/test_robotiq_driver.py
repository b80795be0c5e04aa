"""The gripper's driver against a gripper on the wire, over TCP and over a serial line."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    InputError,
    OutOfLimitsError,
)
from drivers.robotiq_3f import GraspMode, Robotiq3F, rtu_link, tcp_link
from drivers.robotiq_modbus import Link
from drivers.types import Pose
from fakes.wire.modbus_gripper import GripperRtu, GripperServer
from fakes.world import Layout, World

Wire = GripperServer | GripperRtu


class HurriedClock(SystemClock):
    """The world's time, five times as fast as ours, so that nobody waits for fingers."""

    def now_ns(self) -> int:
        return 5 * super().now_ns()


def make_world() -> World:
    return World(Layout(base_T_table=Pose((0.45, 0.0, 0.06)), home=Pose((0.45, 0.0, 0.30))), seed=3)


@pytest.fixture(params=["tcp", "tcp-2014", "rtu"])
def wire(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Wire, Link]]:
    clock, world = HurriedClock(), make_world()
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
def server() -> Iterator[GripperServer]:
    fake = GripperServer(make_world(), HurriedClock(), activation_s=0.1)
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


def written(fake: Wire) -> bytes:
    return bytes.fromhex(fake.snapshot()["written"])


def raised_by(call: Callable[[], object]) -> DeviceError:
    """The error that a repeated call raises sooner or later; how soon is for the benchmark."""
    give_up = time.monotonic() + 10.0
    while time.monotonic() < give_up:
        try:
            call()
        except DeviceError as error:
            return error
        time.sleep(0.005)
    pytest.fail("nothing was raised")


def reach(gripper: Robotiq3F, counts: int) -> None:
    """Wait until the fingers have passed a position on their way."""
    while gripper.state().position_counts <= counts:
        time.sleep(0.005)


def test_it_activates_moves_and_stops_on_every_line(wire: tuple[Wire, Link]) -> None:
    fake, link = wire
    gripper = Robotiq3F(link, speed_m_s=0.022)
    gripper.connect()
    assert written(fake) == bytes(16), "connecting must write nothing"
    assert not gripper.state().activated
    gripper.activate()
    assert gripper.state().activated
    motion = gripper.move_to(20)
    assert gripper.state().moving
    motion.wait(5.0)
    assert gripper.state().position_counts == 20
    gripper.move_to(255)
    reach(gripper, 22)
    gripper.stop()
    held = gripper.state()
    assert not held.moving
    assert 20 < held.position_counts < 255
    time.sleep(0.1)
    assert gripper.state().position_counts == held.position_counts
    gripper.disconnect()


def test_the_finger_that_does_not_grasp_stays_where_it_stands(
    gripper: Robotiq3F, server: GripperServer
) -> None:
    gripper.move_to(60).wait(5.0)
    command, status = written(server), bytes.fromhex(server.snapshot()["status"])
    assert command[1] == 4, "rICF"
    assert (command[3], command[6], command[9]) == (6, 60, 60)
    assert (status[4], status[7], status[10]) == (6, 60, 60)


@pytest.mark.parametrize(("fingers", "requests"), [(("A", "B"), (50, 50, 6)), (("A", "B", "C"), (50, 0, 0))])
def test_the_fingers_that_grasp_are_the_users_choice(
    server: GripperServer, fingers: tuple[str, ...], requests: tuple[int, int, int]
) -> None:
    gripper = Robotiq3F(tcp_link(*server.address), fingers=fingers, speed_m_s=0.11)
    gripper.connect()
    gripper.activate()
    gripper.move_to(50).wait(5.0)
    command = written(server)
    assert (command[3], command[6], command[9]) == requests
    assert gripper.state().position_counts == 50
    gripper.disconnect()


def test_a_status_without_the_echo_is_not_believed(gripper: Robotiq3F, server: GripperServer) -> None:
    """The gripper acknowledges, and goes on telling of the motion before."""
    gripper.move_to(20).wait(5.0)
    server.inject("deaf")
    motion = gripper.move_to(30)
    assert not motion.done()
    error = raised_by(motion.done)
    assert isinstance(error, DeviceTimeoutError)
    assert "did not take it up" in str(error)


def test_modes_change_only_on_request_and_motions_keep_them(
    gripper: Robotiq3F, server: GripperServer
) -> None:
    gripper.set_mode(GraspMode.WIDE)
    assert written(server)[0] == 0b0101
    gripper.move_to(20).wait(5.0)
    assert written(server)[0] == 0b1101
    gripper.set_mode(GraspMode.SCISSOR)
    motion = gripper.move_to(90)
    motion.wait(5.0)
    assert gripper.state().position_counts == 90, "in scissor mode the scissor axis grasps"
    assert bytes.fromhex(server.snapshot()["status"])[13] == 90


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.02, 0.03, 0.05, 0.3])
def test_stop_ends_an_activation_at_any_moment(after_s: float) -> None:
    slow = GripperServer(make_world(), SystemClock(), activation_s=60.0)
    slow.start()
    gripper = Robotiq3F(tcp_link(*slow.address))
    gripper.connect()
    errors: list[Exception] = []

    def activate() -> None:
        try:
            gripper.activate()
        except DeviceError as error:
            errors.append(error)

    activation = threading.Thread(target=activate)
    activation.start()
    while not gripper._sequence:
        time.sleep(0.001)
    time.sleep(after_s)
    gripper.stop()
    activation.join(5.0)
    assert "activation was ended by a stop" in str(errors[0])
    time.sleep(0.05)
    state = gripper.state()
    assert not state.activated
    assert not state.moving
    assert written(slow) == bytes(16)
    gripper.disconnect()
    slow.stop()


def test_connecting_keeps_an_activated_gripper_as_it_is(gripper: Robotiq3F, server: GripperServer) -> None:
    gripper.move_to(30).wait(5.0)
    before = written(server)
    gripper.connect()
    assert written(server) == before
    assert gripper.state().activated
    assert gripper.state().position_counts == 30


@pytest.mark.usefixtures("gripper")
def test_a_motion_that_takes_too_long_is_stopped(server: GripperServer) -> None:
    slow = Robotiq3F(tcp_link(*server.address), speed_m_s=0.022)
    slow.connect()
    motion = slow.move_to(255)
    with pytest.raises(DeviceTimeoutError, match="stopped it"):
        motion.wait(0.05)
    assert motion.done()
    assert slow.state().position_counts < 255
    slow.disconnect()


def test_positions_outside_the_limits_are_never_sent(gripper: Robotiq3F, server: GripperServer) -> None:
    before = written(server)
    for position in (-1, 5, 256, 10**6, 50.5, float("nan")):
        with pytest.raises(OutOfLimitsError, match="counts"):
            gripper.move_to(position)  # type: ignore[arg-type]
    assert written(server) == before


@pytest.mark.parametrize("fingers", [("B",), ("B", "B"), ("B", "D"), ()])
def test_fingers_that_a_gripper_does_not_have_are_refused(fingers: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="two or three of A, B and C"):
        Robotiq3F(tcp_link("127.0.0.1"), fingers=fingers)


def test_unknown_presets_are_refused() -> None:
    with pytest.raises(InputError, match="tcp-2014"):
        tcp_link("127.0.0.1", preset="udp")


def test_many_threads_may_use_one_gripper(gripper: Robotiq3F) -> None:
    errors: list[BaseException] = []

    def work(number: int) -> None:
        try:
            for step in range(20):
                gripper.state()
                if number == 0:
                    gripper.move_to(20 + step)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10.0)
    assert errors == []
    assert gripper.counters() == {"failed_requests": 0}
    assert 0.0 < max(gripper.round_trips_s()) < 0.2
