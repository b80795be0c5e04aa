"""`rig benchmark reaction`: the same simulated lifts with and without a reaction to slip."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.harness import machine
from rig.benchmark.measured import Measured, at_least, at_most, informative
from rig.benchmark.reaction.full import run_further
from rig.benchmark.reaction.lifts import MOST_FALSE, ReactedLift, lift_both_ways
from rig.benchmark.reaction.wire import react_behind_wires
from rig.experiments.lift_attempt import TrialSettings, all_tasks
from rig.experiments.process_pool import run_tasks
from rig.experiments.reactions import require_reaction
from rig.sessions.records import LiftOutcome

SCHEMA = 2
LEAST_CAUGHT, MOST_LATENCY_MS = 0.95, 50.0
HELD_DEG = 0.5
Progress = Callable[[int, int, str], None]
"""Called with how many lifts are done, of how many, and the name of the last one."""
Pair = tuple[ReactedLift, ReactedLift]


@dataclass(frozen=True, slots=True)
class ReactionResult:
    """Everything measured. pairs: each lift without and with a reaction. SIMULATED throughout.

    limits: of these lifts, and of what was looked at further.
    """

    kind: str
    seed: int
    pairs: tuple[Pair, ...]
    limits: tuple[Measured, ...]
    wall_s: float


def run_reaction(
    settings: TrialSettings,
    objects: Sequence[str],
    lifts: int,
    jobs: int | None = None,
    progress: Progress = lambda *_: None,
    wire_lifts: int = 0,
    full: bool = False,
) -> ReactionResult:
    """Carry out every lift twice. Raises `InputError` where the settings cannot react.

    wire_lifts: so many more behind wires, in real time (`rig.benchmark.reaction.wire`).
    full: look at lifts that hold, at hours at rest, and at faults as well (`rig.benchmark.reaction.full`).
    """
    began = time.perf_counter()
    require_reaction(settings, objects)
    tasks = all_tasks(objects, lifts)
    found: dict[int, Pair] = {}
    cores = jobs or os.cpu_count() or 1
    for task, pair in run_tasks(partial(lift_both_ways, settings), list(tasks), cores):
        found[task.number] = pair
        progress(len(found), len(tasks), f"{task.object_id}/{task.lift}")
    pairs = tuple(found[number] for number in sorted(found))
    lifted = {task: found[task.number][0] for task in tasks}
    soon = react_behind_wires(settings, wire_lifts, progress) if wire_lifts else ()
    further = run_further(settings, lifted, cores, progress) if full else ()
    limits = (*_limits(pairs), *soon, *further)
    return ReactionResult(settings.react.value, settings.seed, pairs, limits, time.perf_counter() - began)


def reaction_table(result: ReactionResult) -> BenchmarkTable:
    """Return a row per object, all first."""
    objects = dict.fromkeys(without.object_id for without, _ in result.pairs)
    groups = {"all": result.pairs} | {
        o: tuple(pair for pair in result.pairs if pair[0].object_id == o) for o in objects
    }
    columns = (
        "object", "lifts", "slip without", "caught", "largest grip cannot hold", "median end turn without",
        "with", "reactions", "counts added, middle, most", "fallen without, with", "damaged",
    )  # fmt: skip
    title = f"SIMULATED reaction to slip '{result.kind}', the same lifts without and with; turns in degrees"
    return BenchmarkTable(title, columns, [_row(name, pairs) for name, pairs in groups.items()])


def as_json(result: ReactionResult) -> dict[str, Any]:
    """Return the result as JSON values, with what it was measured on."""
    return {
        "schema": SCHEMA,
        "simulated": True,
        "react": result.kind,
        "seed": result.seed,
        "machine": machine(),
        "lifts": [{"without": asdict(without), "with": asdict(reacted)} for without, reacted in result.pairs],
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _row(name: str, pairs: Sequence[Pair]) -> tuple[str, ...]:
    slipping = [pair for pair in pairs if pair[0].slips]
    reacted = [after for _, after in pairs]
    fallen = [sum(lift.outcome is LiftOutcome.FALLEN for lift in side) for side in zip(*pairs, strict=True)]
    return (
        name,
        str(len(pairs)),
        str(len(slipping)),
        str(sum(after.caught for _, after in slipping)),
        str(sum(not after.would_hold for _, after in slipping)),
        _median_turn([before for before, _ in pairs]),
        _median_turn(reacted),
        str(sum(len(lift.told) for lift in reacted)),
        _added([lift.counts_added for lift in reacted]),
        f"{fallen[0]}, {fallen[1]}",
        str(sum(lift.damaged for lift in reacted)),
    )


def _added(counts: Sequence[int]) -> str:
    return f"{np.median(counts):.0f}, {max(counts)}" if counts else "-"


def _median_turn(lifts: Sequence[ReactedLift]) -> str:
    turns = [abs(lift.turn_deg) for lift in lifts if lift.turn_deg is not None]
    return f"{np.median(turns):.1f}" if turns else "-"


def _limits(pairs: Sequence[Pair]) -> tuple[Measured, ...]:
    slipping = [after for before, after in pairs if before.slips]
    held = [after for before, after in pairs if abs(before.turn_deg or 0.0) <= HELD_DEG and not before.slips]
    told = [reaction for _, after in pairs for reaction in after.told]
    latency = [1e3 * r.latency_s for r in told if r.latency_s is not None]
    late = sum(after.late for _, after in pairs)
    latency += [float("inf")] * late
    dropped = [after for after in slipping if after.would_hold and after.outcome is LiftOutcome.FALLEN]
    return (
        at_least(
            "share of slipping lifts caught",
            float(np.mean([after.caught for after in slipping])) if slipping else None,
            LEAST_CAUGHT,
        ),
        at_most(
            "true half degree to event, 99th percentile, ms",
            float(np.percentile(latency, 99)) if latency else None,
            MOST_LATENCY_MS,
        ),
        informative("events that never came", late),
        _false_reactions(held),
        informative("reactions to less than half a degree", sum(r.latency_s is None for r in told)),
        informative("reactions to an object that had not slipped", sum(not r.slipped for r in told)),
        at_most("fallen with a reaction where friction could carry it", len(dropped), 0),
        at_most("objects damaged", sum(after.damaged for _, after in pairs), 0),
    )


def _false_reactions(held: Sequence[ReactedLift]) -> Measured:
    name = f"share of lifts that hold and react all the same, of {len(held)}"
    if not held:
        return Measured(name, None, f"at most {MOST_FALSE:.3g}", None)
    return at_most(name, float(np.mean([bool(after.told) for after in held])), MOST_FALSE)
