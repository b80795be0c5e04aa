"""How a run ends that ends early: by what is known of the hand, not by habit.

    free      stop, and stay there
    around    stop, open the fingers, rise straight up
    held      stop, set the object down where it was taken, open, rise
    unknown   stop, hold on; who starts next is asked (`protocols.readiness`)

A second interruption ends that as well: everything stops at once and stays.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from drivers.bench import Bench
from drivers.errors import DeviceError, OperatorStopError, ProtectiveStopError
from drivers.types import HandState, Holding, Pose
from protocols.steps import lower_and_release, open_and_rise

BESIDE_M = 0.005
TURNED_RAD = 0.05
"""A hand this far from above the place where it closed may not go straight down to it."""
REACH_M = 0.06
"""Higher above a grasp than this the fingers are around nothing: no object is that high over its middle."""


@contextmanager
def safe_end(bench: Bench) -> Iterator[None]:
    """End whatever goes wrong inside by `make_safe`; the error goes on, with a note on how it ended."""
    try:
        yield
    except BaseException as error:
        error.add_note(make_safe(bench))
        raise


def make_safe(bench: Bench) -> str:
    """End whatever was going on, as what is known of the hand demands. Returns what was reached.

    Where the arm or the gripper refuse, the grip stays closed: holding is safer than dropping.
    """
    try:
        bench.arm.stop()
        return _end(bench, bench.hand.state)
    except ProtectiveStopError:
        return f"arm in protective stop, fingers left as they are, {_in_hand(bench)}"
    except DeviceError as error:
        with suppress(DeviceError):  # they may be on their way, and nobody can see where they are
            bench.gripper.stop()
        return f"stopped, fingers left as they are, {_in_hand(bench)} ({error})"
    except OperatorStopError:
        return halt(bench)
    except BaseException:
        halt(bench)
        raise


def halt(bench: Bench) -> str:
    """Stop all motion at once, and stay. Returns what was reached."""
    try:
        bench.arm.stop()
    finally:  # also where a driver's stop fails, which none of the rig's does
        with suppress(DeviceError):
            bench.gripper.stop()
    return f"all motion stopped at once, {_in_hand(bench)}"


def is_above(pose: Pose, base_T_grasp: Pose) -> bool:  # noqa: N803
    """Whether the TCP stands straight above a grasp, turned as it was there."""
    (x, y, z), (grasp_x, grasp_y, grasp_z) = pose.position_m, base_T_grasp.position_m
    turn = float((pose.rotation.inv() * base_T_grasp.rotation).magnitude())
    beside = math.hypot(x - grasp_x, y - grasp_y)
    return beside <= BESIDE_M and turn <= TURNED_RAD and z >= grasp_z - BESIDE_M


def is_around(pose: Pose, hand: HandState) -> bool:
    """Whether open fingers that came down around something have come so far, or are not up again yet."""
    place = hand.base_T_grasp
    return place is None or pose.position_m[2] - place.position_m[2] <= REACH_M


def _end(bench: Bench, hand: HandState) -> str:
    if hand.holding is Holding.AROUND and not is_around(bench.arm.state().base_T_tcp, hand):
        hand = HandState(Holding.FREE)
        bench.hand.note(hand)
    if hand.holding is Holding.FREE:
        with suppress(DeviceError):  # nothing depends on where free fingers stand
            bench.gripper.stop()
        return "stopped where it was, nothing held"
    if hand.holding is Holding.UNKNOWN or hand.base_T_grasp is None:
        return f"stopped where it was, {_in_hand(bench)}"
    bench.gripper.state()  # a gripper that says nothing may hold anything, and cannot let go of it
    if hand.holding is Holding.AROUND:
        open_and_rise(bench, hand.base_T_grasp, hand.width_m)
        return "nothing held, fingers open, arm risen"
    if not is_above(bench.arm.state().base_T_tcp, hand.base_T_grasp):
        return f"stopped where it was, {_in_hand(bench)}: not above the place it was taken from"
    lower_and_release(bench, hand.base_T_grasp, hand.width_m)
    return "object set down, fingers open, arm retreated"


def _in_hand(bench: Bench) -> str:
    """What is in the hand, as far as it is known."""
    return {
        Holding.FREE: "nothing held",
        Holding.AROUND: f"fingers around {bench.hand.state.what}",
        Holding.HELD: f"still holding {bench.hand.state.what}",
        Holding.UNKNOWN: "what the fingers hold is not known",
    }[bench.hand.state.holding]
