"""End a run early in the way that the known state of the hand requires.

    free      stop, and stay there
    around    stop, open the fingers, rise straight up
    held      stop, set the object down where it was taken, open, rise
    unknown   stop, keep the grip; the next program asks a person (`protocols.readiness`)

A second interrupt ends that as well: everything stops immediately and stays.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from drivers.bench import Bench
from drivers.errors import DeviceError, OperatorStopError, ProtectiveStopError, without_values
from drivers.types import HandState, Holding, Pose
from protocols.steps import lower_and_release, open_and_rise

BESIDE_M = 0.005
TURNED_RAD = 0.05
"""A hand that is further away from above its grasp must not move straight down to it."""
REACH_M = 0.06
"""Height above a grasp beyond which the fingers surround nothing: no object is that high above its grasp."""


@contextmanager
def safe_end(bench: Bench) -> Iterator[None]:
    """On any exception inside, call `make_safe`; then re-raise the exception with a note on how it ended."""
    try:
        yield
    except BaseException as error:
        error.add_note(make_safe(bench, str(error)))
        raise


def make_safe(bench: Bench, cause: str = "") -> str:
    """Stop, and end as the known state of the hand requires. Return a description of the result.

    If the arm or the gripper fails, the grip stays closed: holding is safer than dropping. cause: the message
    of the error before, which is not repeated in the description.
    """
    try:
        bench.arm.stop()
        return _end(bench, bench.hand.state)
    except ProtectiveStopError:
        return f"arm in protective stop, fingers left as they are, {_in_hand(bench)}"
    except DeviceError as error:
        with suppress(DeviceError):  # the fingers may be moving, and their position is unknown
            bench.gripper.stop()
        same = without_values(str(error)) == without_values(cause)
        why = "" if same else f" ({error})"
        return f"stopped, fingers left as they are, {_in_hand(bench)}{why}"
    except OperatorStopError:
        return halt(bench)
    except BaseException:
        halt(bench)
        raise


def halt(bench: Bench) -> str:
    """Stop all motion immediately, and stay. Return a description of the result."""
    try:
        bench.arm.stop()
    finally:  # also if a driver's stop raises; the rig's own drivers never do
        with suppress(DeviceError):
            bench.gripper.stop()
    return f"all motion stopped at once, {_in_hand(bench)}"


def is_above(pose: Pose, base_T_grasp: Pose) -> bool:  # noqa: N803
    """Whether the TCP is straight above a grasp, with the same orientation."""
    above_m = pose.position_m[2] - base_T_grasp.position_m[2]
    beside = pose.translated(z_m=-above_m)
    return above_m >= -BESIDE_M and beside.is_near(base_T_grasp, BESIDE_M, TURNED_RAD)


def is_around(pose: Pose, hand: HandState) -> bool:
    """Whether open fingers surround the object: they have come down, and have not risen above it again."""
    place = hand.base_T_grasp
    return place is None or pose.position_m[2] - place.position_m[2] <= REACH_M


def _end(bench: Bench, hand: HandState) -> str:
    if hand.holding is Holding.AROUND and not is_around(bench.arm.state().base_T_tcp, hand):
        hand = HandState(Holding.FREE)
        bench.hand.note(hand)
    if hand.holding is Holding.FREE:
        with suppress(DeviceError):  # the position of free fingers does not matter
            bench.gripper.stop()
        return "stopped where it was, nothing held"
    if hand.holding is Holding.UNKNOWN or hand.base_T_grasp is None:
        return f"stopped where it was, {_in_hand(bench)}"
    bench.gripper.state()  # a gripper that does not answer may hold an object, and cannot release it
    if hand.holding is Holding.AROUND:
        open_and_rise(bench, hand.base_T_grasp, hand.width_m)
        return "nothing held, fingers open, arm risen"
    if not is_above(bench.arm.state().base_T_tcp, hand.base_T_grasp):
        return f"stopped where it was, {_in_hand(bench)}: not above the place it was taken from"
    lower_and_release(bench, hand.base_T_grasp, hand.width_m)
    return "object set down, fingers open, arm retreated"


def _in_hand(bench: Bench) -> str:
    """Describe what is in the hand, as far as it is known."""
    return {
        Holding.FREE: "nothing held",
        Holding.AROUND: f"fingers around {bench.hand.state.what}",
        Holding.HELD: f"still holding {bench.hand.state.what}",
        Holding.UNKNOWN: "it is unknown whether the fingers hold something",
    }[bench.hand.state.holding]
