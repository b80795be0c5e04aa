"""Contract checks of the rig's devices, the information that they report, and Robotiq's fault codes."""

import math

import pytest

from drivers.bench import Bench
from drivers.errors import GripperFaultError
from rig.contract_checks import TestArm, TestDiagnosis, TestFrames, TestGripper  # noqa: F401


def test_real_devices_have_identity_and_counters(bench: Bench, kind: str) -> None:
    for device in (bench.arm, bench.gripper, *bench.frame_sources):
        if kind != "fake":
            assert device.identity()
            assert device.counters()


def test_clock_offsets_and_round_trips_are_reported_if_known(bench: Bench, kind: str) -> None:
    offset_s = bench.arm.clock_offset_s()
    if kind == "fake":
        assert offset_s is None
        assert not bench.gripper.round_trips_s()
    else:
        assert offset_s is not None
        assert math.isfinite(offset_s)
        assert bench.gripper.round_trips_s()
        assert bench.arm.counters()["samples"] > 0
    assert all(source.clock_offset_s() is None for source in bench.frame_sources)


def test_gripper_that_is_not_activated_has_the_documented_fault_code(inactive_bench: Bench) -> None:
    with pytest.raises(GripperFaultError) as raised:
        inactive_bench.gripper.move_to(inactive_bench.gripper.spec.closed_m)
    assert raised.value.code == 5
