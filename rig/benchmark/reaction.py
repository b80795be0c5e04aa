"""`rig benchmark reaction`: the same simulated lifts with and without a reaction to slip.

Lifts in this process have ground truth. A few lifts over the wire protocols measure the reactions' times.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from drivers.clock import NS_PER_S, to_ns
from protocols.grasps import find_grasp_file
from protocols.observer import Phase, ReactionStep
from protocols.reaction import ReactionKind
from rig.bench.source import FreshBenches
from rig.benchmark.harness import ALL, Cell, Report, Run, Study, Table, table_of
from rig.benchmark.measured import Measured, at_least, at_most, informative
from rig.benchmark.wire.campaign import WireBench, serve
from rig.config import load_bench
from rig.declared import option
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings, all_tasks, require_reaction
from rig.experiments.trial import resolve_objects, run_trial
from rig.lift.slip_watch import CAUGHT_DEG, SlipSettings
from rig.sessions.reading import recorded_reactions
from rig.sessions.records import Lift, LiftOutcome
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator

GRIPPER_PERIOD_S = 0.01
"""Period at which the real gripper's driver reads its state; the registers are refreshed every 5 ms."""
LEAST_CAUGHT, MOST_LATENCY_MS = 0.95, 50.0
MOST_FALSE = 1.0 / 45.0  # largest share of lifts with a reaction among those that hold
HELD_DEG = 0.5  # the grip of a lift holds if the final rotation without a reaction is smaller than this
WIRE_OBJECT = "t1"  # the wrench: it slips at any grip, so that each of its lifts has several reactions


@dataclass(frozen=True, slots=True)
class ReactionOptions:
    react: Literal["stop", "tighten", "lower"] = option("tighten", "Reaction to a slip.")
    objects: list[str] | None = option(
        None, "Id or name; repeat for more. Default: the trial's nine.", "--object"
    )
    lifts: int = option(5, "Lifts of each object.", min=1, max=100)
    alarms_per_hour: float = option(10.0, "Accepted number of reactions per hour at rest.")
    max_turn_deg: float | None = option(
        None, "React only if the predicted rotation exceeds this.", min=0.5, max=90.0
    )
    wire_lifts: int = option(
        4, "Number of additional lifts over the wire protocols, in real time.", min=0, max=100
    )


@dataclass(frozen=True, slots=True)
class Reaction:
    latency_s: float | None  # from a true rotation of half a degree to the event's frame; None if it is less
    command_s: float | None  # from that frame to the command
    counts_added: int
    slipped: bool = True  # whether the object had slipped since the start, or since it was last at rest


@dataclass(frozen=True, slots=True)
class ReactedLift:
    object_id: str
    lift: int
    outcome: LiftOutcome
    turn_deg: float | None  # final rotation; None if no marker was detected or a fault ended the lift
    reactions: tuple[Reaction, ...]
    damaged: bool  # whether the fingers left a mark on the object
    would_hold: bool  # whether friction carries the object's torque at an allowed grip
    late: bool  # whether the object turned by half a degree without an event

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


Pair = tuple[ReactedLift, ReactedLift]  # one lift without and with a reaction


def measure(options: ReactionOptions, run: Run) -> Report:
    """Lift the same SIMULATED objects without and with a reaction to slip, and compare.

    The tables show caught slips, rotations of the objects, time to detect a slip, false reactions, and fallen
    and damaged objects. The ground truth is that of the simulated world. A few more lifts run in real time
    over the wire protocols, to measure the time from a frame to its command. The exit code is 4 if a limit is
    missed.

    Examples:
      rig benchmark reaction
      rig benchmark reaction --react stop --object wrench --lifts 3 --json
    """
    bench = load_bench("fake")
    late = bench.require("gripper").model_copy(update={"period_s": GRIPPER_PERIOD_S})
    bench = bench.model_copy(update={"gripper": late})
    slip = SlipSettings(options.alarms_per_hour, options.max_turn_deg)
    kind = ReactionKind(options.react)
    settings = TrialSettings(bench, run.seed, choose_estimator("slip"), react=kind, slip=slip)
    objects = resolve_objects(options.objects, bench.objects)
    require_reaction(settings, objects)
    tasks = all_tasks(objects, options.lifts)
    pairs = run.each(partial(lift_both_ways, settings), tasks, attrgetter("name"))
    limits = judge_lifts(pairs)
    if options.wire_lifts:
        limits += times_over_wire(settings, options.wire_lifts, run)
    return Report(
        tables=(reaction_table(kind, pairs),),
        limits=limits,
        limits_of=f"'{kind}'",
        figures={"lifts": [{"without": asdict(before), "with": asdict(after)} for before, after in pairs]},
    )


def lift_both_ways(settings: TrialSettings, task: LiftTask) -> Pair:
    """Carry out one lift without a reaction and one with that of the settings. Runs in a worker process."""
    cv2.setNumThreads(1)
    return _lift_once(replace(settings, react=ReactionKind.NONE), task), _lift_once(settings, task)


def _lift_once(settings: TrialSettings, task: LiftTask) -> ReactedLift:
    worlds: list[Any] = []
    row = attempt_lift(settings, task, FreshBenches(settings.bench, watch=worlds.append)).row
    grasps = find_grasp_file(task.object_id, settings.bench.objects)
    offset_m = next(p.offset_m for p in grasps.position if p.name == row.position)
    (world,) = worlds
    furthest = settings.bench.gripper_spec().steps_for(grasps.largest_grip_m or max(grasps.grip_m))
    reactions = _reactions(row, world.slipped_between) if row.accepted else ()
    turn_deg = row.final_truth_deg
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
    """Return a lift's reactions with ground truth.

    slipped(from_ns, to_ns): whether the object slipped in that interval.
    """
    lift_ns = to_ns(row.phases_s[Phase.LIFT])
    reactions, since_s = [], 0.0
    for r in row.reactions or ():
        latency_s = None if r.onset_s is None or r.event_s is None else r.event_s - r.onset_s
        command_s = None if r.event_s is None else r.command_s - r.event_s
        moved = slipped(lift_ns + to_ns(since_s), lift_ns + to_ns(r.command_s))
        reactions.append(Reaction(latency_s, command_s, r.counts_added, moved))
        since_s = r.command_s if r.rest_s is None else r.rest_s
    return tuple(reactions)


def times_over_wire(settings: TrialSettings, lifts: int, run: Run) -> list[Measured]:
    """Carry out SIMULATED lifts in real time that react as soon as a slip is detected; return their times."""

    def show(done: int, total: int, row: Lift) -> None:
        run.progress(done, total, f"over the wire protocols, {row.object}/{row.lift}")

    with tempfile.TemporaryDirectory() as folder, serve(WireBench) as benches:
        session = Path(folder) / "session"
        slip = replace(settings.slip, max_turn_deg=None)
        trial = replace(settings, bench=benches.config, slip=slip)
        run_trial(session, trial, [WIRE_OBJECT], lifts, benches=benches, progress=show)
        return times_of(session, settings.react)


def times_of(session: Path, react: ReactionKind) -> list[Measured]:
    """Return the times of a session's reactions: from capture to command, and then to standstill."""
    rows = read_finished_lifts(session)
    reactions = [r for row in rows for r in row.reactions or ()]
    late_ms = [1e3 * (r.command_s - r.event_s) for r in reactions if r.event_s is not None]
    what = f"over the wire protocols, event's frame to command, 99 % of {len(late_ms)}, ms"
    found = [informative(what, np.percentile(late_ms, 99))] if late_ms else []
    moved = {"arm": (ReactionStep.STOP, ReactionStep.STANDS)}
    if react is ReactionKind.TIGHTEN:
        moved["fingers"] = (ReactionStep.CLOSE, ReactionStep.CLOSED)
    steps = [pair for row in rows for pair in pairwise(recorded_reactions(session / row.recording))]
    for who, both in moved.items():
        took_ms = [
            1e3 * (t1 - t0) / NS_PER_S for (first, t0), (second, t1) in steps if (first, second) == both
        ]
        for share in (50, 99) if took_ms else ():
            what = f"over the wire protocols, command to standstill of {who}, {share} %, ms"
            found.append(informative(what, np.percentile(took_ms, share)))
    return found


def reaction_table(kind: ReactionKind, pairs: Sequence[Pair]) -> Table:
    rows = []
    for name in (ALL, *dict.fromkeys(without.object_id for without, _ in pairs)):
        of = [pair for pair in pairs if name in (ALL, pair[0].object_id)]
        before, after = [pair[0] for pair in of], [pair[1] for pair in of]
        slipping = [reacted for without, reacted in of if without.slips]
        cannot_hold = sum(not lift.would_hold for lift in slipping)
        added = [sum(reaction.counts_added for reaction in lift.reactions) for lift in after]
        counts_added, fallen = (
            (float(np.median(added)), max(added)),
            (_count_fallen(before), _count_fallen(after)),
        )
        hopeless = "slipping lifts that no allowed grip holds"
        row = [
            Cell("object_id", name, "object"),
            Cell("lifts", len(of), "lifts"),
            Cell("slipping", len(slipping), "slip without"),
            Cell("caught", sum(lift.caught for lift in slipping), "caught", doc="of the slipping ones"),
            Cell("cannot_hold", cannot_hold, "largest grip cannot hold", doc=hopeless),
            Cell("turn_without_deg", _turn_deg(before), "median end turn without", ".1f", "degrees"),
            Cell("turn_with_deg", _turn_deg(after), "with", ".1f", "degrees"),
            Cell("reactions", sum(len(lift.reactions) for lift in after), "reactions"),
            Cell("counts_added", counts_added, "counts added, middle, most", ".0f"),
            Cell("fallen", fallen, "fallen without, with", ".0f"),
            Cell("damaged", sum(lift.damaged for lift in after), "damaged", doc="with a reaction"),
        ]
        rows.append(row)
    return table_of(
        f"SIMULATED reaction to slip '{kind}', the same lifts without and with; turns in degrees", rows
    )


def _count_fallen(lifts: Sequence[ReactedLift]) -> int:
    return sum(lift.outcome is LiftOutcome.FALLEN for lift in lifts)


def _turn_deg(lifts: Sequence[ReactedLift]) -> float | None:
    turns = [abs(lift.turn_deg) for lift in lifts if lift.turn_deg is not None]
    return float(np.median(turns)) if turns else None


def judge_lifts(pairs: Sequence[Pair]) -> list[Measured]:
    slipping = [after for before, after in pairs if before.slips]
    held = [after for before, after in pairs if abs(before.turn_deg or 0.0) <= HELD_DEG and not before.slips]
    reactions = [reaction for _, after in pairs for reaction in after.reactions]
    late = sum(after.late for _, after in pairs)
    latency_ms = [1e3 * r.latency_s for r in reactions if r.latency_s is not None] + [np.inf] * late
    caught = float(np.mean([after.caught for after in slipping])) if slipping else None
    slowest = float(np.percentile(latency_ms, 99)) if latency_ms else None
    dropped = _count_fallen([after for after in slipping if after.would_hold])
    false = f"share of lifts with a reaction although the grip holds, of {len(held)}"
    return [
        at_least("share of slipping lifts caught", caught, LEAST_CAUGHT),
        at_most("true half degree to event, 99th percentile, ms", slowest, MOST_LATENCY_MS),
        informative("slips without an event", late),
        at_most(false, np.mean([bool(lift.reactions) for lift in held]), MOST_FALSE)
        if held
        else Measured(false, None, f"at most {MOST_FALSE:.3g}", None),
        informative("reactions to less than half a degree", sum(r.latency_s is None for r in reactions)),
        informative("reactions to an object that had not slipped", sum(not r.slipped for r in reactions)),
        at_most("objects dropped with a reaction although friction could carry them", dropped, 0),
        at_most("objects damaged", sum(after.damaged for _, after in pairs), 0),
    ]


STUDY = Study("reaction", ReactionOptions, measure, "lifts")
