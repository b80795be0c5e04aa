"""Close gently on gauges of known size, and move a held object to and fro.

Balls indent the gels, blocks calibrate the opening. A held object that moves shows arm, camera and gels the
same motion, each at its own times. The arm moves it up and down; without an arm, a person turns it by hand.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from drivers.bench import Bench
from drivers.types import HandState, Holding, Pose
from protocols.observer import LiftObserver, Phase
from protocols.operator import Operator
from protocols.pump import Pump
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.steps import (
    LOWER_SPEED_M_S,
    MARGIN_M,
    MOST_CLOSING_M,
    MOTION_TIMEOUT_S,
    approach,
    arm_limit_s,
    close_to_contact,
    go,
    lower_and_release,
    open_around,
    start_watching,
    step_fingers,
    tighten,
)

REFERENCE_S = 0.2
"""Duration of the frames without contact before the fingers close."""
SETTLE_S = 0.3
"""Time for the gels to settle after the fingers have moved."""
PAST_CONTACT_M = 0.0019
"""Closing beyond the first contact, m: three steps of a Robotiq 3-Finger. Then both gels are certainly
touched, and the fingers open again."""


@dataclass(frozen=True, slots=True)
class Touch:
    """One closing. gauge: what the operator places, such as "ball:6.31"; name: for people.

    base_T_grasp: TCP pose of the closing. width_m: of the gauge. grip_m: closing beyond the first contact.
    slack_m: extra opening, in addition to the margin, with which the fingers come down around the gauge, if
    there is room.
    """

    id: str
    gauge: str
    name: str
    base_T_grasp: Pose  # noqa: N815 - frame names keep their case
    width_m: float
    grip_m: float = 0.0
    slack_m: float = 0.0


def capture_presses(
    bench: Bench,
    operator: Operator,
    observer: LiftObserver,
    touches: Sequence[Touch],
    keep: Callable[[Touch], None],
) -> None:
    """Press each gauge as planned; `keep` is called while it is pressed and everything stands still.

    If the same gauge follows, it stays where it is: the fingers open, and close again a few mm further on.
    Raises `GraspError` if the fingers meet nothing, and the error of a device, after a safe end.
    """

    def press(pump: Pump, touch: Touch, contact_m: float) -> None:
        tighten_by(bench, pump, observer, contact_m, touch.grip_m)
        pump.run_for(SETTLE_S)
        keep(touch)

    _each(bench, operator, observer, touches, press)


def capture_openings(
    bench: Bench,
    operator: Operator,
    observer: LiftObserver,
    touches: Sequence[Touch],
    closed: Callable[[Touch, float], None],
    opened: Callable[[Touch, float], None],
) -> None:
    """Close on blocks of known width and open again, in steps of the gripper's resolution.

    Positions are in steps from open. `closed` receives the position between the last step without contact and
    the first with contact; `opened` the position between the last step with contact and the first without. At
    both the opening equals the block's width. Raises as `capture_presses` does.
    """
    spec = bench.gripper.spec

    def measure(pump: Pump, touch: Touch, contact_m: float) -> None:
        closed(touch, spec.step_at(contact_m) - 0.5)
        opening_m = tighten_by(bench, pump, observer, contact_m, PAST_CONTACT_M)
        for _ in range(spec.steps_for(MOST_CLOSING_M)):
            opening_m = spec.closer(opening_m, -1)
            step_fingers(bench, pump, observer, opening_m)
            pump.run_for(SETTLE_S)
            if not all(observer.touching(tip.sensor.serial) for tip in bench.fingertips):
                opened(touch, spec.step_at(opening_m) + 0.5)
                return

    _each(bench, operator, observer, touches, measure)


def tighten_by(bench: Bench, pump: Pump, observer: LiftObserver, from_m: float, by_m: float) -> float:
    """Close further in contact by a distance in m, see `tighten`; return the opening at the end, m."""
    steps = bench.gripper.spec.steps_for(by_m) if by_m > 0.0 else 0
    return tighten(bench, pump, observer, from_m, steps)


def _each(
    bench: Bench,
    operator: Operator,
    observer: LiftObserver,
    touches: Sequence[Touch],
    touched: Callable[[Pump, Touch, float], None],
) -> None:
    """Close on each gauge in turn, with frames of the untouched gels before; open, and rise at the end."""
    make_ready(bench, operator)
    before: Touch | None = None
    pump: Pump | None = None
    with safe_end(bench):
        for touch in touches:
            if before is None or before.gauge != touch.gauge:
                _leave(bench, before, pump)
                operator.place(touch.gauge, touch.name)
                room_m = bench.gripper.spec.open_m - 2 * MARGIN_M
                width_m = max(touch.width_m, min(touch.width_m + touch.slack_m, room_m))
                approach(bench, touch.base_T_grasp, width_m, touch.name)
            else:  # open around the gauge and move to the next place, along the gels
                open_around(bench, touch.width_m, pump)
                bench.hand.note(HandState(Holding.AROUND, touch.name, touch.base_T_grasp, touch.width_m))
                go(bench, touch.base_T_grasp, LOWER_SPEED_M_S)
            before = touch
            pump = start_watching(bench, observer, REFERENCE_S)
            touched(pump, touch, close_to_contact(bench, pump, observer))
        _leave(bench, before, pump)


def _leave(bench: Bench, touch: Touch | None, pump: Pump | None) -> None:
    if touch is not None:
        lower_and_release(bench, touch.base_T_grasp, touch.width_m, pump)


ACCELERATION_M_S2 = 0.8
"""Acceleration of each stroke."""
WIGGLE_SETTLE_S = 0.5
"""Time at rest before the strokes."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """A straight motion to a height above the grasp, m, at a speed, m/s."""

    height_m: float
    speed_m_s: float


def capture_wiggle(
    bench: Bench, operator: Operator, observer: LiftObserver, touch: Touch, strokes: Sequence[Stroke]
) -> None:
    """Grasp, wiggle, set down; the observer receives all of it, the wiggle between LIFT and LOWER.

    strokes: of different heights and speeds, because a periodic motion correlates with itself at several
    offsets. Raises the error of a device after a safe end.
    """
    make_ready(bench, operator)
    operator.place(touch.gauge, touch.name)
    with safe_end(bench):
        approach(bench, touch.base_T_grasp, touch.width_m, touch.name)
        pump = start_watching(bench, observer, REFERENCE_S)
        tighten_by(bench, pump, observer, close_to_contact(bench, pump, observer), touch.grip_m)
        pump.run_for(WIGGLE_SETTLE_S)
        observer.phase(Phase.LIFT, pump.seen_ns)
        for stroke in strokes:
            goal = touch.base_T_grasp.translated(z_m=stroke.height_m)
            motion = bench.arm.move_linear(goal, stroke.speed_m_s, ACCELERATION_M_S2)
            limit_s = partial(arm_limit_s, MOTION_TIMEOUT_S)
            pump.run_until(motion.is_done, limit_s, "the arm did not end a stroke")
        observer.phase(Phase.LOWER, pump.seen_ns)
        lower_and_release(bench, touch.base_T_grasp, touch.width_m, pump)


BY_HAND_S = 20.0
"""Duration of turning by hand: about thirty turns to and fro."""


def capture_turning_by_hand(bench: Bench, operator: Operator, observer: LiftObserver, touch: Touch) -> None:
    """Have a person turn an object on the gels; the observer gets it between LIFT and LOWER. No device moves.

    Raises `OperatorStopError` unless the person agrees, and the devices' errors.
    """
    operator.hold(
        f"Press {touch.name} onto every gel of the bench, with its markers in the camera's image. After you "
        f"agree, turn it to and fro by about 5 degrees for {BY_HAND_S:.0f} s, sometimes faster and sometimes "
        "slower, without lifting it off. Is it pressed?",
        touch.gauge,
        touch.base_T_grasp,
        touch.width_m - touch.grip_m,
        turning=True,
    )
    pump = Pump(bench, observer)
    pump.start()
    observer.phase(Phase.LIFT, pump.seen_ns)
    pump.run_for(BY_HAND_S)
    observer.phase(Phase.LOWER, pump.seen_ns)
