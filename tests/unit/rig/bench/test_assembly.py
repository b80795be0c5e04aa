"""The limits of a bench file are those of the simulated bench."""

from collections.abc import Callable
from typing import Any

import pytest

from drivers.errors import OutOfLimitsError
from drivers.types import Pose
from rig.bench.assembly import TOOL_DOWN, build_bench, simulated_bench_plan
from rig.config import BenchConfig, load_bench
from support.benches import NOISE_M


def bench_with(change: Callable[[dict[str, Any]], None]) -> BenchConfig:
    values = load_bench("fake").model_dump()
    change(values)
    return BenchConfig.model_validate(values)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"workspace_max_m": (0.75, 0.05, 0.60)}, "leaves the workspace"),
        ({"max_speed_m_s": 0.1}, "speed 0.2 m/s is outside 0 to 0.1"),
        ({"max_acceleration_m_s2": 0.5}, "acceleration 1.0 m/s2 is outside 0 to 0.5"),
        ({"joint_max_deg": (360.0, 360.0, 360.0, 360.0, 360.0, -170.0)}, "joint 6 would go to"),
    ],
)
def test_arm_limits_equal_those_of_the_bench_file(limits: dict[str, Any], said: str) -> None:
    target = Pose.from_rotation((0.50, 0.10, 0.20), TOOL_DOWN)
    for config, refused in ((bench_with(lambda v: v["arm"]["limits"].update(limits)), True),
                            (load_bench("fake"), False)):  # fmt: skip
        bench, _ = build_bench(config)
        with bench.connection():
            if refused:
                with pytest.raises(OutOfLimitsError, match=said):
                    bench.arm.move_linear(target, 0.2, 1.0)
                assert bench.arm.state().base_T_tcp.position_m == pytest.approx(
                    config.arm.home_m, abs=NOISE_M
                )
            else:
                bench.arm.move_linear(target, 0.2, 1.0).wait(10.0)


def test_gripper_range_equals_that_of_the_bench_file() -> None:
    limits = {"min_counts": 10, "max_counts": 230, "max_opening_m": 0.1, "opening_per_count_m": 0.0005}
    config = bench_with(lambda v: v["gripper"]["limits"].update(limits))
    bench, _ = build_bench(config)
    assert bench.gripper.spec == config.gripper_spec()
    with bench.connection():
        assert bench.gripper.state().raw["position_counts"] == 10
        bench.gripper.activate()
        for beyond_m in (0.1005, -0.0105):
            with pytest.raises(OutOfLimitsError, match=r"outside -10\.00 to 100\.00 mm"):
                bench.gripper.move_to(beyond_m)


def test_bench_file_without_limits_gives_the_default_simulated_cell() -> None:
    layout = simulated_bench_plan(load_bench("fake")).layout
    assert (layout.open_counts, layout.closed_counts) == (6, 255)
    assert (layout.max_opening_m, layout.opening_per_count_m) == (0.120, 0.155 / 249.0)
