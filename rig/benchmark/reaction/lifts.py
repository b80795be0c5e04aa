"""Simulated lifts with a reaction to slip, in this process with ground truth, and over the wire protocols."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.clock import NS_PER_S, to_ns
from protocols.grasps import find_grasp_file
from protocols.observer import Phase, ReactionStep
from protocols.reaction import ReactionKind
from rig.bench.fakes_process import started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import FreshBenches, StandingBench
from rig.benchmark.measured import Measured, informative
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.experiments.trial import run_trial
from rig.lift.slip_watch import CAUGHT_DEG
from rig.sessions.reading import recorded_reactions
from rig.sessions.records import Lift, LiftOutcome
from rig.sessions.rows import read_finished_lifts

GRIPPER_PERIOD_S = 0.01
"""Period at which the real gripper's driver reads its state; the registers are refreshed every 5 ms."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """One reaction.

    latency_s: time from a true rotation of half a degree to the event's frame; None if the object turned by
    less. command_s: time from that frame to the command. slipped: whether the object had slipped in the
    fingers since the start of the lift, or since it was last at rest.
    """

    latency_s: float | None
    command_s: float | None
    counts_added: int
    slipped: bool = True


@dataclass(frozen=True, slots=True)
class ReactedLift:
    """One lift.

    turn_deg: final rotation; None if no marker was detected or a fault ended the lift. damaged: whether the
    fingers left a mark on the object. would_hold: whether friction carries the object's torque at an allowed
    grip. late: whether the object turned by half a degree without an event.
    """

    object_id: str
    lift: int
    outcome: LiftOutcome
    turn_deg: float | None
    reactions: tuple[Reaction, ...]
    damaged: bool
    would_hold: bool
    late: bool

    @property
    def counts_added(self) -> int:
        """Sum of the counts by which the fingers closed further."""
        return sum(reaction.counts_added for reaction in self.reactions)

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
    """Carry out one lift without a reaction and one with that of the settings. Runs in a worker process."""
    without = replace(settings, react=ReactionKind.NONE)
    return lift_once(without, task), lift_once(settings, task)


def lift_once(settings: TrialSettings, task: LiftTask) -> ReactedLift:
    """Carry out one lift with the settings. Runs in a worker process."""
    cv2.setNumThreads(1)
    worlds: list[Any] = []
    row = attempt_lift(settings, task, FreshBenches(settings.bench, watch=worlds.append)).row
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    offset_m = next(p.offset_m for p in grasps.position if p.name == row.position)
    (world,) = worlds
    furthest = settings.bench.gripper_spec().steps_for(grasps.largest_grip_m or max(grasps.grip_m))
    finished = row if row.accepted else None
    reactions = _reactions(finished, world.slipped_between) if finished else ()
    turn_deg = finished.final_truth_deg if finished else None
    return ReactedLift(
        task.object_id,
        task.lift,
        row.outcome,
        turn_deg,
        reactions,
        damaged=world.damaged,
        would_hold=any(world.would_hold(offset_m, grip) for grip in range(furthest + 1)),
        late=settings.react is not ReactionKind.NONE and not reactions and abs(turn_deg or 0.0) > 0.5,
    )


def _reactions(row: Lift, slipped: Callable[[int, int], bool]) -> tuple[Reaction, ...]:
    """Return a lift's reactions with ground truth. slipped: returns whether it slipped between times, ns."""
    lift_ns = to_ns(row.phases_s[Phase.LIFT])
    reactions, since_s = [], 0.0
    for r in row.reactions or ():
        latency_s = None if r.onset_s is None or r.event_s is None else r.event_s - r.onset_s
        command_s = None if r.event_s is None else r.command_s - r.event_s
        moved = slipped(lift_ns + to_ns(since_s), lift_ns + to_ns(r.command_s))
        reactions.append(Reaction(latency_s, command_s, r.counts_added, moved))
        since_s = r.command_s if r.rest_s is None else r.rest_s
    return tuple(reactions)


OBJECT = "t1"
"""The wrench: it slips at any grip, so that each of its lifts has several reactions."""
MS_PER_S = 1e3
ARM = (ReactionStep.STOP, ReactionStep.STANDS)
FINGERS = (ReactionStep.CLOSE, ReactionStep.CLOSED)


def times_over_wire(
    settings: TrialSettings, lifts: int, progress: Callable[[int, int, str], None] = lambda *_: None
) -> list[Measured]:
    """Carry out lifts that react as soon as a slip is detected; return the times of the reactions.

    SIMULATED devices, in real time. Raises the errors of `run_trial`.
    """

    def show(done: int, total: int, row: Lift) -> None:
        progress(done, total, f"over the wire protocols, {row.object}/{row.lift}")

    with (
        tempfile.TemporaryDirectory() as folder,
        started_fakes(load_bench("wire")) as config,
        closing(StandingBench(config, ConsoleOperator(lambda _: True), "")) as benches,
    ):
        session = Path(folder) / "session"
        trial = replace(settings, bench=config, slip=replace(settings.slip, max_turn_deg=None))
        run_trial(session, trial, [OBJECT], lifts, benches=benches, progress=show)
        return times_of(session, settings.react)


def times_of(session: Path, react: ReactionKind) -> list[Measured]:
    """Return the times of a session's reactions: from capture to command, and then to standstill."""
    rows = read_finished_lifts(session)
    reactions = [r for row in rows for r in row.reactions or ()]
    late_ms = [MS_PER_S * (r.command_s - r.event_s) for r in reactions if r.event_s is not None]
    steps = [recorded_reactions(session / row.recording) for row in rows]
    moved = {"arm": ARM, "fingers": FINGERS} if react is ReactionKind.TIGHTEN else {"arm": ARM}
    took_ms = {who: [ms for lift in steps for ms in _took_ms(lift, both)] for who, both in moved.items()}
    return [
        *(
            informative(
                f"over the wire protocols, event's frame to command, 99 % of {len(late_ms)}, ms",
                np.percentile(late_ms, 99),
            )
            for _ in late_ms[:1]
        ),
        *(
            informative(
                f"over the wire protocols, command to standstill of {who}, {of} %, ms", np.percentile(ms, of)
            )
            for who, ms in took_ms.items()
            if ms
            for of in (50, 99)
        ),
    ]


def _took_ms(
    steps: Sequence[tuple[ReactionStep, int]], both: tuple[ReactionStep, ReactionStep]
) -> Iterator[float]:
    """Yield the time between two steps, for each pair of which the second follows the first directly."""
    for (first, began_ns), (second, ended_ns) in pairwise(steps):
        if (first, second) == both:
            yield MS_PER_S * (ended_ns - began_ns) / NS_PER_S
