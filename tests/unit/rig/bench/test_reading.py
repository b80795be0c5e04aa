"""Grasp mode of the gripper in `--dry-run` and `rig doctor`, which activate nothing."""

import pytest

from rig.bench.source import read_devices, unconnected_bench
from rig.config import load_bench
from rig.doctor.actuators import look_at_gripper
from rig.doctor.finding import Severity


@pytest.mark.parametrize("mode", ["wide", "pinch", "scissor"])
def test_other_grasp_mode_is_named(mode: str) -> None:
    with unconnected_bench(load_bench("fake")) as bench:
        bench.gripper.mode = mode  # type: ignore[attr-defined]
        (seen,) = (reading.seen for reading in read_devices(bench) if reading.device == "gripper")
        assert f"in {mode} mode: activation in basic mode is asked for first" in seen
        (finding,) = (f for f in look_at_gripper(bench, 0.0) if f.check == "grasp mode")
        assert finding.verdict is Severity.WARNING
        assert finding.seen == mode


def test_basic_mode_is_not_mentioned() -> None:
    with unconnected_bench(load_bench("fake")) as bench:
        assert "mode" not in " ".join(reading.seen for reading in read_devices(bench))
        assert "grasp mode" not in {f.check for f in look_at_gripper(bench, 0.0)}
