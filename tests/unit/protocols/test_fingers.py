"""Finger motions are verified: if the gripper disobeys, the arm does not move."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import pytest

from drivers.errors import FingerMotionError, OperatorStopError
from drivers.types import GripperState, HandState, Holding
from protocols.grasps import find_grasp_file
from protocols.observer import Phase
from protocols.readiness import make_ready
from protocols.slip_trial import run_lift
from protocols.steps import STILL_STEPS, move_fingers, tolerance_m
from rig.bench.operators import ConsoleOperator
from support.finger_counts import opening_m
from support.marks import heavy

LiftOf = Callable[..., Any]
MOTIONLESS = ("blocked", "stuck", "false_success")
SEEN = ("blocked", "stuck", "overshoot")
"""Faults that are visible in the reported positions."""
QUICK = (
    (Phase.GRASP, "false_success"),
    (Phase.LOWER, "false_success"),
    *((Phase.HOLD, kind) for kind in SEEN),
)
SET_DOWN_M = 0.001
"""An object lower than this above its place is on its support."""


def break_in(lift: Any, phase: Phase | None, kind: str) -> None:
    """Switch a fault on when a phase begins; before the lift if there is no phase."""
    if phase is None:
        lift.break_gripper(kind)
        return
    begin = lift.observer.phase

    def begin_and_break(now: Phase, time_ns: int) -> None:
        begin(now, time_ns)
        if now is phase:
            lift.break_gripper(kind)

    lift.observer.phase = begin_and_break


def was_carried(lift: Any) -> bool:
    """Whether the arm rose with the object after it had set the object down."""
    place = lift.plan.base_T_grasp.position_m[2]
    heights = [z - place for _, z, _, held in lift.trace if held]
    top = max(range(len(heights)), key=heights.__getitem__, default=0)
    down = next((i for i in range(top, len(heights)) if heights[i] < SET_DOWN_M), len(heights))
    return any(height > 2 * SET_DOWN_M for height in heights[down:])


def was_dropped(lift: Any) -> bool:
    """Whether the fingers lost the object above its place."""
    place = lift.plan.base_T_grasp.position_m[2]
    return any(
        held and not still_held and z - place > 2 * SET_DOWN_M
        for (_, z, _, held), (*_, still_held) in pairwise(lift.trace)
    )


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("phase", "kind"),
    [
        *QUICK,
        *heavy(*(case for case in product((None, *Phase), (*SEEN, "false_success")) if case not in QUICK)),
    ],
)
def test_arm_never_carries_object_when_gripper_disobeys(
    lift_of: LiftOf, phase: Phase | None, kind: str
) -> None:
    lift = lift_of()
    break_in(lift, phase, kind)
    assert lift.run() != "done"
    assert not was_carried(lift)
    held, pose, counts = lift.held, lift.pose, lift.counts
    asked: list[str] = []
    # with --yes and without a terminal: it agrees beforehand, and cannot inspect the bench
    operator = ConsoleOperator(lambda question: bool(asked.append(question)), agreed=True)
    if (phase, kind) == (Phase.HOLD, "overshoot"):
        assert lift.bench.hand.state.holding is Holding.UNKNOWN
        assert "too far" in lift.bench.hand.state.what
    if held:
        assert lift.bench.hand.state.holding in (Holding.HELD, Holding.UNKNOWN)
        with pytest.raises(OperatorStopError):
            make_ready(lift.bench, operator)
        assert asked
        assert (lift.pose, lift.counts, lift.held) == (pose, counts, True)


@pytest.mark.heavy
@pytest.mark.parametrize("kind", MOTIONLESS)
@pytest.mark.parametrize("phase", [Phase.LIFT, *heavy(Phase.HOLD, Phase.LOWER)])
def test_failed_release_leaves_arm_at_the_place_with_the_object_held(
    lift_of: LiftOf, phase: Phase, kind: str
) -> None:
    lift = lift_of()
    break_in(lift, phase, kind)
    note = lift.run()
    assert lift.held
    assert lift.height_m == pytest.approx(0.0, abs=1e-4)
    expected = Holding.UNKNOWN if kind == "false_success" else Holding.HELD
    assert lift.bench.hand.state.holding is expected
    assert "still holding" in note or "unknown whether" in note
    if expected is Holding.HELD:
        with pytest.raises(FingerMotionError, match="instead of"):
            make_ready(lift.bench, ConsoleOperator(lambda _: True))
        assert (lift.height_m, lift.held) == (pytest.approx(0.0, abs=1e-4), True), "agreed to, and it failed"
        assert lift.bench.hand.state.holding is Holding.HELD


@pytest.mark.parametrize("real_counts", [0, 1, 2])
def test_falsely_reported_grip_is_not_lifted(lift_of: LiftOf, real_counts: int) -> None:
    """The fault begins at the first contact, or after one or two of the three counts of tightening."""
    lift = lift_of()
    assert lift.plan.grip_steps == 3
    contact_counts: list[int] = []

    def break_if_due(_: object = None) -> None:
        if not contact_counts and lift.bench.hand.state.holding is Holding.HELD:
            contact_counts.append(lift.counts)
        if contact_counts and lift.counts >= contact_counts[0] + real_counts:
            lift.break_gripper("false_success")

    note = lift.bench.hand.note
    lift.bench.hand.note = lambda state: (note(state), break_if_due())
    lift.observer.gripper = break_if_due
    with pytest.raises(FingerMotionError, match=r"0\.6 mm before"):
        run_lift(lift.bench, lift.plan, lift.observer)
    assert lift.height_m == pytest.approx(0.0, abs=1e-4)


@pytest.mark.heavy
@pytest.mark.parametrize("kind", MOTIONLESS)
def test_fingers_that_do_not_open_to_the_grasp_keep_the_hand_up(lift_of: LiftOf, kind: str) -> None:
    lift = lift_of()
    move_fingers(lift.bench, opening_m(lift.bench.gripper, 200))
    lift.break_gripper(kind)
    lift.run()
    if kind != "false_success":  # undetectable without contact: the guard against contact force remains
        assert min(z for _, z, _, _ in lift.trace) > lift.plan.base_T_grasp.position_m[2] + 0.05
        assert lift.bench.hand.state.holding is Holding.UNKNOWN


@pytest.mark.heavy
def test_operator_is_asked_again_after_the_fingers_opened(lift_of: LiftOf) -> None:
    lift = lift_of()
    break_in(lift, Phase.HOLD, "false_success")
    lift.run()
    answers = iter((True, False))
    asked: list[str] = []
    operator = ConsoleOperator(lambda question: asked.append(question) or next(answers))
    pose = lift.pose
    with pytest.raises(OperatorStopError):
        make_ready(lift.bench, operator)
    assert "Is the hand empty" in asked[1]
    assert (lift.pose, lift.held) == (pose, True)


def test_failed_opening_of_a_free_hand_makes_it_unknown(lift_of: LiftOf) -> None:
    lift = lift_of()
    spec = lift.bench.gripper.spec
    assert tolerance_m(spec) // spec.resolution_m == 3
    assert tolerance_m(replace(spec, resolution_m=0.004)) == 0.004
    move_fingers(lift.bench, opening_m(lift.bench.gripper, 100))
    lift.bench.hand.note(HandState(Holding.FREE))
    lift.break_gripper("stuck")
    with pytest.raises(FingerMotionError, match=r"stopped at 61\.5 instead of 92\.6 mm .*2\.0 mm"):
        move_fingers(lift.bench, opening_m(lift.bench.gripper, 50))
    assert lift.bench.hand.state.holding is Holding.UNKNOWN


@pytest.mark.heavy
@pytest.mark.parametrize("step_m", [0.001, pytest.param(0.0002, marks=pytest.mark.heavy)])
def test_grips_in_mm_do_not_depend_on_the_gripper_resolution(lift_of: LiftOf, step_m: float) -> None:
    """The wrench's object file has grips of 1.9 to 3.7 mm; this gripper closes in other steps."""
    lift = lift_of(step_m=step_m)
    least_m, most_m = find_grasp_file("t1").grip_m
    assert least_m - step_m <= lift.plan.grip_steps * step_m <= most_m + step_m
    openings_m: list[float] = []
    lift.observer.gripper = lambda state: openings_m.append(state.opening_m)
    assert lift.run() == "done"
    closings_m = [before - after for before, after in pairwise(openings_m) if after < before]
    assert closings_m == pytest.approx([step_m] * len(closings_m))
    assert lift.plan.width_m - min(openings_m) == pytest.approx(lift.plan.grip_steps * step_m, abs=0.002)


@pytest.mark.heavy
@pytest.mark.parametrize("phase", [Phase.LIFT, Phase.HOLD])
def test_fingers_that_drift_open_without_a_command_end_the_lift(lift_of: LiftOf, phase: Phase) -> None:
    lift = lift_of()
    break_in(lift, phase, "drift")
    with pytest.raises(FingerMotionError, match=r"opened to .* mm without a command, and its driver closed"):
        run_lift(lift.bench, lift.plan, lift.observer)
    assert not was_dropped(lift), "the fingers close again before they have lost the object"
    assert not was_carried(lift)
    counts = [counts for *_, counts, held in lift.trace if held]
    gripped = counts[counts.index(max(counts)) :]
    opened = next(i for i, at in enumerate(gripped) if at < max(counts) - STILL_STEPS)
    assert max(gripped[opened:]) == max(counts), "the agreed grip"


@pytest.mark.heavy
@pytest.mark.parametrize("counts", [-4, -2, 2, 4, *heavy(-13, -1, 1, 13, 60)])
def test_change_of_the_opening_by_more_than_noise_ends_the_lift(lift_of: LiftOf, counts: int) -> None:
    """Fingers that are opened or closed by another client of the gripper, in the air."""
    lift = lift_of()
    begin, state = lift.observer.phase, lift.bench.gripper.state
    shift_m = [0.0]

    def begin_and_shift(now: Phase, time_ns: int) -> None:
        begin(now, time_ns)
        shift_m[0] = counts * lift.bench.gripper.spec.resolution_m if now is Phase.HOLD else 0.0

    lift.observer.phase = begin_and_shift
    lift.bench.gripper.state = lambda: replace(state(), opening_m=state().opening_m + shift_m[0])
    if abs(counts) > 2:
        with pytest.raises(FingerMotionError, match="without a command"):
            run_lift(lift.bench, lift.plan, lift.observer)
    else:
        assert lift.run() == "done"


def test_fingers_that_meet_something_before_the_descent_keep_the_arm_where_it_is(lift_of: LiftOf) -> None:
    lift = lift_of()
    spec, before = lift.bench.gripper.spec, lift.pose

    class Caught(type(lift.bench.gripper)):
        """Its fingers meet something that is 40 mm wide, such as a hand."""

        def state(self) -> GripperState:
            state = super().state()
            met = state.opening_m < 0.040
            return replace(state, opening_m=spec.nearest(0.040), gripping=True) if met else state

    lift.bench.gripper.__class__ = Caught
    lift.run()
    assert lift.pose == before
    assert lift.bench.hand.state.holding is Holding.UNKNOWN


@pytest.mark.parametrize(("speeds_m_s", "asked_m_s"), [((0.01, 0.03), 0.03), ((0.1, 0.2), 0.1)])
def test_fingers_move_at_the_limit_of_a_slower_or_faster_gripper(
    lift_of: LiftOf, speeds_m_s: tuple[float, float], asked_m_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = lift_of().bench
    move_to, asked = bench.gripper.move_to, []
    bench.gripper.spec = replace(bench.gripper.spec, speed_m_s=speeds_m_s)
    monkeypatch.setattr(
        bench.gripper, "move_to", lambda to_m, speed: asked.append(speed) or move_to(to_m, speed)
    )
    move_fingers(bench, opening_m(bench.gripper, 100))
    assert asked == [asked_m_s]
