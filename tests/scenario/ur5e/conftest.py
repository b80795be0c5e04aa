"""A running controller, and the UR5e's driver connected to it."""

from collections.abc import Iterator

import pytest

from drivers.ur5e.arm import UR5e
from fakes.wire.ur.controller import URController
from support.ur5e import let_go_of_arms, make_arm, make_controller


@pytest.fixture
def controller() -> Iterator[URController]:
    controller = make_controller()
    controller.start()
    yield controller
    let_go_of_arms()
    controller.stop()


@pytest.fixture
def arm(controller: URController) -> Iterator[UR5e]:
    arm = make_arm(controller.host)
    arm.connect()
    yield arm
    arm.disconnect()
