"""`rig benchmark estimators`: measure run time and error of every estimator, on lifts and disturbed clips."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from protocols.grasps import TRIAL_OBJECTS
from rig.benchmark.estimators.contenders import CONTENDERS
from rig.benchmark.estimators.lifts import LiftScores, score_lift
from rig.benchmark.estimators.scores import score_all
from rig.benchmark.estimators.stress import NAMES, run_stress, stress_rows, stress_tasks
from rig.benchmark.estimators.tables import (
    EstimatorsResult,
    estimator_table,
    judge,
    notes,
    readme_section,
    stress_table,
    time_table,
)
from rig.benchmark.estimators.timing import time_lifts
from rig.benchmark.harness import Report, Run, Study, option
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import TrialSettings, stored_trial
from rig.experiments.trial import run_trial
from rig.sessions.manifest import is_session
from rig.sessions.records import FinishedLift, LiftRow
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import DEFAULT_ESTIMATOR, EstimatorChoice, choose_estimator
from rig.tactile.sample import EstimatorFaults, together

LIFTS = 5
"""Lifts of each object that are recorded."""
TIMED_LIFTS = 5
TABLE = "table.md"


@dataclass(frozen=True, slots=True)
class EstimatorsOptions:
    """Options of `rig benchmark estimators`."""

    session: Path | None = option(None, "Trial whose lifts are used. Default: record 45 simulated lifts.")
    estimator: list[str] | None = option(
        None, "Additional estimator to compare, as package.module:Class; repeat for more."
    )


def measure(options: EstimatorsOptions, run: Run) -> Report:
    """Measure run time and error of every estimator, on 45 lifts and on disturbed clips.

    It takes about 8 minutes on two idle cores. Run time is measured in one process and one thread; errors are
    computed for every window. The folder of the results holds results.json, table.md and the recorded lifts;
    an interrupted recording continues there. The exit code is 4 if the default estimator misses a limit.

    Examples:
      rig benchmark

      rig benchmark estimators --session sessions/2026-11-21T093000_trial --out benchmark

      rig benchmark estimators --readme docs/measurements.md

      rig benchmark estimators --estimator my_lab.rotation:MyEstimator --out benchmark

    """
    return report_of(compare(options, run))


def compare(options: EstimatorsOptions, run: Run) -> EstimatorsResult:
    """Record or read the lifts; measure run time and error of every estimator on lifts and disturbed clips.

    Raises `SessionError` for a session without lifts, `InputError` for an unknown estimator, and the errors
    of `run_trial`.
    """
    more = tuple(options.estimator or ())
    for name in more:
        choose_estimator(name)
    names, stressed = (tuple(dict.fromkeys((*of, *more))) for of in (CONTENDERS, NAMES))
    folder = options.session or record(
        run, "session", load_bench("fake"), choose_estimator(), TRIAL_OBJECTS, LIFTS
    )
    rows = read_finished_lifts(folder)
    # Run time is measured first and alone, because worker processes would compete for the core.
    timed = _spread_out(rows, TIMED_LIFTS)
    timing = time_lifts(folder, timed, run.progress, names)
    lifts = run.each(
        partial(score_lift, folder, names), rows, lambda row: f"estimators on {row.object}/{row.lift}"
    )
    clips = run.each(run_stress, stress_tasks(run.seed, stressed))
    return EstimatorsResult(
        session=folder,
        simulated=stored_trial(folder).manifest.simulated,
        seed=run.seed,
        more=more,
        lifts=lifts,
        scores={key: score_all([lift.scores[key] for lift in lifts]) for key in lifts[0].scores},
        timing=timing,
        stress=stress_rows([clip for of in clips for clip in of]),
    )


def report_of(result: EstimatorsResult) -> Report:
    """Return tables, limits and files."""
    limits = judge(result)
    whose, section = f"'{DEFAULT_ESTIMATOR}'", readme_section(result, limits)
    tables = (time_table(result), stress_table(result), estimator_table(result))
    return Report(
        tables=tables,
        limits=limits,
        limits_of=whose,
        notes=notes(result),
        section=section,
        figures=_figures(result),
        files={TABLE: section + "\n"},
        faults=_faults(result.lifts),
    )


def _figures(result: EstimatorsResult) -> dict[str, Any]:
    """Return the JSON values that the tables do not show."""
    best = result.closest_of_paper
    return {
        "simulated": result.simulated,
        "session": str(result.session),
        "lifts": len(result.lifts),
        "estimators": [_by_window(result, *key) for key in result.scores],
        "closest_of_paper": None if best is None else {"estimator": best[0], "window": best[1]},
        "timing": asdict(result.timing),
        "skipped_share": result.skipped,
    }


def record(
    run: Run, name: str, bench: BenchConfig, estimator: EstimatorChoice, objects: Sequence[str], lifts: int
) -> Path:
    """Carry out the missing simulated lifts of a session in the folder of the results; return its folder.

    name: of the session. lifts: per object. Raises the errors of `run_trial`.
    """
    folder = (run.folder or Path()) / name
    trial = TrialSettings(bench, run.seed, estimator)

    def show(done: int, total: int, row: LiftRow) -> None:
        run.progress(done, total, f"{name}: {row.object}/{row.lift} {row.outcome}")

    run_trial(folder, trial, list(objects), lifts, run.workers, is_session(folder), progress=show)
    return folder


def _faults(lifts: Sequence[LiftScores]) -> dict[str, EstimatorFaults]:
    names = dict.fromkeys(name for lift in lifts for name in lift.faults)
    return {name: together([lift.faults[name] for lift in lifts if name in lift.faults]) for name in names}


def _spread_out(rows: Sequence[FinishedLift], wanted: int) -> list[FinishedLift]:
    """Return evenly spread lifts, so that they include all kinds of objects. wanted: their number."""
    wanted = min(wanted, len(rows))
    return [rows[i * len(rows) // wanted + (i % 2) * (len(rows) // wanted // 2)] for i in range(wanted)]


def _by_window(result: EstimatorsResult, name: str, window: int) -> dict[str, Any]:
    cost = result.timing.contenders[name].contact
    score = asdict(result.scores[name, window])
    return {"estimator": name, "window": window, **score, "p50_ms": cost.p50_ms, "p99_ms": cost.p99_ms}


STUDY = Study(
    name="estimators",
    options=EstimatorsOptions,
    measure=measure,
    cases="steps",
    shared=("out", "readme", "jobs", "seed"),
    keeps_results=True,
    simulated=False,
)
