"""Contract checks of simulated devices, of real drivers on fakes over the wire protocols, and of hardware.

Hardware is used only if a bench file is given (`pytest tests/contract --bench FILE`), and moved only with
`--moves`. Then a person must be at the bench, the fingers must hold nothing, and the arm's path must be
clear.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.bench import Bench
from drivers.clock import to_ns
from rig.bench.assembly import build_bench, build_real_bench
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.config import BenchConfig, load_bench
from rig.contract_checks import make_ready_to_move, reconnect
from support.benches import lighter
from support.marks import require_ur_rtde
from support.slow_motion import CLOCK, SLOWNESS

EVERY_SIZE, SOME_SIZES = "slip", ((13, 17), (241, 319))
"""Estimator for frames of every size; sizes (height, width) for the others without --all."""
KINDS = ("fake", pytest.param("wire", marks=pytest.mark.heavy), "hardware")
RUNNING = pytest.StashKey[ExitStack]()


@dataclass(frozen=True)
class Station:
    """A bench of real drivers, and the side channel of the fakes that they are connected to."""

    bench: Bench
    config: BenchConfig
    tell: Callable[..., Any] | None


@pytest.fixture(scope="session")
def wire_station(request: pytest.FixtureRequest) -> Iterator[Station]:
    """Return real drivers on fakes over the wire protocols, in slow motion.

    `pytest_runtest_teardown` ends them.
    """
    require_ur_rtde()
    with ExitStack() as running:
        request.config.stash[RUNNING] = running
        config = running.enter_context(started_fakes(lighter("wire"), SLOWNESS))
        station = Station(build_real_bench(config, clock=CLOCK), config, fakes_control(config).call)
        running.callback(disconnect, station.bench)
        yield station


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the tests of devices in one worker, which share the station; mark sizes of frames as heavy."""
    for item in items:
        if item.path.parent == Path(__file__).parent:
            if "estimator" not in item.path.name:
                item.add_marker(pytest.mark.xdist_group("contract"))
            asked = item.callspec.params if hasattr(item, "callspec") else {}
            size, estimator = asked.get("size"), asked.get("make_estimator")
            if size is not None and estimator != EVERY_SIZE and size not in SOME_SIZES:
                item.add_marker(pytest.mark.heavy)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """End the fakes with the last test that needs them: what runs in real time takes most of a core."""
    needed = nextitem is not None and nextitem.path.parent == item.path.parent
    if not needed and (running := item.config.stash.get(RUNNING, None)) is not None:
        running.close()


@pytest.fixture(scope="session")
def hardware_station(real_config: BenchConfig, real_bench: Bench) -> Station:
    return Station(real_bench, real_config, None)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def bench(kind: str, request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A connected bench; for tests marked `moves` with the gripper activated and the arm at home."""
    moves = request.node.get_closest_marker("moves") is not None
    if kind == "fake":
        bench, _ = build_bench(load_bench("fake"), seed=7)
        with bench.connection():
            bench.clock.sleep_until(to_ns(0.2))  # the first frames have come
            if moves:
                bench.gripper.activate()
            yield bench
        return
    station: Station = request.getfixturevalue(f"{kind}_station")
    if kind == "hardware" and moves and not request.config.getoption("--moves"):
        pytest.skip("moves the hardware: add --moves if a person is at the bench")
    reconnect(station.bench)
    if moves:
        make_ready_to_move(station.bench, station.config)
    yield station.bench


@pytest.fixture
def inactive_bench(bench: Bench, kind: str, request: pytest.FixtureRequest) -> Bench:
    """Return a connected bench whose gripper has not been activated since power-on."""
    if kind == "wire":
        station: Station = request.getfixturevalue("wire_station")
        assert station.tell is not None
        station.tell("fault", device="gripper", kind="power_lost")
        station.tell("fault", device="gripper", kind="clear")
        bench.gripper.disconnect()
        bench.gripper.connect()
    if bench.gripper.state().activated:
        pytest.skip("this gripper is activated: cut its power to run this test")
    return bench


def disconnect(bench: Bench) -> None:
    for device in (bench.arm, bench.gripper, *bench.frame_sources):
        device.disconnect()
