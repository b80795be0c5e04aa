"""The checks of every gripper, on grippers whose ranges are not that of a Robotiq.

They are simulated ones, and the parallel gripper that `rig new lab` writes.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.bench import Bench
from fakes.clock import SimulatedClock
from rig import templates
from rig.bench.assembly import build_bench
from rig.bench.own_devices import own_gripper
from rig.config import load_bench
from rig.config.devices import OwnGripperConfig, StrokeLimits
from rig.contract_checks import TestGripper  # noqa: F401

PARALLEL = OwnGripperConfig(
    driver="my_lab:MyLabGripper",
    fingers=("B", "C"),
    limits=StrokeLimits(
        max_opening_m=0.085,
        stroke_m=0.080,
        resolution_m=0.0005,
        speed_m_s=(0.02, 0.15),
        force_n=(20.0, 235.0),
    ),
)


@pytest.fixture(params=[(0, 80), (20, 1000), (6, 255), "parallel"], ids=str)
def bench(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    config, clock = load_bench("fake"), SimulatedClock()
    if request.param == "parallel":
        monkeypatch.syspath_prepend(Path(next(iter(templates.__path__))) / "lab")
        gripper = own_gripper(PARALLEL, PARALLEL.limits.spec(), clock)
        made = replace(build_bench(config, seed=7)[0], clock=clock, gripper=gripper)  # type: ignore[arg-type]
    else:
        low, high = request.param
        per_count_m = config.gripper.limits.max_opening_m / (high - low)
        counts = {"min_counts": low, "max_counts": high, "opening_per_count_m": per_count_m}
        keys = {"limits": config.gripper.limits.model_copy(update=counts)}
        own = config.model_copy(update={"gripper": config.gripper.model_copy(update=keys)})
        made, _ = build_bench(own, seed=7)
    made.gripper.connect()
    if request.node.get_closest_marker("moves") is not None:
        made.gripper.activate()
    yield made
    made.gripper.disconnect()


@pytest.fixture
def inactive_bench(bench: Bench) -> Bench:
    return bench


@pytest.mark.heavy
@pytest.mark.parametrize("bench", ["parallel"], indirect=True)
def test_range_is_that_of_the_bench_file(bench: Bench) -> None:
    spec = bench.gripper.spec
    assert (spec.open_m, spec.closed_m, spec.steps) == (0.085, pytest.approx(0.005), 160)
    assert (spec.speed_m_s, spec.force_n) == ((0.02, 0.15), (20.0, 235.0))
