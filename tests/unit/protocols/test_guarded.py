"""A downward motion stops at contact, and the lift ends with a named fault."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

from drivers.clock import to_ns
from drivers.errors import ContactForceError, DeviceError, DeviceTimeoutError, InvalidStateError
from drivers.types import GripperState, HandState, Holding
from fakes.devices.gripper import FakeGripper
from fakes.world.force_torque import FlangeSensor
from protocols.capture_pivot import FIRST_ABOVE_M, capture_pivot
from protocols.observer import Phase
from protocols.safe_end import safe_end
from protocols.slip_trial import run_lift
from protocols.steps import CLEARANCE_M, LOWER_SPEED_M_S, MOTION_TIMEOUT_S, guard, move
from support.worlds import HOME

LiftOf = Callable[..., Any]


def raise_table(bench: Any, floor_z_m: float) -> None:
    """Make the simulated table higher than in the bench file."""
    bench.arm._world.layout = replace(bench.arm._world.layout, floor_z_m=floor_z_m)


def test_arm_stops_and_rises_if_the_fingers_meet_the_table(lift_of: LiftOf) -> None:
    lift = lift_of()
    grasp_z_m = lift.plan.base_T_grasp.position_m[2]
    floor_z_m = grasp_z_m + 0.02
    raise_table(lift.bench, floor_z_m)
    with pytest.raises(
        ContactForceError, match=r"met an obstacle on its way down.*max_contact_force_n 20"
    ) as hit:
        run_lift(lift.bench, lift.plan, lift.observer)
    assert "nothing held, fingers open, arm risen" in hit.value.__notes__[0]
    lowest = min(z for _, z, _, _ in lift.trace)
    assert floor_z_m - 0.006 < lowest < floor_z_m  # a sample of the force every 8 ms, at 0.25 m/s
    assert lift.height_m == pytest.approx(CLEARANCE_M, abs=2e-3)


@pytest.mark.heavy
@pytest.mark.parametrize("most_n", [1e4, None])
def test_force_limit_is_that_of_the_bench_file_and_without_a_sensor_there_is_none(
    lift_of: LiftOf, most_n: float | None
) -> None:
    lift = lift_of()
    lift.bench.arm.limits = replace(lift.bench.arm.limits, max_contact_force_n=most_n)
    raise_table(lift.bench, lift.plan.base_T_grasp.position_m[2] + 0.02)
    assert (lift.bench.arm.state().wrench is None) == (most_n is None)
    assert lift.run() == "done"


@pytest.mark.heavy
def test_setting_down_an_object_is_not_reported_as_contact(lift_of: LiftOf) -> None:
    for object_id in ("t1", "7", "9"):
        assert lift_of(object_id).run() == "done"


@pytest.mark.heavy
def test_lost_gripper_stops_the_descent(lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch) -> None:
    lift = lift_of()
    half_m = lift.plan.base_T_grasp.position_m[2] + CLEARANCE_M / 2
    original = FakeGripper.state

    def state(gripper: FakeGripper) -> Any:
        if lift.bench.arm.state().base_T_tcp.position_m[2] < half_m:
            raise DeviceTimeoutError("gripper: lost")
        return original(gripper)

    monkeypatch.setattr(FakeGripper, "state", state)
    with pytest.raises(DeviceTimeoutError, match="gripper: lost"):
        run_lift(lift.bench, lift.plan, lift.observer)
    stands_m = lift.bench.arm.state().base_T_tcp.position_m[2]
    assert half_m - 0.012 < stands_m < half_m


NAN = float("nan")


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((0.0, 0.0, 0.0), (NAN, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (NAN, 0.0, 500.0)),
        ((NAN, 0.0, 0.0), (NAN, 0.0, 500.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, float("inf"))),
        ((0.0, 0.0, 0.0), (0.0, 0.0)),
        ((0.0, 0.0, 0.0), (False, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), None),
    ],
)
def test_descent_stops_at_invalid_wrench(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch, before: Any, after: Any
) -> None:
    """Comparisons with NaN are false, so the arm would push with any force."""
    lift = lift_of()
    bench = lift.bench
    world = bench.arm._world
    start = world.tool.pose_at(bench.clock.now_ns())
    half_m = start.position_m[2] - 0.05

    def feel(sensor: FlangeSensor, time_ns: int, tcp_z_m: float) -> Any:
        down = world.tool.pose_at(time_ns).position_m[2] < half_m
        force = after if down else before
        return None if force is None else (*force, 0.0, 0.0, 0.0)

    monkeypatch.setattr(FlangeSensor, "sense", feel)
    with pytest.raises(DeviceError, match="wrench"):
        move(bench, start.translated(z_m=-0.1), LOWER_SPEED_M_S).wait(MOTION_TIMEOUT_S)
    bench.clock.sleep_until(bench.clock.now_ns() + to_ns(1.0))
    stands_m = world.tool.pose_at(bench.clock.now_ns()).position_m[2]
    assert stands_m > half_m - 0.005 if before[0] == 0.0 else stands_m == start.position_m[2]


def test_lift_ends_as_a_fault_at_invalid_wrench_on_the_way_up(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    lift = lift_of()
    felt = FlangeSensor.sense

    def feel(sensor: FlangeSensor, time_ns: int, tcp_z_m: float) -> Any:
        wrench = felt(sensor, time_ns, tcp_z_m)
        return (NAN, *wrench[1:]) if lift.observer.phase_now is Phase.LIFT else wrench

    monkeypatch.setattr(FlangeSensor, "sense", feel)
    with pytest.raises(InvalidStateError, match="wrench") as ended:
        run_lift(lift.bench, lift.plan, lift.observer)
    assert "stopped, fingers left as they are, still holding" in ended.value.__notes__[0]
    assert lift.held


def test_moving_fingers_stop_if_their_state_becomes_invalid(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    lift = lift_of()
    gripper, clock = lift.bench.gripper, lift.bench.clock
    lift.bench.hand.note(HandState(Holding.HELD, "wrench", lift.pose))
    gripper.move_to(gripper.spec.closed_m)
    clock.sleep_until(clock.now_ns() + to_ns(0.2))
    with monkeypatch.context() as broken:
        broken.setattr(FakeGripper, "state", lambda _: GripperState(0, True, True, float("nan")))
        with pytest.raises(InvalidStateError, match="opening_m") as ended, safe_end(lift.bench):
            gripper.state()
    assert "still holding wrench" in ended.value.__notes__[0]
    stopped_m = gripper.state().opening_m
    clock.sleep_until(clock.now_ns() + to_ns(1.0))
    assert gripper.state().opening_m >= stopped_m - 2 * gripper.spec.resolution_m


@pytest.mark.heavy
def test_step_of_a_tip_that_meets_the_table_is_stopped_and_asked_again(lift_of: LiftOf) -> None:
    bench = lift_of().bench
    height_m = bench.base_T_table.position_m[2] + FIRST_ABOVE_M
    raise_table(bench, height_m - 0.02)
    asked: list[str] = []
    steps = [(0.0, 0.0, -0.1), None]

    def nudge(question: str) -> Any:
        asked.append(question)
        return steps[len(asked) - 1]

    seated: list[float] = []
    capture_pivot(
        bench, [Rotation.identity()], nudge, lambda name, pose: seated.append(pose.position_m[2]), pytest.fail
    )
    assert "met an obstacle" in asked[1]
    assert seated == [pytest.approx(height_m - 0.022, abs=0.003)]


@pytest.mark.parametrize(
    "change_n", [(0.0, 0.0, -40.0), (0.0, 0.0, 40.0), (30.0, 0.0, 0.0), (0.0, -30.0, 0.0)]
)
def test_force_from_any_side_stops_a_guarded_motion(change_n: tuple[float, float, float]) -> None:
    """A change of 40 N against the weight of 20 N leaves the magnitude of the force as it was."""
    weight_n, stopped = (0.0, 0.0, 20.0), []
    felt = tuple(a + b for a, b in zip(weight_n, change_n, strict=True))
    arm = SimpleNamespace(
        limits=SimpleNamespace(max_contact_force_n=25.0),
        state=lambda: SimpleNamespace(force_n=felt, base_T_tcp=HOME),
        stop=lambda: stopped.append(True),
    )
    bench: Any = SimpleNamespace(arm=arm, clock=None)
    motion: Any = SimpleNamespace(is_done=lambda: False)
    before: Any = SimpleNamespace(force_n=weight_n)
    with pytest.raises(ContactForceError):
        guard(bench, motion, before).is_done()
    assert stopped
