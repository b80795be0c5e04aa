"""Contract checks of the rig's grippers, and Robotiq's fault codes."""

import pytest

from drivers.bench import Bench
from drivers.errors import GripperFaultError
from rig.contract_checks import TestGripper  # noqa: F401


def test_gripper_that_is_not_activated_has_the_documented_fault_code(inactive_bench: Bench) -> None:
    with pytest.raises(GripperFaultError) as raised:
        inactive_bench.gripper.move_to(inactive_bench.gripper.spec.closed_m)
    assert raised.value.code == 5
