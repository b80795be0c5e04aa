"""The early end of a lift depends on the state of the hand; a second Ctrl-C ends that, too."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.errors import DeviceError, OutOfLimitsError
from drivers.types import ArmMode, ArmState, Box, Holding
from fakes.devices.arm import FakeArm
from protocols.observer import Phase
from protocols.slip_trial import run_lift
from protocols.steps import CLEARANCE_M
from support.benches import NOISE_M
from support.marks import heavy

LiftOf = Callable[..., Any]
STOPPING_M = 0.0025
"""The simulated arm stops at once; between two samples of the trace it moves by 2 mm."""


def lowest(lift: Any, since: int) -> float:
    return min(z for _, z, _, _ in lift.trace[since:])


@pytest.mark.heavy
def test_uninterrupted_lift_ends_with_a_free_hand(lift_of: LiftOf) -> None:
    lift = lift_of()
    assert lift.run() == "done"
    held = [state.holding for state in lift.kept]
    assert held == [Holding.FREE, Holding.AROUND, Holding.HELD, Holding.AROUND, Holding.FREE]


def test_arm_stops_in_place_if_nothing_is_held_and_hand_is_clear(lift_of: LiftOf) -> None:
    lift = lift_of()
    lift.interrupt(lambda: 0.070 < lift.height_m < 0.083)
    note = lift.run()
    at, there = lift.interrupted_at[0], lift.trace[lift.interrupted_at[0]]
    assert "nothing held" in note
    assert abs(lift.pose.position_m[2] - there[1]) <= STOPPING_M
    assert lowest(lift, at) >= there[1] - STOPPING_M
    assert lift.bench.hand.state.holding is Holding.FREE


def test_fault_before_the_approach_causes_no_motion(lift_of: LiftOf) -> None:
    lift = lift_of()
    before = lift.pose
    lift.interrupt(lambda: True, DeviceError("gripper: no answer"))
    lift.run()
    assert lift.pose == before


def test_open_hand_around_the_object_opens_wide_and_rises_straight_up(lift_of: LiftOf) -> None:
    lift = lift_of()
    lift.interrupt(lambda: lift.observer.phase_now is Phase.REFERENCE)
    note = lift.run()
    at = lift.interrupted_at[0]
    assert "nothing held" in note
    assert lift.height_m == pytest.approx(CLEARANCE_M, abs=1e-6)
    assert max(abs(x - lift.trace[at][0]) for x, *_ in lift.trace[at:]) < NOISE_M
    assert lowest(lift, at) >= lift.trace[at][1] - STOPPING_M


HELD = pytest.mark.parametrize("phase", [Phase.LIFT, *heavy(Phase.HOLD), Phase.LOWER])


@pytest.mark.heavy
@HELD
def test_held_object_is_set_down_at_its_place(lift_of: LiftOf, phase: Phase) -> None:
    lift = lift_of()
    lift.interrupt(lambda: lift.observer.phase_now is phase and lift.height_m > 0.015)
    assert "set down" in lift.run()
    place = lift.plan.base_T_grasp.position_m[2]
    let_go = next(z for _, z, _, held in lift.trace[lift.interrupted_at[0] :] if not held)
    assert let_go == pytest.approx(place, abs=1e-4)
    assert lift.height_m == pytest.approx(CLEARANCE_M, abs=1e-6)
    assert lift.bench.hand.state.holding is Holding.FREE


@pytest.mark.heavy
@HELD
def test_second_ctrl_c_stops_the_teardown_in_place(lift_of: LiftOf, phase: Phase) -> None:
    lift = lift_of()
    lift.interrupt(lambda: lift.observer.phase_now is phase and lift.height_m > 0.02)
    lift.interrupt(lambda: lift.height_m < 0.017)
    assert "stopped at once, still holding wrench" in lift.run()
    there = lift.trace[lift.interrupted_at[1]][1]
    assert lift.pose.position_m[2] == pytest.approx(there, abs=STOPPING_M)
    assert lift.held
    assert lift.bench.hand.state.holding is Holding.HELD


@pytest.mark.parametrize(
    ("gripper_is_lost", "said"), [(False, "not above the place"), (True, "still holding wrench (gripper")]
)
def test_object_away_from_its_place_or_of_a_lost_gripper_stays_held(
    lift_of: LiftOf, gripper_is_lost: bool, said: str
) -> None:
    lift = lift_of()
    elsewhere, note = lift.plan.base_T_grasp.translated(x_m=0.05), lift.bench.hand.note
    if not gripper_is_lost:
        lift.bench.hand.note = lambda state: note(replace(state, base_T_grasp=elsewhere))

    def in_the_air() -> bool:
        if lift.observer.phase_now is Phase.HOLD and gripper_is_lost:
            lift.bench.gripper.disconnect()
        return lift.observer.phase_now is Phase.HOLD

    lift.interrupt(in_the_air)
    assert said in lift.run()
    assert lift.held
    assert lift.height_m == pytest.approx(lift.plan.lift_height_m, abs=STOPPING_M)


@pytest.mark.parametrize(("late", "named"), [("0.41 s", False), ("0.41 s, limit", True)])
def test_cause_that_also_prevents_the_safe_end_is_named_once(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch, late: str, named: bool
) -> None:
    lift = lift_of()
    lift.interrupt(lambda: lift.observer.phase_now is Phase.HOLD, DeviceError(f"arm: no state for {late}"))

    def stop(_: FakeArm) -> None:
        raise DeviceError("arm: no state for 0.52 s")

    monkeypatch.setattr(FakeArm, "stop", stop)
    assert ("still holding wrench (arm: no state" in lift.run()) == named


def test_protective_stop_is_detected_during_any_wait_of_the_lift(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    lift = lift_of()
    pressed_ns: list[int] = []

    def stopped(_: FakeArm, now_ns: int) -> bool:
        if lift.observer.phase_now is Phase.HOLD:
            pressed_ns.append(now_ns)
        return bool(pressed_ns)

    monkeypatch.setattr(FakeArm, "_protective_stop", stopped)
    assert "protective stop" in lift.run()
    assert lift.bench.clock.now_ns() - pressed_ns[0] < 100_000_000  # three pictures of the camera
    assert lift.held


def test_emergency_stop_in_the_hold_phase_is_noticed_within_two_frames(
    lift_of: LiftOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    lift = lift_of()
    state, running = FakeArm.state, FakeArm._check_running
    pressed_ns: list[int] = []
    noticed_ns: list[int] = []

    def seen(arm: FakeArm) -> ArmState:
        now_ns = lift.bench.clock.now_ns()
        if lift.observer.phase_now is Phase.HOLD and not pressed_ns:
            pressed_ns.append(now_ns + 3_000_000)  # just after the arm was polled
        pressed = pressed_ns and now_ns >= pressed_ns[0]
        return replace(state(arm), mode=ArmMode.EMERGENCY_STOP) if pressed else state(arm)

    def may_move(arm: FakeArm) -> None:
        if pressed_ns:
            raise DeviceError("arm: emergency stop")
        running(arm)

    monkeypatch.setattr(FakeArm, "state", seen)
    monkeypatch.setattr(FakeArm, "stop", lambda arm: noticed_ns.append(lift.bench.clock.now_ns()))
    monkeypatch.setattr(FakeArm, "_check_running", may_move)
    with pytest.raises(DeviceError, match="emergency"):
        run_lift(lift.bench, lift.plan, lift.observer)
    assert noticed_ns[0] - pressed_ns[0] < 70_000_000
    assert lift.held


@pytest.mark.parametrize(
    ("width_m", "box_z_m", "said"),
    [
        (0.118, 0.5, r"118\.0 mm wide is too wide.*open 120\.0 mm"),
        (0.012, 0.10, "into 'lamp'"),
        (0.012, 0.20, "into 'lamp'"),
    ],
)
def test_plan_beyond_the_limits_is_rejected_before_any_motion(
    lift_of: LiftOf, width_m: float, box_z_m: float, said: str
) -> None:
    lift = lift_of()
    x, y, _ = lift.plan.base_T_grasp.position_m
    box = Box("lamp", (x - 0.05, y - 0.05, box_z_m), (x + 0.05, y + 0.05, box_z_m + 0.02))
    lift.plan = replace(lift.plan, lift_height_m=0.2, width_m=width_m)
    lift.bench.arm.limits = replace(lift.bench.arm.limits, keep_out=(box,))
    before = (lift.pose, lift.counts)
    with pytest.raises(OutOfLimitsError, match=said):
        run_lift(lift.bench, lift.plan, lift.observer)
    assert (lift.pose, lift.counts) == before


@pytest.mark.heavy
def test_low_hand_rises_before_it_travels(lift_of: LiftOf) -> None:
    lift = lift_of()
    low = lift.plan.base_T_grasp.translated(x_m=0.12, z_m=0.01)
    lift.bench.arm.move_linear(low, 0.25, 1.0).wait(5.0)
    started = len(lift.trace)
    lift.interrupt(lambda: lift.observer.phase_now is Phase.REFERENCE)
    lift.run()
    clear_m = lift.plan.base_T_grasp.position_m[2] + CLEARANCE_M - 1e-6
    sideways = [z for x, z, _, _ in lift.trace[started:] if 1e-4 < low.position_m[0] - x < 0.119]
    assert sideways
    assert min(sideways) >= clear_m
