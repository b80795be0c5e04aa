"""The way home: it rises first, stays within limits, and causes no motion if the arm is home."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import pytest
from scipy.spatial.transform import Rotation

from drivers.bench import Bench
from drivers.errors import DeviceError, OperatorStopError, OutOfLimitsError
from drivers.interfaces import Arm, Motion
from drivers.types import ArmLimits, ArmState, Pose
from protocols.home import go_home
from protocols.readiness import make_ready
from protocols.steps import CLEARANCE_M
from rig.bench.assembly import TOOL_DOWN, build_bench
from rig.bench.operators import ConsoleOperator
from rig.config import load_bench
from support.benches import NOISE_M

HOME = (0.45, 0.0, 0.30)


@dataclass
class WatchedArm(Arm):
    """The simulated arm; it records targets and stops, and is lost after a number of motions."""

    arm: Arm
    sent: list[Pose] = field(default_factory=list)
    stops: int = 0
    lost_after: int = 1_000

    @property
    def limits(self) -> ArmLimits:
        return self.arm.limits

    def connect(self) -> None:
        self.arm.connect()

    def disconnect(self) -> None:
        self.arm.disconnect()

    def state(self) -> ArmState:
        return self.arm.state()

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        if len(self.sent) >= self.lost_after:
            raise DeviceError("arm: gone")
        self.sent.append(base_T_tcp)
        return self.arm.move_linear(base_T_tcp, speed_m_s, acceleration_m_s2)

    def stop(self) -> None:
        self.stops += 1
        self.arm.stop()

    def recover(self, confirm: Callable[[str], None]) -> None:
        self.arm.recover(confirm)


@pytest.fixture
def watched() -> Iterator[tuple[Bench, WatchedArm]]:
    bench, _ = build_bench(load_bench("fake"))
    arm = WatchedArm(bench.arm)
    bench = replace(bench, arm=arm)
    with bench.connected():
        bench.gripper.activate()
        yield bench, arm


def stand_at(bench: Bench, arm: WatchedArm, x: float, y: float, z: float) -> None:
    tilted = Rotation.from_euler("y", 10.0, degrees=True) * TOOL_DOWN
    arm.move_linear(Pose.from_rotation((x, y, z), tilted), 0.25, 1.0).wait(10.0)
    arm.sent.clear()


@pytest.mark.parametrize(
    ("start", "between"),
    [((0.60, 0.10, 0.07), (0.60, 0.10, HOME[2])), ((0.50, 0.10, 0.40), (HOME[0], HOME[1], 0.40))],
)
def test_home_is_reached_by_rising_then_across_then_down(
    watched: tuple[Bench, WatchedArm], start: tuple[float, ...], between: tuple[float, ...]
) -> None:
    """An arm above the height of home travels first and then descends."""
    bench, arm = watched
    stand_at(bench, arm, *start)
    go_home(bench)
    assert [pose.position_m for pose in arm.sent] == [pytest.approx(between, abs=NOISE_M), HOME]
    assert bench.arm.state().base_T_tcp.position_m == pytest.approx(HOME, abs=NOISE_M)


def test_way_to_a_low_home_avoids_the_objects(
    watched: tuple[Bench, WatchedArm],
) -> None:
    bench, arm = watched
    bench = replace(bench, base_T_home=Pose.from_rotation((0.45, 0.0, 0.08), TOOL_DOWN))
    stand_at(bench, arm, 0.60, 0.10, 0.07)
    go_home(bench)
    over = bench.base_T_table.position_m[2] + CLEARANCE_M
    assert [pose.position_m[2] for pose in arm.sent] == pytest.approx([over, over, 0.08])


def test_bench_is_ready_once_the_arm_is_home(watched: tuple[Bench, WatchedArm]) -> None:
    bench, arm = watched
    make_ready(bench, ConsoleOperator(lambda _: False))
    assert not arm.sent
    stand_at(bench, arm, 0.50, 0.0, 0.16)
    make_ready(bench, ConsoleOperator(lambda _: False))
    assert arm.sent[-1].position_m == HOME


def test_arm_lost_on_the_way_home_is_stopped(watched: tuple[Bench, WatchedArm]) -> None:
    bench, arm = watched
    stand_at(bench, arm, 0.50, 0.0, 0.16)
    arm.lost_after = 1
    with pytest.raises(DeviceError, match="arm: gone") as raised:
        make_ready(bench, ConsoleOperator(lambda _: False))
    assert arm.stops == 1
    assert raised.value.__notes__ == ["stopped where it was, nothing held"]
    assert bench.arm.state().base_T_tcp.position_m != pytest.approx(HOME)


def test_arm_stays_after_a_fault_without_an_inspection(watched: tuple[Bench, WatchedArm]) -> None:
    bench, arm = watched
    stand_at(bench, arm, 0.50, 0.0, 0.16)
    with pytest.raises(OperatorStopError):
        make_ready(bench, ConsoleOperator(lambda _: False, agreed=True), after_fault=True)
    assert not arm.sent


def test_a_way_home_outside_the_workspace_is_refused_before_anything_moves(
    watched: tuple[Bench, WatchedArm],
) -> None:
    bench, arm = watched
    bench = replace(bench, base_T_home=Pose.from_rotation((0.45, 0.0, 0.65), TOOL_DOWN))
    with pytest.raises(OutOfLimitsError, match=r"path home .* pendant"):
        go_home(bench)
    assert not arm.sent
