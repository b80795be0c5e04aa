"""The gripper's driver with a simulated gripper, over TCP and over a serial line."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from pymodbus.client import ModbusTcpClient

from drivers.clock import SystemClock
from drivers.errors import DeviceTimeoutError, GripperFaultError, InputError
from drivers.motion import Motion
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from drivers.robotiq_3f.modbus import Link
from drivers.robotiq_3f.registers import MODE_CHANGE_PENDING, Command, GraspMode, pack_command, unpack_status
from fakes.wire.gripper.server import GripperServer
from fakes.world.world import World
from support.connected import connected
from support.finger_counts import counts_of, opening_m
from support.gripper_on_wire import Wire, raised_by, reach, written
from support.marks import heavy
from support.waiting import until


@pytest.mark.parametrize("wire", ["tcp", "tcp-2014", "rtu"], indirect=True)
def test_gripper_activates_moves_and_stops_over_every_transport(wire: tuple[Wire, Link]) -> None:
    fake, link = wire
    with connected(Robotiq3F(link, speed_m_s=0.022)) as gripper:
        assert written(fake) == bytes(16), "connecting must write nothing"
        assert not gripper.state().activated
        gripper.activate()
        assert gripper.state().activated
        motion = gripper.move_to(opening_m(gripper, 20))
        assert gripper.state().moving
        motion.wait(5.0)
        assert counts_of(gripper) == 20
        gripper.move_to(opening_m(gripper, 255))
        reach(gripper, 22)
        gripper.stop()
        held = gripper.state()
        assert not held.moving
        assert 20 < held.raw["position_counts"] < 255
        time.sleep(0.1)
        assert counts_of(gripper) == held.raw["position_counts"]


@pytest.mark.parametrize(("fingers", "requests"), [(("A", "B"), (50, 50, 6)), (("A", "B", "C"), (50, 0, 0))])
def test_only_the_chosen_fingers_move(
    server: GripperServer, fingers: tuple[str, ...], requests: tuple[int, int, int]
) -> None:
    with connected(Robotiq3F(tcp_link(*server.address), fingers=fingers, speed_m_s=0.11)) as gripper:
        gripper.activate()
        gripper.move_to(opening_m(gripper, 50)).wait(5.0)
        command = written(server)
        assert (command[3], command[6], command[9]) == requests
        assert counts_of(gripper) == 50


def test_status_without_the_echo_of_the_command_is_ignored(gripper: Robotiq3F, server: GripperServer) -> None:
    """The gripper acknowledges the command, but still reports the previous motion."""
    gripper.move_to(opening_m(gripper, 20)).wait(5.0)
    server.inject("deaf")
    motion = gripper.move_to(opening_m(gripper, 30))
    assert not motion.is_done()
    with pytest.raises(DeviceTimeoutError, match="did not start it"):
        raise raised_by(motion.is_done)


def set_mode(server: GripperServer, mode: GraspMode) -> None:
    """Set a grasping mode as another master on the bus does, and wait until the scissor axis has turned."""
    host, port = server.address
    with ModbusTcpClient(host, port=port) as client:
        client.write_registers(0, list(pack_command(Command(activate=True, mode=mode))), device_id=2)
        while True:
            status = unpack_status(client.read_input_registers(0, count=8, device_id=2).registers)
            if status.ready and status.mode is mode:
                return
            time.sleep(0.005)


def moved_after_the_change(gripper: Robotiq3F, counts: int) -> Motion:
    """Repeat a motion command until the driver has detected the end of the mode change; until then it is
    refused."""
    while True:
        try:
            return gripper.move_to(opening_m(gripper, counts))
        except GripperFaultError as error:
            if error.code != MODE_CHANGE_PENDING:
                raise
            time.sleep(0.005)


def test_modes_change_only_on_request_and_motions_keep_them(
    gripper: Robotiq3F, server: GripperServer
) -> None:
    set_mode(server, GraspMode.WIDE)
    assert written(server)[0] == 0b0101
    assert gripper.state().mode == "wide"
    moved_after_the_change(gripper, 20).wait(5.0)
    assert written(server)[0] == 0b1101
    set_mode(server, GraspMode.SCISSOR)
    moved_after_the_change(gripper, 90).wait(5.0)
    assert counts_of(gripper) == 90, "in scissor mode the scissor axis grasps"
    assert bytes.fromhex(server.snapshot()["status"])[13] == 90
    gripper.activate()
    assert gripper.state().mode == "basic"


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.3, *heavy(0.01, 0.03, 0.05)])
def test_stop_ends_an_activation_at_any_moment(world: World, after_s: float) -> None:
    slow = GripperServer(world, SystemClock(), activation_s=60.0)
    slow.start()
    with connected(Robotiq3F(tcp_link(*slow.address))) as gripper, ThreadPoolExecutor(1) as pool:
        activation = pool.submit(gripper.activate)
        until(lambda: bool(gripper._sequence))
        time.sleep(after_s)
        gripper.stop()
        assert "activation was ended by a stop" in str(activation.exception(5.0))
        time.sleep(0.05)
        state = gripper.state()
        assert not state.activated
        assert not state.moving
        assert written(slow) == bytes(16)
    slow.stop()


def test_unknown_fingers_and_presets_are_rejected() -> None:
    for fingers in (("B",), ("B", "B"), ("B", "D"), ()):
        with pytest.raises(InputError, match="two or three of A, B and C"):
            Robotiq3F(tcp_link("127.0.0.1"), fingers=fingers)
    with pytest.raises(InputError, match="tcp-2014"):
        tcp_link("127.0.0.1", preset="udp")


def test_gripper_is_thread_safe(gripper: Robotiq3F) -> None:
    def work(number: int) -> None:
        for step in range(20):
            gripper.state()
            if number == 0:
                gripper.move_to(opening_m(gripper, 20 + step))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    assert gripper.counters() == {"failed_requests": 0}
    assert 0.0 < max(gripper.round_trips_s()) < 0.2
