"""Before the first motion the rig checks the hand, asks if necessary, and sets an object down."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.bench import Hand
from drivers.errors import OperatorStopError
from drivers.types import GripperState, HandState, Holding
from protocols.observer import Phase
from protocols.readiness import agree_to_carry, check_hand, free_hand, make_ready
from rig.bench.operators import ConsoleOperator

LiftOf = Callable[..., Any]


class Person(ConsoleOperator):
    """Gives the same answer to every question and records `asked`. It agrees beforehand, like --yes."""

    def __init__(self, agrees: bool = True) -> None:
        self.asked: list[str] = []
        super().__init__(lambda question: self.asked.append(question) or agrees, agreed=True)


def left_in_the_air(lift_of: LiftOf) -> Any:
    """A lift whose program was killed while the object was in the fingers."""
    lift = lift_of()
    lift.interrupt(lambda: lift.observer.phase_now is Phase.HOLD)
    lift.interrupt(lambda: True)
    assert "still holding" in lift.run()
    lift.interruptions.clear()
    lift.trace.clear()
    return lift


def restarted(lift: Any, state: HandState) -> Any:
    """The same bench in a new program."""
    return replace(lift.bench, hand=Hand(state, lift.kept.append))


def test_free_hand_is_asked_about_after_a_fault_only(lift_of: LiftOf) -> None:
    lift, person = lift_of(), Person(agrees=False)
    make_ready(lift.bench, person)
    agree_to_carry(lift.bench, person)
    assert person.asked == []
    assert lift.bench.hand.state == HandState(Holding.FREE, finger_opening_m=lift.bench.gripper.spec.open_m)
    make_ready(lift.bench, agreeing := Person(), after_fault=True)
    assert len(agreeing.asked) == 1


def test_free_fingers_that_closed_since_may_hold_something(lift_of: LiftOf) -> None:
    lift = lift_of()
    for closed_m, holding in ((0.001, Holding.FREE), (0.002, Holding.UNKNOWN)):
        known = HandState(Holding.FREE, finger_opening_m=lift.bench.gripper.state().opening_m + closed_m)
        assert check_hand(restarted(lift, known)).holding is holding


@pytest.mark.heavy
@pytest.mark.parametrize("after_fault", [False, True])
def test_object_held_by_the_last_program_is_set_down_at_its_place(lift_of: LiftOf, after_fault: bool) -> None:
    lift, person = left_in_the_air(lift_of), Person()
    bench = restarted(lift, lift.bench.hand.state)
    make_ready(bench, person, after_fault)
    assert len(person.asked) == 2
    assert "Is the hand empty" in person.asked[1]
    assert ("ended in a fault. The hand holds wrench" if after_fault else "holds wrench") in person.asked[0]
    assert "set down" in person.asked[0]
    place = lift.plan.base_T_grasp.position_m[2]
    assert next(z for _, z, _, held in lift.trace if not held) == pytest.approx(place, abs=1e-4)
    assert lift.pose.position_m == pytest.approx(bench.base_T_home.position_m, abs=1e-6)
    assert bench.hand.state.holding is Holding.FREE
    person.place("t1", "wrench")
    assert person.asked[2:] == ["Place object t1 (wrench) on its mark: the hand was emptied. Ready?"]


@pytest.mark.heavy
def test_object_stays_held_without_an_answer_even_with_yes(lift_of: LiftOf) -> None:
    lift, person = left_in_the_air(lift_of), Person(agrees=False)
    before = (lift.pose, lift.counts)
    bench = restarted(lift, lift.bench.hand.state)
    for ask in (make_ready, agree_to_carry):
        with pytest.raises(OperatorStopError, match="nothing was moved"):
            ask(bench, person)
    assert (lift.pose, lift.counts, lift.held) == (*before, True)
    assert "The arm will move with it" in person.asked[1]


@pytest.mark.heavy
def test_fingers_closed_for_unknown_reason_open_only_after_a_question(lift_of: LiftOf) -> None:
    lift = left_in_the_air(lift_of)
    for known in (HandState(Holding.UNKNOWN, "no record"), HandState(Holding.FREE, finger_opening_m=0.11)):
        refusing = Person(agrees=False)
        with pytest.raises(OperatorStopError):
            free_hand(restarted(lift, known), refusing)
        assert "unknown whether the fingers hold something" in refusing.asked[0]
        assert "Hold any object between" in refusing.asked[0]
        assert lift.held
    elsewhere = replace(lift.bench.hand.state, base_T_grasp=lift.plan.base_T_grasp.translated(x_m=0.1))
    make_ready(restarted(lift, elsewhere), person := Person())
    assert len(person.asked) == 2
    assert "Hold any object between the fingers" in person.asked[0]


def test_open_fingers_override_a_recorded_object(lift_of: LiftOf) -> None:
    lift, person = lift_of(), Person(agrees=False)
    place = lift.plan.base_T_grasp
    for known in (
        HandState(Holding.UNKNOWN, "no record"),
        HandState(Holding.HELD, "wrench", place, 0.012),
        HandState(Holding.AROUND, "wrench", place, 0.012),  # it was on its way, and is far above
    ):
        bench = restarted(lift, known)
        free_hand(bench, person)
        assert bench.hand.state.holding is Holding.FREE
    assert person.asked == []


def test_gripper_reporting_an_object_overrides_the_record(lift_of: LiftOf) -> None:
    lift, person = lift_of(), Person(agrees=False)
    lift.bench.arm.move_linear(lift.plan.base_T_grasp, 0.25, 1.0).wait(5.0)
    lift.bench.gripper.move_to(lift.bench.gripper.spec.closed_m).wait(10.0)  # closes until it stalls at 15 N
    assert lift.bench.gripper.state().gripping
    with pytest.raises(OperatorStopError):
        free_hand(restarted(lift, HandState(Holding.FREE)), person)
    assert lift.held


@pytest.mark.heavy
def test_open_fingers_of_an_inactive_gripper_do_not_free_the_hand(lift_of: LiftOf) -> None:
    lift = left_in_the_air(lift_of)
    known = lift.bench.hand.state

    class PowerLost(type(lift.bench.gripper)):
        def state(self) -> GripperState:
            return GripperState(lift.bench.clock.now_ns(), False, False, self.spec.open_m)

    lift.bench.gripper.__class__ = PowerLost
    assert check_hand(lift.bench) == known


@pytest.mark.heavy
@pytest.mark.parametrize("mode", ["wide", "pinch", "scissor"])
def test_other_grasp_mode_is_left_by_an_activation_that_a_person_agrees_to(
    lift_of: LiftOf, mode: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lift = lift_of()
    asked: list[str] = []
    lift.bench.gripper.mode = mode
    lift.trace.clear()
    with pytest.raises(OperatorStopError):
        make_ready(lift.bench, ConsoleOperator(lambda question: bool(asked.append(question)), agreed=False))
    assert f"in {mode} mode. Activate it now in basic mode?" in asked[0]
    assert lift.trace == []
    assert lift.bench.gripper.state().mode == mode
    make_ready(lift.bench, Person())
    assert f"in {mode} mode. Activate it now in basic mode?" in capsys.readouterr().err, "named with --yes"
    assert lift.bench.gripper.state().mode == "basic"


def test_fingers_closed_on_the_object_after_the_hand_has_risen_are_not_free(lift_of: LiftOf) -> None:
    lift = left_in_the_air(lift_of)
    low = lift.plan.base_T_grasp.translated(z_m=-0.1)
    bench = restarted(lift, HandState(Holding.AROUND, "wrench", low, lift.plan.width_m))
    assert not bench.gripper.state().gripping
    with pytest.raises(OperatorStopError):
        make_ready(bench, person := Person(agrees=False))
    assert "unknown whether the fingers hold something" in person.asked[0]
    assert lift.held
