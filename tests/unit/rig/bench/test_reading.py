"""Grasp mode of the gripper in `--dry-run` and `rig doctor`, which activate nothing."""

from rig.bench.source import read_devices, unconnected_bench
from rig.config import load_bench
from rig.doctor.actuators import look_at_gripper
from rig.doctor.finding import Severity


def test_grasp_mode_is_named_unless_it_is_basic() -> None:
    for mode in ("wide", "pinch", "scissor", "basic"):
        with unconnected_bench(load_bench("fake")) as bench:
            bench.gripper.mode = mode  # type: ignore[attr-defined]
            (seen,) = (reading.seen for reading in read_devices(bench) if reading.device == "gripper")
            found = [(f.verdict, f.seen) for f in look_at_gripper(bench, 0.0) if f.check == "grasp mode"]
        named = f"in {mode} mode: activation in basic mode is asked for first"
        assert (named in seen, "mode" in seen) == (mode != "basic",) * 2
        assert found == ([] if mode == "basic" else [(Severity.WARNING, mode)])
