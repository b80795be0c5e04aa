"""The way home: it rises first, stays within limits, and causes no motion if the arm is home."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import pytest
from scipy.spatial.transform import Rotation

from drivers.bench import Bench
from drivers.errors import DeviceError, OperatorStopError, OutOfLimitsError
from drivers.motion import Motion
from drivers.types import Pose
from protocols.readiness import make_ready
from protocols.steps import CLEARANCE_M, go_home
from rig.bench.assembly import TOOL_DOWN, build_bench
from rig.bench.operators import ConsoleOperator
from rig.config import load_bench
from support.benches import NOISE_M

HOME = (0.45, 0.0, 0.30)
LOW = (0.50, 0.0, 0.16)
NOBODY = ConsoleOperator(lambda _: False)


@dataclass
class Watched:
    """A bench; the targets and stops of its arm, which is lost after a number of motions."""

    bench: Bench
    sent: list[Pose] = field(default_factory=list)
    stops: int = 0
    lost_after: int = 1_000

    def stand_at(self, position_m: tuple[float, ...]) -> None:
        tilted = Rotation.from_euler("y", 10.0, degrees=True) * TOOL_DOWN
        self.bench.arm.move_linear(Pose.from_rotation(position_m, tilted), 0.25, 1.0).wait(10.0)
        self.sent.clear()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    bench, _ = build_bench(load_bench("fake"))
    watched, move, stop = Watched(bench), bench.arm.move_linear, bench.arm.stop

    def moved(base_T_tcp: Pose, *limits: float) -> Motion:  # noqa: N803
        if len(watched.sent) >= watched.lost_after:
            raise DeviceError("arm: gone")
        watched.sent.append(base_T_tcp)
        return move(base_T_tcp, *limits)

    def stopped() -> None:
        watched.stops += 1
        stop()

    monkeypatch.setattr(bench.arm, "move_linear", moved)
    monkeypatch.setattr(bench.arm, "stop", stopped)
    with bench.connection():
        bench.gripper.activate()
        yield watched


@pytest.mark.parametrize(
    ("start", "home", "ways"),
    [
        ((0.60, 0.10, 0.07), HOME, [(0.60, 0.10, HOME[2]), HOME]),
        ((0.50, 0.10, 0.40), HOME, [(HOME[0], HOME[1], 0.40), HOME]),  # from above it, travel, then descend
        ((0.60, 0.10, 0.07), (0.45, 0.0, 0.08), [None, None, (0.45, 0.0, 0.08)]),  # a low home
    ],
)
def test_home_is_reached_by_rising_then_across_then_down(
    watched: Watched, start: tuple[float, ...], home: tuple[float, ...], ways: list[tuple[float, ...] | None]
) -> None:
    bench = replace(watched.bench, base_T_home=Pose.from_rotation(home, TOOL_DOWN))
    watched.stand_at(start)
    go_home(bench)
    assert len(watched.sent) == len(ways)
    over_m = bench.base_T_table.position_m[2] + CLEARANCE_M
    for pose, way in zip(watched.sent, ways, strict=True):
        if way is None:
            assert pose.position_m[2] == pytest.approx(over_m), "above the objects"
        else:
            assert pose.position_m == pytest.approx(way, abs=NOISE_M)
    assert bench.arm.state().base_T_tcp.position_m == pytest.approx(home, abs=NOISE_M)


def test_bench_is_ready_once_the_arm_is_home(watched: Watched) -> None:
    make_ready(watched.bench, NOBODY)
    assert not watched.sent
    watched.stand_at(LOW)
    make_ready(watched.bench, NOBODY)
    assert watched.sent[-1].position_m == HOME


def test_arm_lost_on_the_way_home_is_stopped(watched: Watched) -> None:
    watched.stand_at(LOW)
    watched.lost_after = 1
    with pytest.raises(DeviceError, match="arm: gone") as raised:
        make_ready(watched.bench, NOBODY)
    assert watched.stops == 1
    assert raised.value.__notes__ == ["stopped where it was, nothing held"]
    assert watched.bench.arm.state().base_T_tcp.position_m != pytest.approx(HOME)


def test_arm_stays_without_an_inspection_after_a_fault_and_if_home_is_outside_the_workspace(
    watched: Watched,
) -> None:
    watched.stand_at(LOW)
    with pytest.raises(OperatorStopError):
        make_ready(watched.bench, ConsoleOperator(lambda _: False, agreed=True), after_fault=True)
    outside = replace(watched.bench, base_T_home=Pose.from_rotation((0.45, 0.0, 0.65), TOOL_DOWN))
    with pytest.raises(OutOfLimitsError, match=r"path home .* pendant"):
        go_home(outside)
    assert not watched.sent
