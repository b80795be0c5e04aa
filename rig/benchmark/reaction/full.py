"""What `rig benchmark reaction --full` looks at further: lifts that hold, hours at rest, faults."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.stats import poisson

from rig.benchmark.measured import Measured, at_most
from rig.benchmark.reaction.lifts import MOST_FALSE, ReactedLift, lift_once
from rig.benchmark.reaction.rest import RATES_PER_HOUR, Rest, false_reactions, watch_at_rest
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.faults import IN_REACTION, FaultResult, run_faults
from rig.experiments.lift_attempt import LiftTask, TrialSettings
from rig.experiments.process_pool import run_tasks

HOURS = 2.0
SURE = 0.95
SPARE_COUNTS = 2
"""So much firmer than just firm enough."""
Progress = Callable[[int, int, str], None]
Result = TypeVar("Result")


def run_further(
    settings: TrialSettings,
    lifted: Mapping[LiftTask, ReactedLift],
    jobs: int,
    progress: Progress = lambda *_: None,
) -> tuple[Measured, ...]:
    """Return what was measured, the faults behind wires and in real time. SIMULATED throughout.

    lifted: the lifts that were looked at so far; they are repeated with a grip that just holds.
    Raises `DeviceError` as `run_faults`.
    """
    held = _all(partial(lift_once, settings), just_holding(lifted), jobs, progress)
    rests = _all(
        partial(watch_at_rest, settings), [task for task in lifted if task.lift == 1], jobs, progress
    )
    return (_held(held), *at_rest(rests, HOURS), _ends(_faults(settings, progress)))


def at_rest(rests: Sequence[Rest], hours: float) -> tuple[Measured, ...]:
    """Return how often a resting object was reacted to, at each rate that may be asked for.

    What is asked is the upper end of the count's Poisson interval: a slip is told of no angle below the one
    that a gel gives way by, however little noise there is, so that there may be fewer.
    """
    rows = []
    for rate in RATES_PER_HOUR:
        most = float(poisson.interval(SURE, hours * rate)[1])
        name = f"reactions in {hours:g} hours at rest with drift, {rate:g} an hour accepted"
        rows.append(at_most(name, false_reactions(rests, hours, rate), most))
    return tuple(rows)


def _faults(settings: TrialSettings, progress: Progress) -> list[FaultResult]:
    """Every fault of `rig benchmark faults`, each while a reaction closes the fingers."""
    done: list[FaultResult] = []

    def note(result: FaultResult) -> None:
        done.append(result)
        progress(len(done), len(CASES), result.case.name)

    with tempfile.TemporaryDirectory() as folder:
        cases = [(case, IN_REACTION) for case in CASES]
        return run_faults(Path(folder) / "faults", cases, note, react=settings.react)


def just_holding(lifted: Mapping[LiftTask, ReactedLift]) -> list[LiftTask]:
    """Return the lifts that a grip can hold, with one that just does."""
    return [
        replace(task, grip_counts=lift.holds_from + SPARE_COUNTS)
        for task, lift in lifted.items()
        if lift.holds_from is not None
    ]


def _held(lifts: Sequence[ReactedLift]) -> Measured:
    name = f"share of lifts with a grip that just holds that react all the same, of {len(lifts)}"
    return at_most(name, float(np.mean([bool(lift.told) for lift in lifts])) if lifts else None, MOST_FALSE)


def _ends(faults: Sequence[FaultResult]) -> Measured:
    """What `rig benchmark faults` asks of each fault is asked of it in a reaction."""
    otherwise = [fault.case.name for fault in faults if not fault.passed]
    named = f" ({', '.join(otherwise)})" if otherwise else ""
    return at_most(
        f"of {len(faults)} faults in a reaction, end otherwise than without{named}", len(otherwise), 0
    )


def _all(
    work: Callable[[LiftTask], Result], tasks: list[LiftTask], jobs: int, progress: Progress
) -> list[Result]:
    results = []
    for task, result in run_tasks(work, list(tasks), jobs):
        results.append(result)
        progress(len(results), len(tasks), task.name)
    return results
