"""One lift of the slip trial (paper, section IV-B): reference, grasp, lift, hold, set down."""

from dataclasses import dataclass
from functools import partial

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from drivers.motion import check_way
from drivers.types import Pose
from protocols.observer import LiftObserver, Phase
from protocols.pump import Pump
from protocols.reaction import Reaction, Reflex
from protocols.safe_end import safe_end
from protocols.steps import (
    approach,
    arm_limit_s,
    close_to_contact,
    lift,
    lower_and_release,
    start_watching,
    tighten,
)

REFERENCE_S = 0.25
"""Duration of the frames without contact before the fingers close."""
GRASP_S = 3.0
"""Duration of phase A, from the first closing step to the lift."""
SETTLE_S = 0.8
"""Least time from the end of the closing until the lift."""
LIFT_S = 1.5
"""Duration of phase B, the lift."""
HOLD_S = 1.2
"""Duration of phase C, the hold."""
SEEN_S = 0.3
"""Observation time before an early set-down after a reaction, so that the final angle is recorded."""
LIFT_TIMEOUT_S = 8.0
"""Time limit of the lift at full speed."""


@dataclass(frozen=True, slots=True)
class LiftPlan:
    """Parameters of one lift.

    base_T_grasp: TCP pose when closed on the object. grip_steps: closing in steps of the gripper's resolution
    beyond the first contact of both fingertips. width_m: of the object at the grasp. lift_height_m: of phase
    B.
    """

    object_id: str
    object_name: str
    position: str
    base_T_grasp: Pose  # noqa: N815 - frame names keep their case
    width_m: float
    grip_steps: int
    lift_height_m: float


def run_lift(bench: Bench, plan: LiftPlan, observer: LiftObserver, reaction: Reaction | None = None) -> None:
    """Execute one lift. On any error or stop it ends as `protocols.safe_end` describes.

    A phase begins at the end of the frames delivered so far, so that each frame belongs to one phase.
    reaction: to a slip; None for no reaction. Raises the device's error after the safe end, with a note on
    how it ended; the observer has received all events until then.
    """
    rise = plan.base_T_grasp.translated(z_m=plan.lift_height_m)
    check_way(bench.arm.limits, (plan.base_T_grasp, rise))
    with safe_end(bench):
        approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
        pump = start_watching(bench, observer, REFERENCE_S)
        began_ns = bench.clock.now_ns()
        contact_m = close_to_contact(bench, pump, observer)
        tighten(bench, pump, observer, contact_m, plan.grip_steps)
        spent_s = (bench.clock.now_ns() - began_ns) / NS_PER_S
        pump.run_for(max(GRASP_S - spent_s, SETTLE_S))
        reflex = Reflex(bench, pump, observer, reaction, contact_m, plan.grip_steps)
        observer.phase(Phase.LIFT, pump.seen_ns)
        lifted = _rise(bench, pump, plan, reflex)
        observer.phase(Phase.HOLD, pump.seen_ns)
        if lifted or not reflex.sets_down:
            _hold(pump, reflex)
        else:
            pump.run_for(SEEN_S)
        observer.phase(Phase.LOWER, pump.seen_ns)
        lower_and_release(bench, plan.base_T_grasp, plan.width_m, pump)


def _rise(bench: Bench, pump: Pump, plan: LiftPlan, reflex: Reflex) -> bool:
    """Lift, with reactions if the object slips; return whether the full height was reached."""
    while True:
        rising = lift(bench, plan.base_T_grasp, plan.lift_height_m, LIFT_S)
        pump.run_until(
            lambda motion=rising: reflex.has_slip() or motion.is_done(),
            partial(arm_limit_s, LIFT_TIMEOUT_S),
            "the arm did not reach the lift height",
        )
        if not reflex.has_slip():
            return True
        if not reflex.react(rising):
            return False


def _hold(pump: Pump, reflex: Reflex) -> None:
    """Hold for HOLD_S; after each reaction, hold for HOLD_S again."""
    while not pump.run_for(HOLD_S, reflex.has_slip):
        if not reflex.react() and reflex.sets_down:
            pump.run_for(SEEN_S)
            return
