"""Wiggle a held object up and down, so that arm, camera and gels record the same motion on their clocks."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.bench import Bench
from protocols.capture_touch import REFERENCE_S, Touch, tighten_by
from protocols.observer import LiftObserver, Phase
from protocols.operator import Operator
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.steps import (
    MOTION_TIMEOUT_S,
    approach,
    close_to_contact,
    lower_and_release,
    start_watching,
)

ACCELERATION_M_S2 = 0.8
"""Acceleration of each stroke."""
SETTLE_S = 0.5
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
        pump.run_for(SETTLE_S)
        observer.phase(Phase.LIFT, pump.seen_ns)
        for stroke in strokes:
            goal = touch.base_T_grasp.translated(z_m=stroke.height_m)
            motion = bench.arm.move_linear(goal, stroke.speed_m_s, ACCELERATION_M_S2)
            pump.run_until(motion.done, MOTION_TIMEOUT_S)
        observer.phase(Phase.LOWER, pump.seen_ns)
        lower_and_release(bench, touch.base_T_grasp, touch.width_m, pump)
