"""The steps of the experiments, each a few driver calls.

Downward motions stop at contact: force and gripper are monitored. The constructors of the states reject NaN
and other invalid values (`drivers.types`), and their error stops the motion; so no comparison here is false
because of NaN.

If a gripper is blocked, reports success without moving, or moves too far, the arm must not move with an
object in the fingers. So every finger motion ends with a comparison of the reached position with the
requested one, and every release with a check of the tactile images.
"""

from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import ContactForceError, DeviceError, FingerMotionError, GraspError, OutOfLimitsError
from drivers.motion import Motion, check_way
from drivers.types import ArmState, GripperSpec, GripperState, HandState, Holding, Pose
from protocols.observer import LiftObserver, Phase
from protocols.pump import Pump

TRAVEL_SPEED_M_S = 0.25
"""Speed of the arm without an object, and of the retreat after a release."""
LOWER_SPEED_M_S = 0.10
"""Speed of the arm that sets an object down, and at which a low hand rises."""
ACCELERATION_M_S2 = 1.0
"""Acceleration of the arm in all motions but the lift, whose acceleration follows from its duration."""
FINGER_SPEED_M_S = 100 * (0.155 / 249)
"""Speed at which fingers close and open; a slower or faster gripper moves at its own limit. In the middle of
the range of a Robotiq 3-Finger (22 to 110 mm/s): 100 counts per second, where 249 counts are 155 mm."""
CLEARANCE_M = 0.10
"""Height above the grasp from which the hand approaches, and to which it retreats."""
LEVEL_M = 0.001
"""A hand that is at most this much too low does not rise first."""
MARGIN_M = 0.003
"""Gap on each side between finger and object before the step-by-step closing begins."""
STEP_SETTLE_S = 0.05
"""Time for the gels to settle after a closing step."""
FIRMER = 1.02
"""Smallest ratio of `Pump.contact_strength` after the last step of tightening to before it. Measured in 36
simulated lifts that tighten by 2 to 6 steps of 0.62 mm, half of them on the hard bench: at least 1.046; 0.99
to 1.01 while the fingers do not move."""
FIRMER_STEP_M = 0.0006
"""End of the tightening over which that ratio is measured, m: one step of a Robotiq 3-Finger."""
FIRMER_PARTS = 2
"""Fewest such steps of tightening for which that ratio is required: the smallest that was measured."""
MOST_CLOSING_M = 0.015
"""Longest closing in search of the object, m, unless the caller asks for more."""
MOTION_TIMEOUT_S = 15.0
"""Time limit of a motion of arm or fingers, of the arm at full speed (`arm_limit_s`)."""
SLOWEST = 0.05
"""Lowest position of the arm's speed slider that lengthens the time limits of motions."""
REACHED_M = 0.002
"""Tolerance of a reached opening: three steps of a Robotiq 3-Finger. A release opens 6 mm wider than the
object (2 x `MARGIN_M`), so fingers within this tolerance do not touch it."""
STILL_M, STILL_STEPS = 0.001, 2
"""Largest change of the opening of fingers that stand still, m, but at least this number of steps:
noise of the reading. A grip of 1.9 mm (that of a wrench) still holds if opening fingers are stopped there."""
_ROUNDING_M = 1e-9
"""Rounding error of an opening, far below any gripper's resolution."""
RELEASE_S = 1.0
"""Longest time from an opening until the imprint of the contact must be gone: a gel recovers slowly."""
_THERE_M, _THERE_RAD = 1e-3, 5e-3
"""Largest distances from a pose at which the arm counts as being there."""


def move(
    bench: Bench,
    target: Pose,
    speed_m_s: float,
    before: ArmState | None = None,
    acceleration_m_s2: float = ACCELERATION_M_S2,
) -> Motion:
    """Start a straight motion; return it. Downward motions are guarded.

    before: state of the arm just now; it is read if it is not given.
    """
    before = before or bench.arm.state()
    motion = bench.arm.move_linear(target, speed_m_s, acceleration_m_s2)
    if target.position_m[2] >= before.base_T_tcp.position_m[2] - LEVEL_M:
        return motion
    return guard(bench, motion, before)


def guard(bench: Bench, motion: Motion, before: ArmState) -> Motion:
    """Return a motion of the arm that stops if the force changes by more than the arm's limit.

    An arm without a force sensor (no `max_contact_force_n`) is not stopped at contact; the plan states that.

    before: state of the arm when the motion began; its force includes the sensor's offset and the weight of
    an object in the fingers. `is_done` stops the arm and raises `ContactForceError`. It raises the error of a
    lost gripper, unless the hand holds an object: that is set down in any case.
    """
    limit_n = bench.arm.limits.max_contact_force_n

    def has_ended() -> bool:
        now = bench.arm.state()
        if limit_n is not None:
            change_n = float(np.linalg.norm(np.subtract(now.force_n, before.force_n)))
            if not change_n <= limit_n:
                bench.arm.stop()
                x, y, z = now.base_T_tcp.position_m
                raise ContactForceError(
                    f"arm: met an obstacle on its way down at ({x:.3f}, {y:.3f}, {z:.3f}) m: the force "
                    f"changed by {change_n:.0f} N (max_contact_force_n {limit_n:g}); it was stopped. Check "
                    "what is in the way, and that the table's and the object's heights in the bench file are "
                    "right"
                )
        if bench.hand.state.holding is not Holding.HELD:
            bench.gripper.state()
        return motion.is_done()

    return Motion("arm", bench.clock, has_ended, bench.arm.stop)


def arm_limit_s(full_speed_s: float, state: ArmState | None) -> float:
    """Return the time limit of a motion of the arm, from the limit at full speed and the arm's newest state.

    The speed slider on the pendant slows all motions. An arm that reports no slider moves at full speed.
    """
    fraction = None if state is None else state.speed_fraction
    return full_speed_s if fraction is None else full_speed_s / max(fraction, SLOWEST)


def go(
    bench: Bench,
    target: Pose,
    speed_m_s: float,
    pump: Pump | None = None,
    acceleration_m_s2: float = ACCELERATION_M_S2,
    full_speed_s: float = MOTION_TIMEOUT_S,
) -> None:
    """Move as `move` does and wait for the end, while frames are delivered if there is a pump.

    full_speed_s: time limit at full speed, see `arm_limit_s`; after it `DeviceTimeoutError` is raised.
    """
    before = bench.arm.state()
    motion = move(bench, target, speed_m_s, before, acceleration_m_s2)
    if pump is None:
        motion.wait(arm_limit_s(full_speed_s, before))
    else:
        limit_s = partial(arm_limit_s, full_speed_s)
        pump.run_until(motion.is_done, limit_s, "the arm did not end the motion")


def move_fingers(bench: Bench, opening_m: float, pump: Pump | None = None) -> GripperState:
    """Move the fingers and verify that they arrived; return the gripper's state at the end.

    opening_m: distance between the fingertips. pump: delivers frames during the motion. Closing fingers may
    stop early at an object that resists with the gripper's force (`GripperState.gripping`). For any other
    position outside `REACHED_M`, the gripper is stopped and `FingerMotionError` is raised: a Robotiq gripper
    whose finger met an obstacle ignores further commands in the same direction until rGTO is cleared (manual,
    OBJECT STATUS). If the hand held an object and its fingers opened less than requested, it counts as still
    holding it. After any other failed opening its state becomes unknown. Afterwards the pump compares the
    opening with the reached one, until the next motion; on a held object the gripper keeps the grip
    (`Gripper.keep_grip`).
    """
    opens = opening_m > bench.gripper.state().opening_m
    if pump is not None:
        pump.expect_fingers(None)
    motion = bench.gripper.move_to(opening_m, float(np.clip(FINGER_SPEED_M_S, *bench.gripper.spec.speed_m_s)))
    if pump is None:
        motion.wait(MOTION_TIMEOUT_S)
    else:
        pump.run_until(motion.is_done, MOTION_TIMEOUT_S, "the fingers did not end the motion")
    reached = bench.gripper.state()
    problem = _problem(reached, opening_m, opens, bench.gripper.spec)
    if problem is None:
        # fingers that stopped at an object close further if it gives way
        slack_m = max(STILL_M, STILL_STEPS * bench.gripper.spec.resolution_m) + _ROUNDING_M
        low_m, high_m = sorted((reached.opening_m, opening_m))
        if bench.hand.state.holding is Holding.HELD and not opens:
            bench.gripper.keep_grip(high_m + slack_m)
        if pump is not None:
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


def require_room(spec: GripperSpec, width_m: float) -> None:
    """Raise `OutOfLimitsError` if an object is too wide for the fingers."""
    needed_m = width_m + 2 * MARGIN_M
    if needed_m > spec.open_m:
        raise OutOfLimitsError(
            f"gripper: {1e3 * width_m:.1f} mm wide is too wide: the fingers come down "
            f"{1e3 * needed_m:.1f} mm apart and open {1e3 * spec.open_m:.1f} mm; "
            "see the object file and [gripper.limits]"
        )


def way_to(here: Pose, base_T_grasp: Pose) -> tuple[Pose, ...]:  # noqa: N803
    """Return the path on which a hand comes down around an object: up if it is low, across, down."""
    above = base_T_grasp.translated(z_m=CLEARANCE_M)
    risen = here.translated(z_m=max(0.0, above.position_m[2] - here.position_m[2]))
    return here, risen, above, base_T_grasp


def approach(bench: Bench, base_T_grasp: Pose, width_m: float, what: str) -> None:  # noqa: N803
    """Rise if the hand is low, open the fingers a little wider than the object, and move down around it.

    what: name of the object. Raises `OutOfLimitsError` before anything moves if the fingers do not open wide
    enough, or if the path crosses a keep-out box of the bench file. Raises `FingerMotionError` before the
    hand moves down if the fingers do not reach that opening.
    """
    require_room(bench.gripper.spec, width_m)
    above = base_T_grasp.translated(z_m=CLEARANCE_M)
    check_way(bench.arm.limits, way_to(bench.arm.state().base_T_tcp, base_T_grasp))
    _rise_to(bench, above.position_m[2])
    reached = open_around(bench, width_m)
    if reached.gripping:
        doubt_hand(bench, "the fingers met something before the hand came down")
        raise FingerMotionError(
            f"gripper: the fingers met something at {1e3 * reached.opening_m:.1f} mm before the hand came "
            "down; the arm does not move on. Free the space between the fingers, then start again"
        )
    bench.hand.note(HandState(Holding.FREE, finger_opening_m=reached.opening_m))
    go(bench, above, TRAVEL_SPEED_M_S)
    bench.hand.note(HandState(Holding.AROUND, what, base_T_grasp, width_m))
    go(bench, base_T_grasp, TRAVEL_SPEED_M_S)


def start_watching(bench: Bench, observer: LiftObserver, reference_s: float) -> Pump:
    """Start delivering frames: `reference_s` of the untouched gels, then of the grasp."""
    pump = Pump(bench, observer)
    pump.start()
    observer.phase(Phase.REFERENCE, pump.seen_ns)
    pump.run_for(reference_s)
    observer.phase(Phase.GRASP, pump.seen_ns)
    return pump


def close_to_contact(
    bench: Bench, pump: Pump, observer: LiftObserver, most_m: float = MOST_CLOSING_M
) -> float:
    """Close by steps of the gripper's resolution until both fingertips touch; return the opening then, m.

    The lowest force that the Robotiq 3-Finger can be commanded is 15 N (manual, rFR), ten times too much. A
    light grip is made by small steps, stopped by the tactile images. most_m: longest closing. After contact,
    the hand's state is held. Raises `GraspError` if the fingers meet nothing.
    """
    spec = bench.gripper.spec
    opening_m = spec.nearest(bench.gripper.state().opening_m)
    for _ in range(min(spec.steps_for(most_m), spec.steps - spec.step_at(opening_m))):
        if all(observer.touching(tip.sensor.serial) for tip in bench.fingertips):
            bench.hand.note(replace(bench.hand.state, holding=Holding.HELD))
            return opening_m
        opening_m = spec.closer(opening_m)
        step_fingers(bench, pump, observer, opening_m)
    raise GraspError(
        f"gripper: no contact on both fingertips, closed step by step to {1e3 * opening_m:.1f} mm; "
        "check that the object is in its place and that its width in the object file is right"
    )


def tighten(bench: Bench, pump: Pump, observer: LiftObserver, from_m: float, steps: int) -> float:
    """Close further in contact by steps of the gripper's resolution; return the opening at the end, m.

    Raises `FingerMotionError` if the gripper reports the last step but the fingertips show no firmer contact,
    so that no object is lifted with a grip that only the gripper's reports show. The hand's state is then
    unknown, because a reported opening would not be reliable either.
    """
    spec = bench.gripper.spec
    compared, before, opening_m = spec.steps_for(FIRMER_STEP_M), 0.0, from_m
    for step in range(steps):
        if step == steps - compared:
            before = pump.contact_strength()
        opening_m = spec.closer(opening_m)
        step_fingers(bench, pump, observer, opening_m)
    required = steps >= FIRMER_PARTS * compared
    if required and not (after := pump.contact_strength()) > FIRMER * before:
        doubt_hand(bench, "the fingertips do not show the motion that the gripper reports")
        raise FingerMotionError(
            f"gripper: it reports {1e3 * opening_m:.1f} mm, but the fingertips show the contact as it was "
            f"{1e3 * compared * spec.resolution_m:.1f} mm before (strength {before:.2f}, now {after:.2f}, "
            f"required {FIRMER} times as much): the "
            "fingers may not move as reported; the arm stays where it is. Check the fingers, then start "
            "again"
        )
    return opening_m


def step_fingers(bench: Bench, pump: Pump, observer: LiftObserver, opening_m: float) -> None:
    """Move the fingers to an opening while frames are delivered, and let the gel settle.

    Raises `FingerMotionError` if they do not reach it, see `move_fingers`.
    """
    observer.gripper(move_fingers(bench, opening_m, pump))
    pump.run_for(STEP_SETTLE_S)


def lift(bench: Bench, base_T_grasp: Pose, height_m: float, duration_s: float) -> Motion:  # noqa: N803
    """Start lifting straight up; return the motion."""
    speed = height_m / (0.8 * duration_s)  # a fifth of the time each for acceleration and deceleration
    acceleration = speed / (0.2 * duration_s)
    return bench.arm.move_linear(base_T_grasp.translated(z_m=height_m), speed, acceleration)


def lower_and_release(bench: Bench, base_T_grasp: Pose, width_m: float, pump: Pump | None = None) -> None:  # noqa: N803
    """Set the object down, open the fingers, and retreat upwards, as `open_and_rise` does."""
    go(bench, base_T_grasp, LOWER_SPEED_M_S, pump)
    open_and_rise(bench, base_T_grasp, width_m, pump)


def open_and_rise(bench: Bench, base_T_grasp: Pose, width_m: float, pump: Pump | None = None) -> None:  # noqa: N803
    """Open the fingers around an object that rests on its support, and rise straight up.

    pump: delivers frames until the fingers are open; with one, the fingertips must then show no contact.
    Raises `FingerMotionError` with the arm still at the grasp if the release cannot be verified.
    """
    open_around(bench, width_m, pump)
    bench.hand.note(replace(bench.hand.state, holding=Holding.AROUND))
    clear_m = base_T_grasp.position_m[2] + CLEARANCE_M
    _rise_to(bench, clear_m, TRAVEL_SPEED_M_S)
    bench.hand.note(HandState(Holding.FREE, finger_opening_m=bench.gripper.state().opening_m))


def open_around(bench: Bench, width_m: float, pump: Pump | None = None) -> GripperState:
    """Open the fingers a little wider than an object; return the gripper's state at the end.

    pump: of a grasp, whose release is then verified. Raises `FingerMotionError`, see `move_fingers` and
    `release`.
    """
    opening_m = bench.gripper.spec.nearest(width_m + 2 * MARGIN_M)
    return move_fingers(bench, opening_m) if pump is None else release(bench, opening_m, pump)


def _rise_to(bench: Bench, height_m: float, speed_m_s: float = LOWER_SPEED_M_S) -> None:
    """Rise straight up to a height of the TCP in the base frame; a hand at that height or above stays."""
    pose = bench.arm.state().base_T_tcp
    rise_m = height_m - pose.position_m[2]
    if rise_m > LEVEL_M:
        go(bench, pose.translated(z_m=rise_m), speed_m_s)


def home_plan(base_T_home: Pose, when: str) -> str:  # noqa: N803
    """Describe the motion home, for the plan that a person agrees to. when: such as "Before each lift"."""
    x, y, z = base_T_home.position_m
    return (
        f"{when} the arm goes home at up to {TRAVEL_SPEED_M_S} m/s: straight up, across, then down to "
        f"({x:.3f}, {y:.3f}, {z:.3f}) m."
    )


def go_home(bench: Bench) -> None:
    """Move a free hand home from any pose: straight up, across, down. If the arm is at home, nothing moves.

    The arm moves across at the height of home, or at its own height if that is higher, and never lower than
    `CLEARANCE_M` above the table. Raises `OutOfLimitsError` before anything moves if the path leaves the
    workspace.
    """
    here, home = bench.arm.state().base_T_tcp, bench.base_T_home
    if here.is_near(home, _THERE_M, _THERE_RAD):
        return
    top = max(pose.position_m[2] for pose in (here, home, bench.base_T_table.translated(z_m=CLEARANCE_M)))
    way = (*(pose.translated(z_m=top - pose.position_m[2]) for pose in (here, home)), home)
    limits = bench.arm.limits
    for pose in way:
        if not limits.has_inside(pose.position_m):
            low, high = limits.workspace_min_m, limits.workspace_max_m
            raise OutOfLimitsError(
                f"arm: the path home leads through {pose.position_m} m, outside {low} to {high} m; "
                "bring the arm inside with the pendant, then start again"
            )
    check_way(limits, (here, *way))
    for pose in way:
        if not here.is_near(pose, _THERE_M, _THERE_RAD):
            go(bench, pose, TRAVEL_SPEED_M_S)
            here = pose
