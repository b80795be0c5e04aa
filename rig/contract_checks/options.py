"""Options and fixtures of the checks, as a pytest plugin: `-p rig.contract_checks.options`.

`--estimator NAME` checks an estimator. `--bench FILE` checks the devices of a bench file. Each kind is
connected alone, so that `-k frames` needs no arm. Nothing moves without `--moves`. With it, a person must be
at the bench, the fingers must hold nothing, and the path of the arm must be clear.
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
"""Speed, acceleration and time limit of the motion to the home pose."""
MakeEstimator = Callable[[Image], TactileEstimator]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("contract", "contract checks")
    group.addoption("--bench", metavar="FILE", help="bench file whose real devices are checked")
    group.addoption("--moves", action="store_true", help="let the checks move that hardware")
    group.addoption("--estimator", metavar="NAME", help="estimator that is checked, as package.module:Class")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker that the checks use."""
    config.addinivalue_line("markers", "moves: moves the arm or the fingers; on hardware only with --moves")


@pytest.fixture
def make_estimator(request: pytest.FixtureRequest) -> MakeEstimator:
    """Return a function that makes the checked estimator from its background."""
    name = request.config.getoption("--estimator")
    if name is None:
        pytest.skip("give --estimator package.module:Class")
    return choose_estimator(name, 1).make


@pytest.fixture(scope="session")
def real_config(request: pytest.FixtureRequest) -> BenchConfig:
    """Return the bench file of the checked devices."""
    file = request.config.getoption("--bench")
    if file is None:
        pytest.skip("needs real hardware: give --bench FILE, and --moves to let it move")
    config = load_bench(file)
    if config.in_process:
        pytest.skip(f"{file} describes simulated devices")
    return config


@pytest.fixture(scope="session")
def real_bench(real_config: BenchConfig) -> Iterator[Bench]:
    """Create the devices, unconnected; disconnect them at the end."""
    bench = build_real_bench(real_config)
    yield bench
    for device in (*bench.actuators, *bench.frame_sources):
        device.disconnect()


@pytest.fixture
def bench(real_bench: Bench, real_config: BenchConfig, request: pytest.FixtureRequest) -> Bench:
    """Return a bench with the devices of this test connected; for tests that move, also ready to move.

    Tests of devices that the bench file lacks are skipped.
    """
    needed = of_test(request.module, real_bench)
    if not needed:
        pytest.skip("the bench file has no such device")
    moves = request.node.get_closest_marker("moves") is not None
    if moves and not request.config.getoption("--moves"):
        pytest.skip("moves the hardware: add --moves if a person is at the bench")
    reconnect(real_bench, needed)
    if moves:
        make_ready_to_move(real_bench, real_config, needed)
    return real_bench


@pytest.fixture
def inactive_bench(bench: Bench) -> Bench:
    """Return a connected bench whose gripper has not been activated since power-on."""
    if bench.gripper.state().activated:
        pytest.skip("this gripper is activated: cut its power to run this test")
    return bench


def make_ready_to_move(bench: Bench, config: BenchConfig, needed: frozenset[str]) -> None:
    """Activate and open the gripper, and move the arm home, as far as they are needed."""
    if "gripper" in needed:
        if not bench.gripper.state().activated:
            bench.gripper.activate()
        bench.gripper.move_to(bench.gripper.spec.open_m).wait(MOTION_S)
    if "arm" in needed:
        bench.arm.recover(lambda question: None)
        home = Pose.from_rotation(config.arm.home_m, TOOL_DOWN)
        bench.arm.move_linear(home, HOME_SPEED_M_S, HOME_ACCELERATION_M_S2).wait(MOTION_S)
