"""One simulated lift, with or without a reaction, and what truly happened in its world."""

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
from rig.experiments.lift_attempt import LiftTask, TrialSettings, attempt_lift
from rig.lift.slip_watch import CAUGHT_DEG
from rig.sessions.records import FinishedLift, LiftOutcome

MOST_FALSE = 1.0 / 45.0
"""Share of lifts that hold and may react all the same."""
GRIPPER_PERIOD_S = 0.01
"""How often the driver of the real gripper asks for its state; its registers are refreshed each 5 ms."""


@dataclass(frozen=True, slots=True)
class Told:
    """One reaction. latency_s: from the true half degree to the event's frame; None where it came to none.

    command_s: from that frame to the command. slipped: the object had slipped in the fingers since the lift
    began, or was last at rest.
    """

    latency_s: float | None
    command_s: float | None
    counts_added: int
    slipped: bool = True


@dataclass(frozen=True, slots=True)
class ReactedLift:
    """One lift. turn_deg: at its end, None where no marker was seen or a fault ended it.

    damaged: the object keeps a mark of the fingers. holds_from: the loosest grip at which friction carries
    its torque, in counts; None where the largest that its file allows and the gripper reaches does not.
    late: it turned by half a degree, and no event came.
    """

    object_id: str
    lift: int
    outcome: LiftOutcome
    turn_deg: float | None
    told: tuple[Told, ...]
    damaged: bool
    holds_from: int | None
    late: bool

    @property
    def counts_added(self) -> int:
        """How far the fingers closed further, in all."""
        return sum(reaction.counts_added for reaction in self.told)

    @property
    def would_hold(self) -> bool:
        """Whether a grip holds it that may be reached."""
        return self.holds_from is not None

    @property
    def slips(self) -> bool:
        """Whether it turned by more than a caught one may."""
        return self.outcome is LiftOutcome.FALLEN or abs(self.turn_deg or 0.0) > CAUGHT_DEG

    @property
    def caught(self) -> bool:
        """Whether it turned by no more, at full height wherever friction could carry it there."""
        kept = self.turn_deg is not None and abs(self.turn_deg) <= CAUGHT_DEG
        risen = self.outcome is LiftOutcome.CAUGHT or not self.would_hold
        return bool(self.told) and kept and risen and self.outcome is not LiftOutcome.FALLEN


def as_late_as_real(bench: BenchConfig) -> BenchConfig:
    """Return a simulated bench whose gripper obeys as late as a real one, unless it says how late."""
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
    furthest = grasps.largest_grip_counts or max(grasps.grip_counts)
    finished = row if isinstance(row, FinishedLift) else None
    told = _told(finished, world.slipped_between) if finished else ()
    turn_deg = finished.final_truth_deg if finished else None
    return ReactedLift(
        task.object_id,
        task.lift,
        row.outcome,
        turn_deg,
        told,
        damaged=world.damaged,
        holds_from=next((grip for grip in range(furthest + 1) if world.would_hold(offset_m, grip)), None),
        late=settings.react is not ReactionKind.NONE and not told and abs(turn_deg or 0.0) > 0.5,
    )


def _told(row: FinishedLift, slipped: Callable[[int, int], bool]) -> tuple[Told, ...]:
    """Return a lift's reactions beside what truly happened before each. slipped: within a span, ns."""
    lift_ns = to_ns(row.phases_s[Phase.LIFT])
    told, since_s = [], 0.0
    for r in row.reactions or ():
        latency_s = None if r.onset_s is None or r.event_s is None else r.event_s - r.onset_s
        command_s = None if r.event_s is None else r.command_s - r.event_s
        moved = slipped(lift_ns + to_ns(since_s), lift_ns + to_ns(r.command_s))
        told.append(Told(latency_s, command_s, r.counts_added, moved))
        since_s = r.command_s if r.rest_s is None else r.rest_s
    return tuple(told)
