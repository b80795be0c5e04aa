"""Fingers that open without a command are closed again by the driver's own loop, and only those."""

import time
from collections.abc import Callable
from dataclasses import replace

import pytest
from pymodbus.client import ModbusTcpClient

from drivers.robotiq_3f.gripper import KeptGrip, Robotiq3F
from drivers.robotiq_3f.registers import (
    AXES,
    AxisRequest,
    AxisState,
    Command,
    GraspMode,
    MotionStatus,
    ObjectStatus,
    Stage,
    Status,
    pack_command,
)
from fakes.wire.gripper.server import GripperServer
from support.finger_counts import counts_of, opening_m
from support.gripper_on_wire import written
from support.waiting import until

GRIP = 100
SLACK = 2
"""Opening in counts that is still the grip."""
DRIFT = 13
"""Counts by which the fault opens the fingers."""


def grip(gripper: Robotiq3F) -> None:
    """Close, and keep the grip."""
    gripper.move_to(opening_m(gripper, GRIP)).wait(5.0)
    gripper.keep_grip(opening_m(gripper, GRIP - SLACK) + 1e-9)


def test_fingers_that_open_without_a_command_are_closed_again(
    gripper: Robotiq3F, server: GripperServer
) -> None:
    grip(gripper)
    agreed = written(server)
    assert gripper.state().reclosed_from_m is None
    server.inject("drift")
    until(lambda: gripper.state().reclosed_from_m is not None)
    until(lambda: counts_of(gripper) == GRIP)
    state = gripper.state()
    assert state.reclosed_from_m is not None
    assert opening_m(gripper, GRIP - SLACK) < state.reclosed_from_m < opening_m(gripper, GRIP - DRIFT)
    assert written(server) == agreed, "the agreed position, speed and force"
    gripper.move_to(opening_m(gripper, 20)).wait(5.0)
    assert counts_of(gripper) == 20
    assert gripper.state().reclosed_from_m == state.reclosed_from_m, "reported until the gripper is connected"
    gripper.connect()
    assert gripper.state().reclosed_from_m is None


@pytest.mark.parametrize("command", [Robotiq3F.stop, lambda g: g.move_to(opening_m(g, 60)).wait(5.0)])
def test_next_command_ends_the_grip(
    gripper: Robotiq3F, server: GripperServer, command: Callable[[Robotiq3F], None]
) -> None:
    grip(gripper)
    command(gripper)
    before, sent = counts_of(gripper), written(server)
    server.inject("drift")
    until(lambda: counts_of(gripper) == before - DRIFT)
    assert (gripper.state().reclosed_from_m, written(server)) == (None, sent)


def test_command_of_another_program_is_not_answered(gripper: Robotiq3F, server: GripperServer) -> None:
    grip(gripper)
    host, port = server.address
    request = (AxisRequest(GRIP - 30, 255),) * len(AXES)
    other = pack_command(Command(activate=True, go_to=True, axes=request))
    with ModbusTcpClient(host, port=port) as client:
        client.write_registers(0, list(other), device_id=2)
    until(lambda: counts_of(gripper) == GRIP - 30)
    time.sleep(0.05)
    assert gripper.state().reclosed_from_m is None
    assert written(server)[:4] == b"".join(word.to_bytes(2, "big") for word in other)[:4]


COMMAND = Command(activate=True, go_to=True, axes=(AxisRequest(GRIP, 128, 0),) * len(AXES))
REQUEST, RELEASE = pack_command(COMMAND), pack_command(replace(COMMAND, go_to=False))


def status(position: int, go_to: bool = True, requested: int = GRIP) -> Status:
    """Return the status of an activated gripper with all fingers at a position, counts."""
    axes = (AxisState(requested, position, 0, ObjectStatus.AT_REQUEST),) * len(AXES)
    return Status(True, GraspMode.BASIC, go_to, Stage.READY, MotionStatus.AT_REQUEST, 0, axes)


@pytest.fixture
def kept() -> KeptGrip:
    """A grip at 100 counts that may open by 2."""
    return KeptGrip(COMMAND, lambda seen: -float(seen.axes[0].position), -(GRIP - SLACK), lambda _: None)


def test_reaction_releases_once_and_requests_once_per_opening(kept: KeptGrip) -> None:
    """Statuses may show the request before the last one: the gripper refreshes them every 5 ms."""
    steps = [
        (status(GRIP - SLACK), None),
        (status(97), RELEASE),
        (status(97), None),
        (status(96, go_to=False), REQUEST),
        (status(96, go_to=False), None),
        (status(96), None),
        (status(GRIP), None),
        (status(97), RELEASE),
        (status(97, go_to=False), REQUEST),
        (status(97), None),
        (status(96), RELEASE),
    ]
    assert [kept.react(seen) for seen, _ in steps] == [answer for _, answer in steps]


@pytest.mark.parametrize(
    "other",
    [
        replace(status(90), fault=0x0B),
        replace(status(90), stage=Stage.CHANGING_MODE),
        replace(status(90), activated=False, stage=Stage.RESET),
        status(90, go_to=False),
        status(90, requested=50),
    ],
    ids=["fault", "mode change", "power lost", "stopped by another program", "sent by another program"],
)
def test_any_other_status_ends_the_reaction_for_good(kept: KeptGrip, other: Status) -> None:
    assert kept.react(other) is None
    assert kept.react(status(90)) is None


def test_command_of_another_program_while_reclosing_ends_the_reaction(kept: KeptGrip) -> None:
    assert kept.react(status(97)) == RELEASE
    assert kept.react(status(97, requested=50)) is None
    assert kept.react(status(97, go_to=False)) is None
