"""Checked devices forward every member of the device interfaces, so that a new one cannot be forgotten."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.errors import DeviceError
from drivers.interfaces import Arm, Camera, Gripper, TactileSensor
from drivers.types import (
    ArmLimits,
    ArmMode,
    ArmState,
    Frame,
    GripperSpec,
    GripperState,
    Pose,
)
from fakes.clock import SimulatedClock
from rig.bench.own_devices import CheckedArm, CheckedDevice, CheckedGripper, CheckedSource

CLOCK = SimulatedClock()
AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
POSE = Pose((0.4, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
ARM_LIMITS = ArmLimits((0.0, -1.0, 0.0), (1.0, 1.0, 1.0), 0.5, 1.0, 5.0)
GRIPPER_SPEC = GripperSpec(0.1, 0.1, 1e-4, (0.01, 0.1), (10.0, 50.0))
ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "move_linear": (POSE, 0.1, 0.5),
    "recover": (lambda question: None,),
    "move_to": (0.05, 0.05, 20.0),
    "next_frame": (0.1,),
    "newest_frame": (0.1,),
    "set_light": (1.0, 1.0, 1.0),
}
FROM_THE_BENCH_FILE = {"limits", "spec", "serial", "rate_hz", "waits"}
"""Members that are answered without the driver."""


class Motion:
    """A motion that has ended."""

    def done(self) -> bool:
        return True

    def wait(self, timeout_s: float) -> None:
        """Return at once."""


class Recorder:
    """A driver with every method; `called` lists the names of those that were called."""

    answers: ClassVar[dict[str, Any]] = {
        "move_linear": Motion(),
        "move_to": Motion(),
        "next_frame": Frame(np.zeros((4, 3, 3), np.uint8), 1, 1, "S1"),
        "newest_frame": Frame(np.zeros((4, 3, 3), np.uint8), 1, 1, "S1"),
        "identity": {"model": "M"},
        "counters": {"lost": 2},
        "round_trips_s": (0.01,),
        "clock_offset_s": 0.5,
        "speed_fraction": 0.4,
    }

    def __init__(self, state: Any = None) -> None:
        self.called: list[str] = []
        self._answers = {**self.answers, "state": state}

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_"):
            raise AttributeError(name)

        def method(*_: Any) -> Any:
            self.called.append(name)
            return self._answers.get(name)

        return method


def arm(driver: Any) -> CheckedDevice:
    return CheckedArm(driver, "lab:Arm", ARM_LIMITS, CLOCK)


def gripper(driver: Any) -> CheckedDevice:
    return CheckedGripper(driver, "lab:Gripper", GRIPPER_SPEC, CLOCK)


def source(driver: Any) -> CheckedDevice:
    return CheckedSource(driver, "lab:Sensor", "S1", 30.0, (3, 4))


@pytest.mark.parametrize(
    ("protocol", "made_of", "state"),
    [
        (Arm, arm, ArmState(1, POSE, AT_REST, AT_REST, ArmMode.RUNNING)),
        (Gripper, gripper, GripperState(1, True, False, 0.05)),
        (TactileSensor, source, None),
        (Camera, source, None),
    ],
)
def test_checked_device_forwards_every_member(
    protocol: type[Any], made_of: Callable[[Any], CheckedDevice], state: Any
) -> None:
    for name in sorted({name for base in protocol.__mro__ for name in vars(base) if name[0] != "_"}):
        driver = Recorder(state)
        made = made_of(driver)
        if name in FROM_THE_BENCH_FILE:
            assert getattr(made, name) in (ARM_LIMITS, GRIPPER_SPEC, "S1", 30.0, False)
            assert driver.called == []
            continue
        answer = getattr(made, name)(*ARGUMENTS.get(name, ()))
        assert name in driver.called
        if name in ("counters", "round_trips_s", "clock_offset_s", "speed_fraction", "next_frame"):
            assert answer is driver.answers[name]


@pytest.mark.parametrize("fraction", [float("nan"), 7, True, "full"])
def test_invalid_speed_fraction_is_rejected(fraction: Any) -> None:
    driver = Recorder()
    driver._answers["speed_fraction"] = fraction
    with pytest.raises(DeviceError, match=r"lab:Arm.*speed_fraction"):
        CheckedArm(driver, "lab:Arm", ARM_LIMITS, CLOCK).speed_fraction()
