"""`rig benchmark seeds`: the trial's lifts for many seeds, scored with the angles reported during them."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

from drivers.errors import InputError, RigError
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import score_all
from rig.benchmark.harness import ALL, Cell, Report, Run, Study, Table, table_of
from rig.benchmark.measured import Measured, at_least, at_most
from rig.config import BenchConfig
from rig.config.calibrations import load_calibrated_bench
from rig.declared import option
from rig.experiments.attempts import MAX_FAULTS_IN_A_ROW
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.experiments.trial import resolve_objects
from rig.lift.recording import recorded_truth
from rig.results.metrics import HEADING, mare_text
from rig.results.scores import SeriesScore, score_angles
from rig.sessions.reading import phase_times, recorded_angles
from rig.sessions.records import Lift
from rig.tactile.angles import FUSED
from rig.tactile.estimators import choose_estimator

FEW, MANY = 2, 20  # number of seeds, without and with --full
MARE_DEG, WORST_DEG = {"easy": 0.32, "hard": 0.6}, {"easy": 2.2, "hard": 4.0}
"""Limits by the difficulty of the bench."""
ANSWERED = 0.95
TURNED_DEG = 5.0  # a lift whose object turned by more counts as turned


@dataclass(frozen=True, slots=True)
class SeedsOptions:
    full: bool = option(False, f"{MANY} seeds instead of {FEW}.")
    seeds: int | None = option(None, "Number of seeds.", min=1, max=1000)
    bench: str = option("fake", "fake, hard, or the path of a bench file simulated in process.")
    objects: list[str] | None = option(
        None, "Id or name; repeat for more. Default: the trial's nine.", "--object"
    )
    lifts: int = option(5, "Lifts of each object.", min=1, max=100)


@dataclass(frozen=True, slots=True)
class LiftCase:
    bench: str
    seed: int
    object_id: str
    lift: int

    def __str__(self) -> str:
        return f"{self.bench}, seed {self.seed}, {self.object_id}/{self.lift}"


@dataclass(frozen=True, slots=True)
class SeedLift:
    """One lift: its score, and the rotation of the object."""

    seed: int
    score: SeriesScore
    turned_deg: float


def measure(options: SeedsOptions, run: Run) -> Report:
    """Carry out SIMULATED trials of several seeds; print errors and confidently wrong angles.

    The estimator is slip. A trial of 45 lifts takes two minutes on two cores. Recordings are deleted after
    they are scored. The exit code is 4 if a limit is missed.

    Examples:
      rig benchmark seeds
      rig benchmark seeds --full --out seeds --resume
      rig benchmark seeds --bench hard --readme docs/measurements.md
      rig benchmark seeds --bench my_twin.toml --seeds 1
      rig benchmark seeds --full --engine dask://HOST:PORT --out seeds --resume
    """
    bench = load_calibrated_bench(options.bench, run.say)
    if not bench.in_process:
        raise InputError(f"bench '{bench.name}': give a bench that is simulated in this process")
    objects = resolve_objects(options.objects or [], bench.objects)
    seeds = range(run.seed, run.seed + (options.seeds or (MANY if options.full else FEW)))
    cases = lift_cases(bench.name, seeds, objects, options.lifts)
    lifts = run.each(partial(carry_out, bench), cases, stored=SeedLift)
    table = seeds_table(bench.name, lifts)
    section = f"{table.title}.\n\n{table.markdown()}"
    return Report((table,), judge_lifts(bench.difficulty, lifts), "slip", section=section)


def lift_cases(bench: str, seeds: Sequence[int], objects: Sequence[str], lifts: int) -> list[LiftCase]:
    return [LiftCase(bench, *of) for of in product(seeds, objects, range(1, lifts + 1))]


def carry_out(bench: BenchConfig, case: LiftCase) -> SeedLift:
    """Carry out one lift with slip and score its online angles. Runs in a worker process.

    Raises `RigError` if every attempt ends with a fault.
    """
    settings, fault = TrialSettings(bench, case.seed, choose_estimator()), None
    for attempt in range(MAX_FAULTS_IN_A_ROW):
        with tempfile.TemporaryDirectory(prefix="rig_seeds_") as folder:
            task = LiftTask(1, case.object_id, case.lift, attempt=attempt)
            done = attempt_lift(settings, task, folder=Path(folder))
            recording, fault = done.files.get(task.recording), done.fault
            if done.row.accepted and isinstance(recording, Path):
                return score_lift(recording, case.seed, done.row)
    raise RigError(
        f"{case}: each of {MAX_FAULTS_IN_A_ROW} attempts ended with a fault; the last one: {fault}"
    )


def score_lift(recording: Path, seed: int, row: Lift) -> SeedLift:
    phases, truth = phase_times(recording), recorded_truth(recording)
    fused = recorded_angles(recording, FUSED)[FUSED].between(phases[Phase.LIFT], phases[Phase.LOWER])
    true_deg = truth.at(fused.time_s)
    score = score_angles(f"{row.object}/{row.lift}", fused, true_deg, phases[Phase.HOLD])
    return SeedLift(seed, score, row.final_truth_deg or 0.0)


def seeds_table(bench: str, lifts: Sequence[SeedLift]) -> Table:
    seeds = dict.fromkeys(lift.seed for lift in lifts)
    by_seed = {str(seed): [lift for lift in lifts if lift.seed == seed] for seed in seeds}
    rows = []
    for name, of in {ALL: lifts, **(by_seed if len(seeds) > 1 else {})}.items():
        score = score_all([lift.score for lift in of])
        turned, two_sigma = sum(abs(lift.turned_deg) > TURNED_DEG for lift in of), score.within_two_sigma
        turned_doc = "lifts whose object turned by more than 5 degrees"
        worst, wrong = "largest mean error of a lift in degrees, and the lift", "lifts with such an answer"
        row = [
            Cell("seed", name, "seed"),
            Cell("lifts", len(of), "lifts"),
            Cell("turned", turned, "turned", doc=turned_doc),
            Cell("mare_b", score.mare_b, "MARE, B", mare_text, "degrees, over phase B"),
            Cell("mare", score.mare, "MARE, B and C", mare_text, "degrees, over phases B and C"),
            Cell("worst", score.worst_text, "worst lift", doc=worst),
            Cell("answered", score.answered, "answered", ".1%", "share of the frames with an angle"),
            Cell("within_two_sigma", two_sigma, "within 2 sigma", ".0%", "share of the answers"),
            Cell("confidently_wrong", score.wrong_lifts, "confidently wrong", doc=wrong),
        ]
        rows.append(row)
    return table_of(f"SIMULATED on bench '{bench}': rotational error in degrees, {HEADING}", rows)


def judge_lifts(difficulty: str, lifts: Sequence[SeedLift]) -> tuple[Measured, ...]:
    overall = score_all([lift.score for lift in lifts])
    return (
        at_most("MARE, degrees", overall.mare_deg, MARE_DEG[difficulty]),
        at_most("worst lift, degrees", overall.worst_deg, WORST_DEG[difficulty]),
        at_least("share of frames answered", overall.answered, ANSWERED),
        at_most("lifts with an answer that is confidently wrong", overall.wrong_lifts, 0),
    )


def section(options: SeedsOptions) -> str:
    return f"seeds {load_calibrated_bench(options.bench, lambda _: None).name}"


SHARED = ("out", "resume", "readme", "jobs", "seed", "engine")
STUDY = Study("seeds", SeedsOptions, measure, "lifts", SHARED, section, keeps_results=True)
