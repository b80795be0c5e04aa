"""Prepare the bench before the first motion: check arm, hand and gripper, and ask a person if needed.

The state of the hand comes from the program that moved it last (`Bench.hand`, stored across crashes) and from
the gripper. Unless both report it free, a person at the bench is asked before fingers open or the arm moves.
"""

from contextlib import suppress
from dataclasses import replace

from drivers.bench import Bench
from drivers.errors import GripperFaultError
from drivers.types import BASIC_MODE, HandState, Holding
from protocols.operator import Operator
from protocols.safe_end import is_above, is_around, safe_end
from protocols.steps import CLEARANCE_M, LOWER_SPEED_M_S, MARGIN_M, go, go_home, move_fingers

OPEN_M = 0.002
"""Fingers closed by at most this from fully open, m, hold nothing: three steps of a Robotiq 3-Finger."""
CLOSED_M = 0.0015
"""If free fingers have closed by more than this since, m, another program or person closed them. It lies
between two and three steps of a Robotiq 3-Finger."""


def make_ready(bench: Bench, operator: Operator, after_fault: bool = False) -> None:
    """Release a protective stop, free the hand, activate the gripper in basic mode, go home: each if needed.

    After a fault, and if an object may be in the hand, a person at the bench is asked. Activation is asked
    for because the fingers sweep their range. The motion home is part of the agreed plan (`home_plan`).
    If it ends early, the arm stays where it is.
    """
    free_hand(bench, operator, after_fault)
    _activate(bench, operator)
    with safe_end(bench):
        go_home(bench)


def free_hand(bench: Bench, operator: Operator, after_fault: bool = False) -> None:
    """Make sure that the arm can move and the hand is free; if not, ask, then set down or open, and rise.

    Raises `OperatorStopError` unless a person agrees, with nothing moved.
    """
    bench.arm.recover(operator.look)
    hand = check_hand(bench)
    if hand.holding is not Holding.FREE:
        _free(bench, operator, hand, "The last lift ended in a fault. " if after_fault else "")
    elif after_fault:
        operator.look("The last lift ended in a fault; nothing is held. Look at the bench: shall it go on?")
    opening_m = None
    with suppress(GripperFaultError):
        opening_m = bench.gripper.state().opening_m
    bench.hand.note(HandState(Holding.FREE, finger_opening_m=opening_m))


def agree_to_carry(bench: Bench, operator: Operator) -> None:
    """Unless the hand is free, ask before the arm moves with the fingers left as they are.

    Raises `OperatorStopError` unless a person agrees.
    """
    bench.arm.recover(operator.look)
    hand = check_hand(bench)
    if hand.holding is not Holding.FREE:
        operator.look(f"{_describe(hand)} The arm will move with it, the fingers stay as they are. Shall it?")


def check_hand(bench: Bench) -> HandState:
    """Return the known state of the hand, corrected by the gripper's state: open fingers hold nothing.

    If the hand was free, or has risen from around an object, but its fingers have closed or met an object
    since, its state is unknown.
    """
    known = bench.hand.state
    try:
        gripper = bench.gripper.state()
    except GripperFaultError:
        return known
    opening_m, open_m = gripper.opening_m, bench.gripper.spec.open_m
    if known.holding is Holding.AROUND and not is_around(bench.arm.state().base_T_tcp, known):
        # it rose with its fingers as wide as on the way down, unless they were closed on the object since
        around_m = min(known.width_m + 2 * MARGIN_M, open_m)
        known = HandState(Holding.FREE, finger_opening_m=around_m)
    if known.holding is Holding.FREE:
        closed = known.finger_opening_m is not None and opening_m < known.finger_opening_m - CLOSED_M
        if gripper.gripping or closed:
            return HandState(Holding.UNKNOWN, f"the fingers were closed to {1e3 * opening_m:.1f} mm since")
    elif known.holding is not Holding.AROUND and not gripper.gripping and opening_m >= open_m - OPEN_M:
        # A gripper that lost its power may report wrong positions, so it must be activated or never have
        # held.
        if gripper.activated or known.base_T_grasp is None:
            return HandState(Holding.FREE)
    return known


def _free(bench: Bench, operator: Operator, hand: HandState, why: str) -> None:
    """Ask, set the object down if the hand is above its place, open the fingers, ask again, and rise.

    The second question covers what no device can verify: a gripper may report open fingers that are closed.
    Raises `OperatorStopError`, and `FingerMotionError` if the fingers do not open, before the arm rises.
    """
    place = hand.base_T_grasp if hand.holding is Holding.HELD else None
    if place is not None and not is_above(bench.arm.state().base_T_tcp, place):
        place = None
    question = "Hold any object between the fingers: shall they open now, and the arm rise?"
    if place is not None:
        question = "Shall it be set down where it was taken, the fingers open and the arm rise?"
    operator.look(f"{why}{_describe(hand)} {question}")
    bench.hand.note(hand)
    if place is not None:
        go(bench, place, LOWER_SPEED_M_S)
    _activate(bench, operator)
    opening_mm = 1e3 * move_fingers(bench, bench.gripper.spec.open_m).opening_m
    operator.look(f"The fingers have opened to {opening_mm:.1f} mm. Is the hand empty, and may the arm rise?")
    operator.note_displaced("the hand was emptied")
    bench.hand.note(replace(hand, holding=Holding.AROUND))
    pose = bench.arm.state().base_T_tcp
    rise_m = bench.base_T_table.position_m[2] + CLEARANCE_M - pose.position_m[2]
    if rise_m > 0.0:
        go(bench, pose.translated(z_m=rise_m), LOWER_SPEED_M_S)


def _describe(hand: HandState) -> str:
    what = hand.what or "something"
    return {
        Holding.FREE: "Nothing is held.",
        Holding.AROUND: f"The fingers stand around {what}.",
        Holding.HELD: f"The hand holds {what}.",
        Holding.UNKNOWN: f"It is unknown whether the fingers hold something ({hand.what}).",
    }[hand.holding]


def _activate(bench: Bench, operator: Operator) -> None:
    try:
        state = bench.gripper.state()
        if state.activated and state.mode == BASIC_MODE:
            return
        what = "not activated. Activate it now?"
        if state.activated:
            what = f"in {state.mode} mode. Activate it now in {BASIC_MODE} mode?"
        operator.confirm(f"The gripper is {what} Its fingers sweep their range.")
    except GripperFaultError as error:
        operator.look(f"{error}. Activate it now? Its fingers sweep their range and drop any object.")
    bench.gripper.activate()
