"""The UR5e's driver and simulated controllers, each at a separate address, all in slow motion."""

import itertools
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.clock import to_ns
from drivers.errors import DeviceError, OperatorStopError
from drivers.types import Pose, Vector6
from drivers.ur5e.arm import UR5e
from fakes.clock import SharedClock
from fakes.devices.arm import LIMITS
from fakes.wire.ur.controller import URController
from fakes.wire.ur.robot import INSTALLED_COG_M, INSTALLED_KG
from fakes.world.kinematics import TOOL_LENGTH_M
from support.slow_motion import CLOCK, SLOWNESS, pause
from support.worlds import empty_world

_addresses = itertools.count(1)


def make_controller(version: str = "5.11.0") -> URController:
    pid = os.getpid()
    host = f"127.{200 + pid % 50}.{pid // 50 % 250}.{next(_addresses)}"
    return URController(empty_world(), SharedClock.start(SLOWNESS), host, version, release_after_s=0.5)


_made: list[UR5e] = []


def make_arm(
    host: str, payload_kg: float = INSTALLED_KG, joint_limits_rad: tuple[Vector6, Vector6] | None = None
) -> UR5e:
    tool = Pose((0.0, 0.0, TOOL_LENGTH_M))
    _made.append(UR5e(host, LIMITS, tool, payload_kg, INSTALLED_COG_M, joint_limits_rad, CLOCK))
    return _made[-1]


def let_go_of_arms() -> None:
    """Disconnect all arms that `make_arm` has made."""
    while _made:
        _made.pop().disconnect()


@contextmanager
def running(
    script: str, controller: URController, *arguments: object, stderr: int | None = None
) -> Iterator["subprocess.Popen[str]"]:
    """Run a Python script with arguments: the controller's address, the slowness, and `arguments`."""
    command = [sys.executable, "-c", script, controller.host, str(SLOWNESS), *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True) as program:
        try:
            yield program
        finally:
            program.kill()


def agree(question: str) -> None:
    """A person who has inspected the arm."""


def refuse(question: str) -> None:
    """A person who does not agree. Raises `OperatorStopError`."""
    raise OperatorStopError(question)


def first_error(call: Callable[[], object], limit_s: float = 3.0) -> DeviceError:
    """Call until it raises `DeviceError`, and return that; fail after `limit_s` of the slow clock."""
    end_ns = CLOCK.now_ns() + to_ns(limit_s)
    while CLOCK.now_ns() < end_ns:
        try:
            call()
        except DeviceError as error:
            return error
        pause(0.002)
    pytest.fail("no error")


def stands(controller: URController) -> bool:
    """Whether the arm stands, having had the time to brake."""
    pause(0.1)
    before = controller.snapshot()["tcp_m"]
    pause(0.05)
    return np.allclose(controller.snapshot()["tcp_m"], before, atol=1e-6)
