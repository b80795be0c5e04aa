"""Reactions to slips that a script reports, on a simulated bench."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.errors import DeviceError
from drivers.types import Holding
from protocols.observer import Phase, ReactionStep
from protocols.reaction import MOST_REACTIONS, Reaction, ReactionKind
from protocols.slip_trial import run_lift

FIRST_CLOSING_STEPS = 6
LiftOf = Callable[..., Any]
STEP = ReactionStep


@dataclass
class Script:
    """Reports slips at given heights of the lift, and rest after a number of closings."""

    lift: Any
    at_m: list[float]
    closings: int = 1
    steps: list[tuple[ReactionStep, int, int]] = field(default_factory=list)
    heights_m: list[float] = field(default_factory=list)
    closed: int = 0
    reached_m: float = 0.0
    too_much: bool = False

    def slip_ns(self) -> int | None:
        rising = self.lift.observer.phase_now in (Phase.LIFT, Phase.HOLD)
        self.reached_m = max(self.reached_m, self.lift.height_m if rising else 0.0)
        return 1 if rising and self.at_m and self.lift.height_m >= self.at_m[0] else None

    def at_rest(self) -> bool:
        return self.closed >= self.closings

    def another_is_too_much(self) -> bool:
        return self.too_much

    def reaction(self, step: ReactionStep, time_ns: int, position: int) -> None:
        self.steps.append((step, time_ns, position))
        self.heights_m.append(self.lift.height_m)
        self.closed += step is STEP.CLOSED
        if step in (STEP.REST, STEP.ENDS):
            self.at_m.pop(0)
            self.closed = 0

    @property
    def order(self) -> list[ReactionStep]:
        return [step for step, _, _ in self.steps]

    def positions(self, step: ReactionStep) -> list[int]:
        return [position for s, _, position in self.steps if s is step]


def reacted(
    lift: Any, script: Script, kind: ReactionKind = ReactionKind.TIGHTEN, largest: int = 40
) -> Script:
    lift.observer.reaction = script.reaction
    run_lift(lift.bench, lift.plan, lift.observer, Reaction(kind, script, largest))
    assert lift.bench.hand.state.holding is Holding.FREE
    return script


def reached_all(script: Script) -> bool:
    return script.reached_m == pytest.approx(script.lift.plan.lift_height_m, abs=1e-6)


@pytest.mark.heavy
def test_without_reaction_a_slip_changes_nothing(lift_of: LiftOf) -> None:
    lift = lift_of()
    assert reacted(lift, Script(lift, [0.01]), ReactionKind.NONE).steps == []


@pytest.mark.heavy
def test_tighten_stops_the_arm_while_closing_and_then_completes_the_lift(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = reacted(lift, Script(lift, [0.010]))
    assert script.order == [STEP.STOP, STEP.STANDS, STEP.CLOSE, STEP.CLOSED, STEP.REST]
    assert script.heights_m[0] == pytest.approx(0.010, abs=0.002)
    assert script.heights_m[1] - script.heights_m[0] < 0.001
    assert max(script.heights_m[1:]) == min(script.heights_m[1:])
    assert script.positions(STEP.REST)[0] - script.positions(STEP.STOP)[0] == FIRST_CLOSING_STEPS
    assert reached_all(script)


def test_each_closing_is_twice_the_previous_one_up_to_the_largest_grip(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = reacted(lift, Script(lift, [0.005, 0.010], closings=2), largest=200)
    before = script.positions(STEP.STOP)[0]
    assert [c - before for c in script.positions(STEP.CLOSED)] == [6, 18, 42, 70]  # the closed end
    lift = lift_of()
    script = reacted(lift, Script(lift, [0.005, 0.010, 0.015]), largest=lift.plan.grip_steps + 10)
    assert max(position for _, _, position in script.steps) == script.positions(STEP.STOP)[0] + 10
    assert script.order[-1] is STEP.REST
    assert reached_all(script)


@pytest.mark.heavy
def test_slip_at_the_largest_grip_ends_the_lift_if_another_would_exceed_the_limit(lift_of: LiftOf) -> None:
    lift = lift_of()
    slips = Script(lift, [0.006, 0.010, 0.014], too_much=True)
    script = reacted(lift, slips, largest=lift.plan.grip_steps + FIRST_CLOSING_STEPS)
    assert script.order[-3:] == [STEP.STOP, STEP.STANDS, STEP.ENDS]
    assert len(script.positions(STEP.STOP)) == 2
    assert script.reached_m < 0.012 < lift.plan.lift_height_m


@pytest.mark.heavy
def test_lift_continues_if_a_slip_at_the_largest_grip_ends(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = reacted(lift, Script(lift, [0.010], closings=0), largest=lift.plan.grip_steps)
    assert script.order == [STEP.STOP, STEP.STANDS, STEP.REST]
    assert reached_all(script)


@pytest.mark.heavy
def test_lift_ends_after_too_many_slips(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = reacted(lift, Script(lift, [0.004] * 20, closings=0), largest=250)
    assert len(script.positions(STEP.STOP)) <= MOST_REACTIONS
    assert script.order[-1] is STEP.ENDS
    assert script.reached_m < 0.01


@pytest.mark.heavy
def test_stop_and_lower_end_the_lift_with_the_grip_as_it_is_and_lower_sets_down_sooner(
    lift_of: LiftOf,
) -> None:
    held_s = []
    for kind in (ReactionKind.STOP, ReactionKind.LOWER):
        lift = lift_of()
        script = reacted(lift, Script(lift, [0.010, 0.010]), kind)
        assert script.order == [STEP.STOP, STEP.STANDS, STEP.ENDS]
        assert len({position for _, _, position in script.steps}) == 1
        assert script.reached_m < 0.012
        held_s.append((lift.bench.clock.now_ns() - script.steps[-1][1]) / 1e9)
    assert held_s[1] < held_s[0] - 0.5


@pytest.mark.heavy
def test_slip_in_the_hold_phase_causes_a_reaction(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = reacted(lift, Script(lift, [lift.plan.lift_height_m]))
    assert script.order[-1] is STEP.REST
    assert lift.height_m > 0.05  # risen beside it, after it was set down


def test_fault_in_a_reaction_ends_like_any_other_fault(lift_of: LiftOf) -> None:
    lift = lift_of()
    script = Script(lift, [0.010])
    lift.interrupt(lambda: bool(script.positions(STEP.CLOSE)), DeviceError("arm: gone"))
    with pytest.raises(DeviceError, match="gone") as raised:
        reacted(lift, script)
    assert "set down" in raised.value.__notes__[0]
