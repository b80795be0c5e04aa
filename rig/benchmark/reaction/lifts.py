"""One simulated lift, with or without a reaction, beside the ground truth of its simulated world."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2

from drivers.clock import to_ns
from protocols.grasps import find_grasp_file
from protocols.observer import Phase
from protocols.reaction import ReactionKind
from rig.bench.source import FreshBenches
from rig.config import BenchConfig
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.lift.slip_watch import CAUGHT_DEG
from rig.sessions.records import FinishedLift, LiftOutcome

GRIPPER_PERIOD_S = 0.01
"""Period at which the real gripper's driver reads its state; the registers are refreshed every 5 ms."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """One reaction.

    latency_s: from the true half degree to the event's frame; None if the object turned by less. command_s:
    from that frame to the command. slipped: the object had slipped in the fingers since the lift began, or
    since it was last at rest.
    """

    latency_s: float | None
    command_s: float | None
    counts_added: int
    slipped: bool = True


@dataclass(frozen=True, slots=True)
class ReactedLift:
    """One lift.

    turn_deg: at its end; None if no marker was detected or a fault ended it. damaged: the fingers left a mark
    on the object. holds_from: the loosest grip, in steps of the gripper, at which friction carries the
    object's torque; None if the largest allowed grip does not. late: the object turned by half a degree
    without an event.
    """

    object_id: str
    lift: int
    outcome: LiftOutcome
    turn_deg: float | None
    reactions: tuple[Reaction, ...]
    damaged: bool
    holds_from: int | None
    late: bool

    @property
    def counts_added(self) -> int:
        """Sum of the counts by which the fingers closed further."""
        return sum(reaction.counts_added for reaction in self.reactions)

    @property
    def would_hold(self) -> bool:
        """Whether an allowed grip holds the object."""
        return self.holds_from is not None

    @property
    def slips(self) -> bool:
        """Whether it fell, or turned by more than CAUGHT_DEG."""
        return self.outcome is LiftOutcome.FALLEN or abs(self.turn_deg or 0.0) > CAUGHT_DEG

    @property
    def caught(self) -> bool:
        """Whether it turned by at most CAUGHT_DEG, and was lifted fully if friction could carry it."""
        kept = self.turn_deg is not None and abs(self.turn_deg) <= CAUGHT_DEG
        risen = self.outcome is LiftOutcome.CAUGHT or not self.would_hold
        return bool(self.reactions) and kept and risen and self.outcome is not LiftOutcome.FALLEN


def as_late_as_real(bench: BenchConfig) -> BenchConfig:
    """Return a simulated bench with the delay of a real gripper, unless the bench sets a delay."""
    if not bench.in_process or bench.gripper.period_s:
        return bench
    late = bench.gripper.model_copy(update={"period_s": GRIPPER_PERIOD_S})
    return bench.model_copy(update={"gripper": late})


def lift_both_ways(settings: TrialSettings, task: LiftTask) -> tuple[ReactedLift, ReactedLift]:
    """Carry out one lift without a reaction and with the settings' own; what a worker process does."""
    without = replace(settings, react=ReactionKind.NONE)
    return lift_once(without, task), lift_once(settings, task)


def lift_once(settings: TrialSettings, task: LiftTask) -> ReactedLift:
    """Carry out one lift as the settings say; what a worker process does."""
    cv2.setNumThreads(1)
    worlds: list[Any] = []
    row = attempt_lift(settings, task, FreshBenches(settings.bench, watch=worlds.append)).row
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    offset_m = next(p.offset_m for p in grasps.position if p.name == row.position)
    (world,) = worlds
    furthest = settings.bench.gripper_spec().steps_for(grasps.largest_grip_m or max(grasps.grip_m))
    finished = row if isinstance(row, FinishedLift) else None
    reactions = _reactions(finished, world.slipped_between) if finished else ()
    turn_deg = finished.final_truth_deg if finished else None
    return ReactedLift(
        task.object_id,
        task.lift,
        row.outcome,
        turn_deg,
        reactions,
        damaged=world.damaged,
        holds_from=next((grip for grip in range(furthest + 1) if world.would_hold(offset_m, grip)), None),
        late=settings.react is not ReactionKind.NONE and not reactions and abs(turn_deg or 0.0) > 0.5,
    )


def _reactions(row: FinishedLift, slipped: Callable[[int, int], bool]) -> tuple[Reaction, ...]:
    """Return a lift's reactions beside the ground truth. slipped: whether within a span of times, ns."""
    lift_ns = to_ns(row.phases_s[Phase.LIFT])
    reactions, since_s = [], 0.0
    for r in row.reactions or ():
        latency_s = None if r.onset_s is None or r.event_s is None else r.event_s - r.onset_s
        command_s = None if r.event_s is None else r.command_s - r.event_s
        moved = slipped(lift_ns + to_ns(since_s), lift_ns + to_ns(r.command_s))
        reactions.append(Reaction(latency_s, command_s, r.counts_added, moved))
        since_s = r.command_s if r.rest_s is None else r.rest_s
    return tuple(reactions)
