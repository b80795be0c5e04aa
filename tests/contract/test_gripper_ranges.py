"""The checks of every gripper, on simulated grippers whose ranges are not that of a Robotiq."""

from collections.abc import Iterator

import pytest

from drivers.bench import Bench
from rig.bench.assembly import build_bench
from rig.config import load_bench
from rig.contract_checks import TestGripper  # noqa: F401

RANGES = [(0, 80), (20, 1000), (6, 255)]


@pytest.fixture(params=RANGES, ids=lambda counts: f"{counts[0]} to {counts[1]}")
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    config = load_bench("fake")
    low, high = request.param
    per_count_m = config.gripper.limits.max_opening_m / (high - low)
    counts = {"min_counts": low, "max_counts": high, "opening_per_count_m": per_count_m}
    limits = config.gripper.limits.model_copy(update=counts)
    gripper = config.gripper.model_copy(update={"limits": limits})
    made, _ = build_bench(config.model_copy(update={"gripper": gripper}), seed=7)
    with made.connected():
        if request.node.get_closest_marker("moves") is not None:
            made.gripper.activate()
        yield made


@pytest.fixture
def inactive_bench(bench: Bench) -> Bench:
    return bench
