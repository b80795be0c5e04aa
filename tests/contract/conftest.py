"""One suite per interface, for the simulated devices, the real drivers on fakes behind wires, and hardware.

Hardware is used when a bench file is given (`pytest tests/contract --bench FILE`), and moved only
with `--moves` as well: then somebody stands at the bench, whose fingers are free and whose way is clear.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import pytest

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceError
from drivers.types import Pose
from rig.bench.assembly import TOOL_DOWN, build_bench, build_real_bench
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.config import BenchConfig, load_bench
from support.benches import lighter

KINDS = ("fake", pytest.param("wire", marks=pytest.mark.real_time), "hardware")
RUNNING = pytest.StashKey[ExitStack]()


@dataclass(frozen=True)
class Station:
    """A bench of real drivers, and the side channel of the fakes behind them."""

    bench: Bench
    config: BenchConfig
    tell: Callable[..., Any] | None


@pytest.fixture(scope="session")
def wire_station(request: pytest.FixtureRequest) -> Iterator[Station]:
    """Real drivers on fakes behind wires, until `pytest_runtest_teardown` ends them."""
    with ExitStack() as running:
        request.config.stash[RUNNING] = running
        config = running.enter_context(started_fakes(lighter("wire")))
        station = Station(build_real_bench(config), config, fakes_control(config).call)
        running.callback(disconnect, station.bench)
        yield station


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """End the fakes with the last test that needs them: what runs in real time takes most of a core."""
    needed = nextitem is not None and nextitem.path.parent == item.path.parent
    if not needed and (running := item.config.stash.get(RUNNING, None)) is not None:
        running.close()


@pytest.fixture(scope="session")
def hardware_station(request: pytest.FixtureRequest) -> Iterator[Station]:
    file = request.config.getoption("--bench")
    if file is None:
        pytest.skip("needs real hardware: pytest tests/contract --bench FILE [--moves]")
    config = load_bench(file)
    if config.in_process:
        pytest.skip(f"{file} describes simulated devices")
    station = Station(build_real_bench(config), config, None)
    yield station
    disconnect(station.bench)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def bench(kind: str, request: pytest.FixtureRequest) -> Iterator[Bench]:
    """A connected bench; for tests marked `moves` with the gripper activated and the arm at home."""
    moves = request.node.get_closest_marker("moves") is not None
    if kind == "fake":
        bench, _ = build_bench(load_bench("fake"), seed=7)
        with bench.connected():
            bench.clock.sleep_until(to_ns(0.2))  # the first frames have come
            if moves:
                bench.gripper.activate()
            yield bench
        return
    station: Station = request.getfixturevalue(f"{kind}_station")
    if kind == "hardware" and moves and not request.config.getoption("--moves"):
        pytest.skip("moves the hardware: add --moves where somebody stands at the bench")
    reconnect(station.bench)
    if moves:
        go_home(station)
    yield station.bench


@pytest.fixture
def inactive_bench(bench: Bench, kind: str, request: pytest.FixtureRequest) -> Bench:
    """A connected bench whose gripper was not activated since it got power."""
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


def reconnect(bench: Bench) -> None:
    """Connect what the test before has disconnected, or a busy computer has cut off."""
    reads = [(source, partial(source.newest_frame, 1.0)) for source in bench.frame_sources]
    reads += [(bench.gripper, bench.gripper.state), (bench.arm, bench.arm.state)]
    for device, read in reads:
        try:
            read()
        except DeviceError:
            device.disconnect()
            device.connect()
    for source in bench.frame_sources:
        source.next_frame(5.0)


def go_home(station: Station) -> None:
    """Activate the gripper, open it, and bring the arm home."""
    bench = station.bench
    bench.arm.recover(lambda question: None)
    if not bench.gripper.state().activated:
        bench.gripper.activate()
    bench.gripper.move_to(bench.gripper.limits.min_counts).wait(10.0)
    home = Pose.from_rotation(station.config.arm.home_m, TOOL_DOWN)
    bench.arm.move_linear(home, 0.25, 1.0).wait(10.0)


def disconnect(bench: Bench) -> None:
    for device in (bench.arm, bench.gripper, *bench.frame_sources):
        device.disconnect()
