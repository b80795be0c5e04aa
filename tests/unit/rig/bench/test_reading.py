"""Grasp mode of the gripper in `--dry-run` and `rig doctor`, which activate nothing."""

from rig.bench.findings import Finding, Severity, first_findings
from rig.bench.source import unconnected_bench
from rig.config import load_bench
from rig.doctor.actuators import look_at_gripper


def modes(findings: list[Finding]) -> list[tuple[Severity, str]]:
    return [(f.verdict, f.seen) for f in findings if f.check == "grasp mode"]


def test_grasp_mode_is_named_unless_it_is_basic() -> None:
    for mode in ("wide", "pinch", "scissor", "basic"):
        with unconnected_bench(load_bench("fake")) as bench:
            bench.gripper.mode = mode  # type: ignore[attr-defined]
            first = modes(first_findings(bench, load_bench("fake")))
            assert first == modes(look_at_gripper(bench, 0.0))
        assert first == ([] if mode == "basic" else [(Severity.WARNING, mode)])
