"""The steps of the experiments, each a few driver calls.

Downward motions stop at contact: force and gripper are monitored. The constructors of the states reject NaN
and other invalid values (`drivers.types`), and their error stops the motion; so no comparison here is false
because of NaN.
"""

from dataclasses import replace

import numpy as np

from drivers.bench import Bench
from drivers.errors import ContactForceError, FingerMotionError, GraspError, OutOfLimitsError
from drivers.interfaces import Motion
from drivers.motion import PolledMotion, check_way
from drivers.types import ArmState, GripperSpec, GripperState, HandState, Holding, Pose
from protocols.fingers import MOTION_TIMEOUT_S, doubt_hand, move_fingers, release, wait_with
from protocols.observer import LiftObserver, Phase
from protocols.pump import Pump


def guarded(bench: Bench, motion: Motion, before: ArmState) -> Motion:
    """Return a motion of the arm that stops if the force changes by more than the arm's limit.

    An arm without a force sensor (no `max_contact_force_n`) is not stopped at contact; the plan states that.

    before: state of the arm when the motion began; its force includes the sensor's offset and the weight of
    an object in the fingers. `done` stops the arm and raises `ContactForceError`. It raises the error of a
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
        return motion.done()

    return PolledMotion("arm", bench.clock, has_ended, bench.arm.stop)


TRAVEL_SPEED_M_S = 0.25
LOWER_SPEED_M_S = 0.10
ACCELERATION_M_S2 = 1.0
"""Speed of travel, speed of setting down, and acceleration of all motions."""
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
    bench.hand.note(HandState(Holding.FREE, finger_opening_m=reached.opening_m))
    move(bench, above, TRAVEL_SPEED_M_S).wait(MOTION_TIMEOUT_S)
    bench.hand.note(HandState(Holding.AROUND, what, base_T_grasp, width_m))
    move(bench, base_T_grasp, TRAVEL_SPEED_M_S).wait(MOTION_TIMEOUT_S)


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
    wait_with(pump, move(bench, base_T_grasp, LOWER_SPEED_M_S), "the arm")
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
        move(bench, pose.translated(z_m=rise_m), speed_m_s).wait(MOTION_TIMEOUT_S)


def move(bench: Bench, target: Pose, speed_m_s: float) -> Motion:
    """Start a straight motion with ACCELERATION_M_S2; return it. Downward motions are guarded."""
    before = bench.arm.state()
    motion = bench.arm.move_linear(target, speed_m_s, ACCELERATION_M_S2)
    if target.position_m[2] >= before.base_T_tcp.position_m[2] - LEVEL_M:
        return motion
    return guarded(bench, motion, before)
