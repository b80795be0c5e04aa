"""`rig benchmark reaction`: the same simulated lifts with and without a reaction to slip."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from operator import attrgetter
from typing import Literal

import numpy as np

from protocols.reaction import ReactionKind
from rig.benchmark.harness import Report, Run, Study, Table, column, option, table_of
from rig.benchmark.measured import Measured, at_least, at_most, informative
from rig.benchmark.reaction.lifts import (
    ReactedLift,
    as_late_as_real,
    lift_both_ways,
    times_over_wire,
)
from rig.config import load_bench
from rig.experiments.lift_plan import TrialSettings, all_tasks, require_reaction
from rig.experiments.trial import resolve_objects
from rig.lift.slip_watch import SlipSettings
from rig.sessions.records import LiftOutcome
from rig.tactile.estimators import choose_estimator

LEAST_CAUGHT, MOST_LATENCY_MS = 0.95, 50.0
MOST_FALSE = 1.0 / 45.0
"""Largest share of lifts with a reaction among those that hold."""
HELD_DEG = 0.5
"""The grip of a lift holds if the final rotation without a reaction is smaller than this."""
Pair = tuple[ReactedLift, ReactedLift]
"""One lift without and with a reaction."""


@dataclass(frozen=True, slots=True)
class ReactionOptions:
    """Options of `rig benchmark reaction`."""

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
class ReactionRow:
    """The lifts of one object, or all lifts."""

    object_id: str = column("object")
    lifts: int = column("lifts")
    slipping: int = column("slip without")
    caught: int = column("caught", doc="of the slipping ones")
    cannot_hold: int = column("largest grip cannot hold", doc="slipping lifts that no allowed grip holds")
    turn_without_deg: float | None = column("median end turn without", ".1f", "degrees")
    turn_with_deg: float | None = column("with", ".1f", "degrees")
    reactions: int = column("reactions")
    counts_added: tuple[float, int] = column("counts added, middle, most", ".0f")
    fallen: tuple[int, int] = column("fallen without, with", ".0f")
    damaged: int = column("damaged", doc="with a reaction")


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
    bench = as_late_as_real(load_bench("fake"))
    slip = SlipSettings(options.alarms_per_hour, options.max_turn_deg)
    kind = ReactionKind(options.react)
    settings = TrialSettings(bench, run.seed, choose_estimator("slip"), react=kind, slip=slip)
    objects = resolve_objects(options.objects, bench.objects)
    require_reaction(settings, objects)
    tasks = all_tasks(objects, options.lifts)
    pairs = run.each(partial(lift_both_ways, settings), tasks, attrgetter("name"))
    limits = judge_lifts(pairs)
    if options.wire_lifts:
        limits += times_over_wire(settings, options.wire_lifts, run.progress)
    return Report(
        tables=(reaction_table(kind, pairs),),
        limits=limits,
        limits_of=f"'{kind}'",
        figures={"lifts": [{"without": asdict(before), "with": asdict(after)} for before, after in pairs]},
    )


def reaction_table(kind: ReactionKind, pairs: Sequence[Pair]) -> Table:
    """Return a row per object, all first."""
    objects = dict.fromkeys(without.object_id for without, _ in pairs)
    groups = {"all": pairs} | {o: [pair for pair in pairs if pair[0].object_id == o] for o in objects}
    title = f"SIMULATED reaction to slip '{kind}', the same lifts without and with; turns in degrees"
    return table_of(title, ReactionRow, [_row(name, of) for name, of in groups.items()])


def _row(name: str, pairs: Sequence[Pair]) -> ReactionRow:
    before, after = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    slipping = [reacted for without, reacted in pairs if without.slips]
    added = [lift.counts_added for lift in after]
    return ReactionRow(
        object_id=name,
        lifts=len(pairs),
        slipping=len(slipping),
        caught=sum(lift.caught for lift in slipping),
        cannot_hold=sum(not lift.would_hold for lift in slipping),
        turn_without_deg=_median_turn(before),
        turn_with_deg=_median_turn(after),
        reactions=sum(len(lift.reactions) for lift in after),
        counts_added=(float(np.median(added)), max(added)),
        fallen=(_fallen(before), _fallen(after)),
        damaged=sum(lift.damaged for lift in after),
    )


def _fallen(lifts: Sequence[ReactedLift]) -> int:
    return sum(lift.outcome is LiftOutcome.FALLEN for lift in lifts)


def _median_turn(lifts: Sequence[ReactedLift]) -> float | None:
    turns = [abs(lift.turn_deg) for lift in lifts if lift.turn_deg is not None]
    return float(np.median(turns)) if turns else None


def judge_lifts(pairs: Sequence[Pair]) -> list[Measured]:
    """Return the limits on lifts without and with a reaction."""
    slipping = [after for before, after in pairs if before.slips]
    held = [after for before, after in pairs if abs(before.turn_deg or 0.0) <= HELD_DEG and not before.slips]
    reactions = [reaction for _, after in pairs for reaction in after.reactions]
    late = sum(after.late for _, after in pairs)
    latency_ms = [1e3 * r.latency_s for r in reactions if r.latency_s is not None] + [np.inf] * late
    caught = float(np.mean([after.caught for after in slipping])) if slipping else None
    slowest = float(np.percentile(latency_ms, 99)) if latency_ms else None
    dropped = _fallen([after for after in slipping if after.would_hold])
    damaged = sum(after.damaged for _, after in pairs)
    false = f"share of lifts with a reaction although the grip holds, of {len(held)}"
    return [
        at_least("share of slipping lifts caught", caught, LEAST_CAUGHT),
        at_most("true half degree to event, 99th percentile, ms", slowest, MOST_LATENCY_MS),
        informative("slips without an event", late),
        at_most(false, _false_share(held), MOST_FALSE)
        if held
        else Measured(false, None, f"at most {MOST_FALSE:.3g}", None),
        informative("reactions to less than half a degree", sum(r.latency_s is None for r in reactions)),
        informative("reactions to an object that had not slipped", sum(not r.slipped for r in reactions)),
        at_most("objects dropped with a reaction although friction could carry them", dropped, 0),
        at_most("objects damaged", damaged, 0),
    ]


def _false_share(held: Sequence[ReactedLift]) -> float | None:
    return float(np.mean([bool(lift.reactions) for lift in held])) if held else None


STUDY = Study(name="reaction", options=ReactionOptions, measure=measure, cases="lifts")
