"""The UR5e's driver and a simulated controller, each at a separate address."""

import itertools
import os
import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import (
    DeviceError,
)
from drivers.types import Pose, Vector6
from drivers.ur5e.arm import UR5e
from fakes.clock import SimulatedClock
from fakes.devices.arm import LIMITS, TOOL_LENGTH_M
from fakes.wire.ur.controller import URController
from fakes.wire.ur.robot import INSTALLED_COG_M, INSTALLED_KG
from fakes.world.world import BenchLayout, World

DOWN = Rotation.from_euler("x", 180, degrees=True)


HOME = Pose.from_rotation((0.45, 0.0, 0.3), DOWN)


_addresses = itertools.count(1)


def make_controller(version: str = "5.11.0") -> URController:
    pid = os.getpid()
    host = f"127.{200 + pid % 50}.{pid // 50 % 250}.{next(_addresses)}"
    world = World(BenchLayout(Pose((0.45, 0.0, 0.06)), HOME), seed=1)
    return URController(world, SimulatedClock(realtime=True), host, version, release_after_s=0.5)


_made: list[UR5e] = []


def make_arm(
    host: str,
    payload_kg: float = INSTALLED_KG,
    joint_limits_rad: tuple[Vector6, Vector6] | None = None,
) -> UR5e:
    tool = Pose((0.0, 0.0, TOOL_LENGTH_M))
    _made.append(UR5e(host, LIMITS, tool, payload_kg, INSTALLED_COG_M, joint_limits_rad))
    return _made[-1]


def let_go_of_arms() -> None:
    """Disconnect every arm that was made: what a test left connected is found by no later one."""
    while _made:
        _made.pop().disconnect()


def agree(question: str) -> None:
    """A person who has inspected the arm."""


def first_error(call: Callable[[], object], limit_s: float = 3.0) -> tuple[DeviceError, float]:
    """Ask until it raises; return the error and how long that took."""
    began = time.monotonic()
    while time.monotonic() - began < limit_s:
        try:
            call()
        except DeviceError as error:
            return error, time.monotonic() - began
        time.sleep(0.005)
    pytest.fail("no error")


def stands(controller: URController) -> bool:
    """Whether the arm stands, having had the time to brake."""
    time.sleep(0.1)
    before = controller.snapshot()["tcp_m"]
    time.sleep(0.1)
    return np.allclose(controller.snapshot()["tcp_m"], before, atol=1e-6)
