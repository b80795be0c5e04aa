"""Options and fixtures of the checks, as a plugin of pytest: `-p rig.contract_checks.options`.

`--estimator NAME` checks an estimator. `--bench FILE` checks the devices that a bench file names, each kind
reached alone, so that `-k frames` needs no arm. Nothing moves without `--moves`: then somebody stands at the
bench, whose fingers are free and whose way is clear.
"""

from collections.abc import Callable, Iterator

import pytest

from drivers.bench import Bench
from drivers.types import Image, Pose
from rig.bench.assembly import TOOL_DOWN, build_real_bench
from rig.config import BenchConfig, load_bench
from rig.contract_checks.devices import of_test, reconnect
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import TactileEstimator

for checks in ("arm", "diagnosis", "estimator", "frames", "gripper"):
    pytest.register_assert_rewrite(f"rig.contract_checks.test_{checks}")
HOME_SPEED_M_S, HOME_ACCELERATION_M_S2, MOTION_S = 0.25, 1.0, 10.0
MakeEstimator = Callable[[Image], TactileEstimator]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("contract", "contract checks")
    group.addoption("--bench", metavar="FILE", help="bench file whose real devices are checked")
    group.addoption("--moves", action="store_true", help="let the checks move that hardware")
    group.addoption("--estimator", metavar="NAME", help="estimator that is checked, as package.module:Class")


def pytest_configure(config: pytest.Config) -> None:
    """Name the marker that the checks use."""
    config.addinivalue_line("markers", "moves: moves the arm or the fingers; on hardware only with --moves")


@pytest.fixture
def make_estimator(request: pytest.FixtureRequest) -> MakeEstimator:
    """What makes the estimator that is checked from its background."""
    name = request.config.getoption("--estimator")
    if name is None:
        pytest.skip("give --estimator package.module:Class")
    return choose_estimator(name, 1).make


@pytest.fixture(scope="session")
def real_config(request: pytest.FixtureRequest) -> BenchConfig:
    """The bench file of the devices that are checked."""
    file = request.config.getoption("--bench")
    if file is None:
        pytest.skip("needs real hardware: give --bench FILE, and --moves to let it move")
    config = load_bench(file)
    if config.in_process:
        pytest.skip(f"{file} describes simulated devices")
    return config


@pytest.fixture(scope="session")
def real_bench(real_config: BenchConfig) -> Iterator[Bench]:
    """The devices, made and not yet reached; let go of in the end."""
    bench = build_real_bench(real_config)
    yield bench
    for device in (*bench.actuators, *bench.frame_sources):
        device.disconnect()


@pytest.fixture
def bench(real_bench: Bench, real_config: BenchConfig, request: pytest.FixtureRequest) -> Bench:
    """A bench whose devices that this test is about are connected; for tests that move, ready to.

    Tests of devices that the bench file lacks are skipped.
    """
    needed = of_test(request.module, real_bench)
    if not needed:
        pytest.skip("the bench file has no such device")
    moves = request.node.get_closest_marker("moves") is not None
    if moves and not request.config.getoption("--moves"):
        pytest.skip("moves the hardware: add --moves where somebody stands at the bench")
    reconnect(real_bench, needed)
    if moves:
        make_ready_to_move(real_bench, real_config, needed)
    return real_bench


@pytest.fixture
def inactive_bench(bench: Bench) -> Bench:
    """A connected bench whose gripper was not activated since it got power."""
    if bench.gripper.state().activated:
        pytest.skip("this gripper is activated: cut its power to run this test")
    return bench


def make_ready_to_move(bench: Bench, config: BenchConfig, needed: frozenset[str]) -> None:
    """Activate the gripper and open it, and bring the arm home, as far as they are needed."""
    if "gripper" in needed:
        if not bench.gripper.state().activated:
            bench.gripper.activate()
        bench.gripper.move_to(bench.gripper.spec.open_m).wait(MOTION_S)
    if "arm" in needed:
        bench.arm.recover(lambda question: None)
        home = Pose.from_rotation(config.arm.home_m, TOOL_DOWN)
        bench.arm.move_linear(home, HOME_SPEED_M_S, HOME_ACCELERATION_M_S2).wait(MOTION_S)
