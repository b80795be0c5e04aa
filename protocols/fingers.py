"""Finger motions whose result is verified before anything else moves.

If a gripper is blocked, reports success without moving, or moves too far, the arm must not move with an
object in the fingers. So every finger motion ends with a comparison of the reached position with the
requested one, and every release with a check of the tactile images.
"""

from contextlib import suppress
from dataclasses import replace

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceError, FingerMotionError
from drivers.interfaces import Motion
from drivers.types import GripperSpec, GripperState, Holding
from protocols.pump import Pump

MOTION_TIMEOUT_S = 15.0
"""Time limit of a motion of arm or fingers."""
REACHED_M = 0.002
"""Tolerance of a reached opening, m: a third of the 6 mm by which a release opens wider than the object
(2 x `steps.MARGIN_M`), so fingers within this tolerance do not touch the object. Three steps of a Robotiq
3-Finger."""
STILL_M, STILL_STEPS = 0.001, 2
"""Largest change of the opening of fingers that stand still, due to noise of the reading: in m and in steps
of the gripper; the larger one counts. If fingers that open are stopped there, a grip of 1.9 mm (that of a
wrench) still holds."""
_ROUNDING_M = 1e-9
"""Rounding error of an opening, far below any gripper's resolution."""
RELEASE_S = 1.0
"""Longest time from an opening until the imprint of the contact must be gone: a gel recovers slowly."""


def wait_with(pump: Pump | None, motion: Motion, mover: str) -> None:
    """Wait for the end of a motion, while frames are delivered if there is a pump.

    mover: "the arm" or "the fingers". Raises `DeviceTimeoutError` after `MOTION_TIMEOUT_S`.
    """
    if pump is None:
        motion.wait(MOTION_TIMEOUT_S)
    else:
        pump.run_until(motion.done, MOTION_TIMEOUT_S, f"{mover} did not end the motion")


def move_fingers(bench: Bench, opening_m: float, pump: Pump | None = None) -> GripperState:
    """Move the fingers and verify that they arrived; return the gripper's state at the end.

    opening_m: distance between the fingertips. pump: delivers frames during the motion. Closing fingers may
    stop early at an object that resists with the gripper's force (`GripperState.gripping`). For any other
    position outside `REACHED_M`, the gripper is stopped and `FingerMotionError` is raised: a Robotiq gripper
    whose finger met an obstacle ignores further commands in the same direction until rGTO is cleared (manual,
    OBJECT STATUS). If the hand held an object and its fingers opened less than requested, it counts as still
    holding it. After any other failed opening its state becomes unknown. Afterwards the pump compares the
    opening with the reached one, until the next motion.
    """
    opens = opening_m > bench.gripper.state().opening_m
    if pump is not None:
        pump.expect_fingers(None)
    wait_with(pump, bench.gripper.move_to(opening_m), "the fingers")
    reached = bench.gripper.state()
    problem = _problem(reached, opening_m, opens, bench.gripper.spec)
    if problem is None:
        if pump is not None:  # fingers that stopped at an object close further if it gives way
            slack_m = max(STILL_M, STILL_STEPS * bench.gripper.spec.resolution_m) + _ROUNDING_M
            low_m, high_m = sorted((reached.opening_m, opening_m))
            pump.expect_fingers((low_m - slack_m, high_m + slack_m))
        return reached
    with suppress(DeviceError):  # the error below is more informative
        bench.gripper.stop()
    fell_short = opens and reached.opening_m < opening_m
    if opens and not (fell_short and bench.hand.state.holding is Holding.HELD):
        doubt_hand(bench, f"the fingers {problem}")
    raise FingerMotionError(
        f"gripper: the fingers {problem} (tolerance {1e3 * tolerance_m(bench.gripper.spec):.1f} mm): they "
        "are blocked, or the gripper does not execute its commands; the arm stays where it is. Check what "
        "is between the fingers and around them, then start again"
    )


def release(bench: Bench, opening_m: float, pump: Pump) -> GripperState:
    """Open the fingers as `move_fingers` does, and wait until no fingertip shows the contact any more.

    Raises `FingerMotionError` after `RELEASE_S`; the state of the hand is then unknown, because the object
    may stick to a fingertip, or the gripper may report a position that its fingers do not have.
    """
    contacts = pump.contacts()
    reached = move_fingers(bench, opening_m, pump)
    end_ns = bench.clock.now_ns() + to_ns(RELEASE_S)
    pump.run_until(
        lambda: not pump.still_shown(contacts) or bench.clock.now_ns() >= end_ns,
        MOTION_TIMEOUT_S,
        "the frames after the release were not processed",
    )
    if touched := pump.still_shown(contacts):
        where = f"{' and '.join(touched)} still in contact after the fingers opened"
        doubt_hand(bench, where)
        raise FingerMotionError(
            f"gripper: {where}: the object may stick to a finger, or the fingers did not open; the arm stays "
            "where it is. Check what the fingers hold, free it, then start again"
        )
    return reached


def doubt_hand(bench: Bench, why: str) -> None:
    """Set the hand's state to unknown, and keep the pose at which it last closed."""
    bench.hand.note(replace(bench.hand.state, holding=Holding.UNKNOWN, what=why))


def tolerance_m(spec: GripperSpec) -> float:
    """Return the tolerance of a reached opening, m: `REACHED_M`, at least one step of this gripper."""
    return max(REACHED_M, spec.resolution_m)


def _problem(state: GripperState, opening_m: float, opens: bool, spec: GripperSpec) -> str | None:
    """Describe how the fingers missed their target; None if they reached it."""
    off_m = state.opening_m - opening_m
    if abs(off_m) > tolerance_m(spec) + _ROUNDING_M:
        short = (off_m < 0) == opens
        if short and not opens and state.gripping:
            return None
        what = "stopped at" if short else "went too far, to"
        return f"{what} {1e3 * state.opening_m:.1f} instead of {1e3 * opening_m:.1f} mm"
    if opens and state.obstructed:
        return f"met an obstacle while opening to {1e3 * opening_m:.1f} mm"
    return None
