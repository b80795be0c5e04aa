"""Running controllers, and the UR5e's driver connected to one."""

from collections.abc import Callable, Iterator

import pytest

from drivers.ur5e.arm import UR5e
from fakes.wire.ur.controller import URController
from support.ur5e import let_go_of_arms, make_arm, make_controller


@pytest.fixture
def started() -> Iterator[Callable[..., URController]]:
    """Starts controllers, `started(version)`; the test's arms are disconnected before they stop."""
    running: list[URController] = []

    def start(*version: str) -> URController:
        running.append(make_controller(*version))
        running[-1].start()
        return running[-1]

    yield start
    let_go_of_arms()
    for controller in running:
        controller.stop()


@pytest.fixture
def controller(started: Callable[..., URController]) -> URController:
    return started()


@pytest.fixture
def arm(controller: URController) -> UR5e:
    arm = make_arm(controller.host)
    arm.connect()
    return arm
