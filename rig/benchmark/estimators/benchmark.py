"""`rig benchmark estimators`: run time against error, on lifts and under stress, in one run."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from protocols.grasps import TRIAL_OBJECTS
from rig.benchmark.estimators.contenders import CONTENDERS
from rig.benchmark.estimators.endurance import Endurance, measure_endurance
from rig.benchmark.estimators.lifts import LiftScores, Tips, score_lift, session_lifts
from rig.benchmark.estimators.limits import closest_of_paper, judge
from rig.benchmark.estimators.scores import ContenderScore, score_all
from rig.benchmark.estimators.stress import (
    NAMES,
    StressedClip,
    StressRow,
    run_stress,
    stress_rows,
    stress_tasks,
)
from rig.benchmark.estimators.timing import TimingReport, time_lifts
from rig.benchmark.harness import machine
from rig.benchmark.measured import Measured
from rig.config import load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.process_pool import run_tasks
from rig.experiments.stored_trial import stored_trial
from rig.experiments.trial import run_trial
from rig.sessions.manifest import is_session
from rig.sessions.records import FinishedLift, LiftRow
from rig.tactile.estimators import choose_estimator
from rig.tactile.foreign import EstimatorFaults, together

SCHEMA = 1
LIFTS, FULL_LIFTS = 5, 10
TIMED_LIFTS, FULL_TIMED_LIFTS = 5, 18

Progress = Callable[[str, int, int, str], None]
"""Called with the part of the run, how far it is, of how many, and what came of the last piece."""


@dataclass(frozen=True, slots=True)
class BenchmarkSettings:
    """What to run.

    session: a finished trial to use the lifts of; None records them in `out`/session, and goes on
    there where that was interrupted. jobs: worker processes; timing always has one. groups: of
    stress conditions, all when None. more: estimators beside the rig's own, by name.
    """

    out: Path
    session: Path | None = None
    seed: int = 0
    full: bool = False
    jobs: int = 2
    objects: tuple[str, ...] = TRIAL_OBJECTS
    lifts: int | None = None
    timed_lifts: int | None = None
    groups: tuple[str, ...] | None = None
    more: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All that are compared."""
        return tuple(dict.fromkeys((*CONTENDERS, *self.more)))


@dataclass(frozen=True, slots=True)
class BenchmarkResult:
    """Everything measured.

    scores: by estimator and window, over all lifts. endurance: in a long run only. faults: where estimators
    that are not the rig's own failed on frames of lifts, by name.
    """

    session: Path
    simulated: bool
    settings: BenchmarkSettings
    lifts: int
    scores: dict[tuple[str, int], ContenderScore]
    by_object: dict[str, dict[str, ContenderScore]]
    skip_gap_deg: float
    skip_apart: int
    skipped: dict[str, float]
    timing: TimingReport
    endurance: Endurance | None
    stress: list[StressRow]
    limits: list[Measured]
    wall_s: float
    faults: dict[str, EstimatorFaults]

    @property
    def closest_of_paper(self) -> tuple[str, int] | None:
        """The one of the paper's methods and windows that is best on these lifts."""
        return closest_of_paper(self.scores)


def run_benchmark(settings: BenchmarkSettings, progress: Progress = lambda *_: None) -> BenchmarkResult:
    """Record or read the lifts, time and score every estimator on them, and put them under stress.

    Raises `SessionError` for a session without lifts, `InputError` for an unknown estimator, and what
    `run_trial` raises.
    """
    began = time.perf_counter()
    for name in settings.more:
        choose_estimator(name)
    folder = settings.session or _recorded(settings, progress)
    tips, rows = session_lifts(folder)
    timed = _spread_out(rows, settings.timed_lifts or (FULL_TIMED_LIFTS if settings.full else TIMED_LIFTS))
    # Timed first and alone: worker processes beside it would share its core.
    timing = time_lifts(folder, tips, timed, partial(progress, "timing"), settings.names)
    lifts = _lifts(folder, tips, rows, settings, progress)
    stress = _stress(settings, progress)
    endurance = _endurance(settings.seed, progress) if settings.full else None
    scores = {key: score_all([lift.scores[key] for lift in lifts]) for key in lifts[0].scores}
    gap, apart = max(lift.skip_gap_deg for lift in lifts), sum(lift.skip_apart for lift in lifts)
    return BenchmarkResult(
        session=folder,
        simulated=stored_trial(folder).manifest.simulated,
        settings=settings,
        lifts=len(lifts),
        scores=scores,
        by_object=_by_object(lifts),
        skip_gap_deg=gap,
        skip_apart=apart,
        skipped=_skipped(lifts),
        timing=timing,
        endurance=endurance,
        stress=stress,
        limits=judge(scores, timing, gap, apart, stress, endurance),
        wall_s=time.perf_counter() - began,
        faults=_faults(lifts),
    )


def _faults(lifts: Sequence[LiftScores]) -> dict[str, EstimatorFaults]:
    names = dict.fromkeys(name for lift in lifts for name in lift.faults)
    return {name: together([lift.faults[name] for lift in lifts if name in lift.faults]) for name in names}


def _endurance(seed: int, progress: Progress) -> Endurance:
    return measure_endurance(
        seed, progress=lambda done, total: progress("an hour at rest", done, total, f"frame {done}")
    )


def as_json(result: BenchmarkResult) -> dict[str, object]:
    """Return the result as JSON values, with what it was measured on."""
    best = result.closest_of_paper
    return {
        "schema": SCHEMA,
        "simulated": result.simulated,
        "session": str(result.session),
        "seed": result.settings.seed,
        "full": result.settings.full,
        "lifts": result.lifts,
        "machine": machine(),
        "estimators": [_row(result, *key) for key in result.scores],
        "closest_of_paper": None if best is None else {"estimator": best[0], "window": best[1]},
        "objects": {
            name: {key: asdict(score) for key, score in of.items()} for name, of in result.by_object.items()
        },
        "timing": asdict(result.timing),
        "skipping": {
            "time_saved": result.timing.skip_saves,
            "largest_difference_deg": result.skip_gap_deg,
            "answered_by_one_only": result.skip_apart,
            "skipped_share": result.skipped,
        },
        "endurance": asdict(result.endurance) if result.endurance else None,
        "stress": [asdict(row) for row in result.stress],
        "faults": {name: asdict(faults) for name, faults in result.faults.items()},
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _recorded(settings: BenchmarkSettings, progress: Progress) -> Path:
    """Carry out the simulated lifts, or those that are missing."""
    folder = settings.out / "session"
    lifts = settings.lifts or (FULL_LIFTS if settings.full else LIFTS)
    trial = TrialSettings(load_bench("fake"), settings.seed, choose_estimator())

    def show(done: int, total: int, row: LiftRow) -> None:
        progress("lifts", done, total, f"{row.object}/{row.lift} {row.outcome}")

    resume = is_session(folder)
    run_trial(folder, trial, list(settings.objects), lifts, settings.jobs, resume, progress=show)
    return folder


def _lifts(
    folder: Path, tips: Tips, rows: list[FinishedLift], settings: BenchmarkSettings, progress: Progress
) -> list[LiftScores]:
    found: dict[int, LiftScores] = {}
    for row, scores in run_tasks(
        partial(score_lift, folder, tips, settings.names), list(rows), settings.jobs
    ):
        found[row.number] = scores
        progress("estimators", len(found), len(rows), f"{row.object}/{row.lift}")
    return [found[row.number] for row in rows]


def _stress(settings: BenchmarkSettings, progress: Progress) -> list[StressRow]:
    stressed = tuple(dict.fromkeys((*NAMES, *settings.more)))
    tasks = stress_tasks(settings.full, settings.seed, stressed)
    tasks = [task for task in tasks if settings.groups is None or task.group in settings.groups]
    done: dict[int, list[StressedClip]] = {}
    order = {task: place for place, task in enumerate(tasks)}
    for task, scores in run_tasks(run_stress, list(tasks), settings.jobs):
        done[order[task]] = scores
        progress("stress", len(done), len(tasks), f"{task.group}, {task.contact}")
    return stress_rows([score for place in sorted(done) for score in done[place]], settings.full)


def _spread_out(rows: Sequence[FinishedLift], wanted: int) -> list[FinishedLift]:
    """Return some of the lifts, evenly spread, so that all kinds of objects are among them."""
    wanted = min(wanted, len(rows))
    return [rows[i * len(rows) // wanted + (i % 2) * (len(rows) // wanted // 2)] for i in range(wanted)]


def _by_object(lifts: Sequence[LiftScores]) -> dict[str, dict[str, ContenderScore]]:
    """Return unfiltered scores by object and estimator."""
    names = [name for name, window in lifts[0].scores if window == 1]
    objects = dict.fromkeys(_object(lift) for lift in lifts)
    return {
        o: {n: score_all([lift.scores[n, 1] for lift in lifts if _object(lift) == o]) for n in names}
        for o in objects
    }


def _object(lift: LiftScores) -> str:
    return next(iter(lift.scores.values())).key.partition("/")[0]


def _skipped(lifts: Sequence[LiftScores]) -> dict[str, float]:
    """Share of frames in which each stage was left out."""
    frames = sum(lift.frames for lift in lifts)
    stages = dict.fromkeys(stage for lift in lifts for stage in lift.skipped)
    return {stage: sum(lift.skipped.get(stage, 0) for lift in lifts) / frames for stage in stages}


def _row(result: BenchmarkResult, name: str, window: int) -> dict[str, object]:
    timing = result.timing.contenders[name].contact
    return {
        "estimator": name,
        "window": window,
        **asdict(result.scores[name, window]),
        "p50_ms": timing.p50_ms,
        "p99_ms": timing.p99_ms,
    }
