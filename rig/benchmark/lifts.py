"""`rig benchmark lifts`: simulated lifts of many seeds, scored as in a trial.

Lifts on a bench in this process are scored with the angles that an estimator reported during the lift. Drawn
lifts are frames of a second renderer (`rig.benchmark.renderer`).
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import cv2

from drivers.errors import InputError, RigError
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import score_all
from rig.benchmark.harness import ALL, Cell, Report, Run, Study, Table, table_of
from rig.benchmark.measured import Measured, at_least, at_most, between
from rig.benchmark.renderer import draw_lift, kind_of
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
from rig.tactile.estimators import EstimatorChoice, choose_estimator
from rig.tactile.sample import EstimatorFaults, faults_of, together

FEW, MANY = 2, 20  # number of seeds, without and with --full
DRAWN = "drawn"
LIFTS, DRAWN_LIFTS = 5, 45  # of each object; of each seed of drawn lifts
LIFTS_PER_SEED = 1000  # seed n draws the lifts from 1000 n on
MARE_DEG = {"easy": 0.32, "hard": 0.6, DRAWN: 0.5}
WORST_DEG = {"easy": 2.2, "hard": 4.0, DRAWN: 3.0}
"""Limits by the difficulty of the bench, and of drawn lifts."""
ANSWERED, LEAST_WITHIN, MOST_WITHIN = 0.95, 0.90, 0.98
WHOLE_SET = 45  # of fewer lifts all answers may be within two sigma
TURNED_DEG = 5.0  # a lift whose object turned by more counts as turned
PlannedLift = tuple[int, str, int]  # seed, object or kind of face, and number


@dataclass(frozen=True, slots=True)
class LiftsOptions:
    of: str = option(
        "fake",
        "Lifts on the simulated bench fake or hard, on your bench file simulated in process, or drawn: by a "
        "second renderer.",
        "--of",
    )
    full: bool = option(False, f"{MANY} seeds instead of {FEW}.")
    seeds: int | None = option(None, "Number of seeds.", min=1, max=1000)
    objects: list[str] | None = option(
        None, "Id or name; repeat for more. Default: the trial's nine.", "--object"
    )
    lifts: int | None = option(
        None, f"Lifts of each object, or of each seed if drawn. Default: {LIFTS}, or {DRAWN_LIFTS}.",
        min=1, max=LIFTS_PER_SEED,
    )  # fmt: skip
    estimator: list[str] | None = option(
        None,
        "Repeat for more, also your own as package.module:Class; limits are for the first. Default: slip.",
    )


@dataclass(frozen=True, slots=True)
class LiftCase:
    """A lift with one estimator. object_id: of a drawn lift, the kind of face."""

    of: str
    estimator: str
    seed: int
    object_id: str
    lift: int

    def __str__(self) -> str:
        return f"{self.of}, {self.estimator}, seed {self.seed}, {self.object_id}/{self.lift}"


@dataclass(frozen=True, slots=True)
class ScoredLift:
    """A lift's score, and the rotation of its object. faults: failures of a lab's own estimator."""

    case: LiftCase
    score: SeriesScore
    turned_deg: float
    faults: EstimatorFaults | None = None


def measure(options: LiftsOptions, run: Run) -> Report:
    """Carry out SIMULATED lifts of several seeds; print errors and confidently wrong angles.

    A trial of 45 lifts takes two minutes on two cores. Recordings are deleted after they are scored. The
    second renderer shares no code with that of the simulated bench, and has another gel, LEDs, object faces
    and rotations: an estimator that is overfitted to the simulated bench has larger errors on its lifts.
    Several estimators get the same lifts. The exit code is 4 if the first one misses a limit.

    Examples:
      rig benchmark lifts
      rig benchmark lifts --full --out lifts --resume
      rig benchmark lifts --of hard --readme docs/measurements.md
      rig benchmark lifts --of drawn --seeds 1 --estimator slip --estimator ecc --json
      rig benchmark lifts --of my_twin.toml --seeds 1
      rig benchmark lifts --full --engine dask://HOST:PORT --out lifts --resume
    """
    choices = {choice.name: choice for choice in map(choose_estimator, options.estimator or ["slip"])}
    seeds = range(run.seed, run.seed + (options.seeds or (MANY if options.full else FEW)))
    bench = None if options.of == DRAWN else load_calibrated_bench(options.of, run.say)
    lifts = drawn_lifts(options, seeds) if bench is None else bench_lifts(options, seeds, bench)
    name, difficulty = (DRAWN, DRAWN) if bench is None else (bench.name, bench.difficulty)
    cases = [LiftCase(name, *case) for case in ((choice, *lift) for choice in choices for lift in lifts)]
    scored = run.each(partial(carry_out, bench, choices), cases, stored=ScoredLift)
    by_name = {choice: [lift for lift in scored if lift.case.estimator == choice] for choice in choices}
    failed = {choice: [lift.faults for lift in of if lift.faults] for choice, of in by_name.items()}
    first, table = next(iter(choices)), lifts_table(name, by_name)
    return Report(
        tables=(table,),
        limits=judge_lifts(difficulty, by_name[first]),
        limits_of=f"'{first}'",
        section=f"{table.title}.\n\n{table.markdown()}",
        faults={choice: together(faults) for choice, faults in failed.items() if faults},
    )


def bench_lifts(options: LiftsOptions, seeds: Sequence[int], bench: BenchConfig) -> list[PlannedLift]:
    """Plan the lifts on a bench. Raises `InputError` if it is not simulated in this process."""
    if not bench.in_process:
        raise InputError(f"bench '{bench.name}': give a bench that is simulated in this process")
    objects = resolve_objects(options.objects or [], bench.objects)
    return list(product(seeds, objects, range(1, (options.lifts or LIFTS) + 1)))


def drawn_lifts(options: LiftsOptions, seeds: Sequence[int]) -> list[PlannedLift]:
    """Plan drawn lifts. Raises `InputError` if objects are given."""
    if options.objects:
        raise InputError("--object: drawn lifts have faces instead of objects; leave it out")
    numbers = product(seeds, range(options.lifts or DRAWN_LIFTS))
    return [(seed, kind_of(at), at) for seed, at in ((s, LIFTS_PER_SEED * s + n) for s, n in numbers)]


def carry_out(
    bench: BenchConfig | None, choices: Mapping[str, EstimatorChoice], case: LiftCase
) -> ScoredLift:
    """Carry out one lift and score its online angles, or draw one. Runs in a worker process.

    bench: None for a drawn lift. Raises `RigError` if every attempt on the bench ends with a fault.
    """
    choice = choices[case.estimator]
    if bench is None:
        return score_drawn_lift(case, choice)
    settings, fault = TrialSettings(bench, case.seed, choice), None
    for attempt in range(MAX_FAULTS_IN_A_ROW):
        with tempfile.TemporaryDirectory(prefix="rig_lifts_") as folder:
            task = LiftTask(1, case.object_id, case.lift, attempt=attempt)
            done = attempt_lift(settings, task, folder=Path(folder))
            recording, fault = done.files.get(task.recording), done.fault
            if done.row.accepted and isinstance(recording, Path):
                return score_lift(case, recording, done.row)
    raise RigError(
        f"{case}: each of {MAX_FAULTS_IN_A_ROW} attempts ended with a fault; the last one: {fault}"
    )


def score_lift(case: LiftCase, recording: Path, row: Lift) -> ScoredLift:
    phases, truth = phase_times(recording), recorded_truth(recording)
    fused = recorded_angles(recording, FUSED)[FUSED].between(phases[Phase.LIFT], phases[Phase.LOWER])
    true_deg = truth.at(fused.time_s)
    score = score_angles(f"{row.object}/{row.lift}", fused, true_deg, phases[Phase.HOLD])
    return ScoredLift(case, score, row.final_truth_deg or 0.0, row.estimator_faults)


def score_drawn_lift(case: LiftCase, choice: EstimatorChoice) -> ScoredLift:
    cv2.setNumThreads(1)
    lift = draw_lift(case.lift)
    passes = lift.passes(lambda tip: {choice.name: choice.make(tip.background, tip.aspect, tip.sign)})
    samples = passes[choice.name]
    faults = faults_of(sample for tip in samples.values() for sample in tip)
    return ScoredLift(case, lift.score(samples), float(lift.truth.angle_deg[-1]), faults)


def lifts_table(of: str, by_estimator: Mapping[str, Sequence[ScoredLift]]) -> Table:
    """Return a row per estimator for all lifts, then one per seed, or per kind of face of drawn lifts."""
    rows = []
    for name, lifts in by_estimator.items():
        groups: dict[str, list[ScoredLift]] = {}
        for lift in lifts:
            group = lift.case.object_id if of == DRAWN else str(lift.case.seed)
            groups.setdefault(group, []).append(lift)
        for group, found in {ALL: lifts, **(groups if len(groups) > 1 else {})}.items():
            shown = (name if group == ALL else "") if len(by_estimator) > 1 else None
            rows.append([Cell("estimator", shown, "estimator", optional=True), *_row(of, group, found)])
    with_estimator = f" with '{next(iter(by_estimator))}'" if len(by_estimator) == 1 else ""
    title = f"SIMULATED lifts of '{of}'{with_estimator}: rotational error in degrees, {HEADING}"
    return table_of(title, rows, left=2 if len(by_estimator) > 1 else 1)


def _row(of: str, group: str, lifts: Sequence[ScoredLift]) -> list[Cell]:
    score = score_all([lift.score for lift in lifts])
    turned, two_sigma = sum(abs(lift.turned_deg) > TURNED_DEG for lift in lifts), score.within_two_sigma
    turned_doc = "lifts whose object turned by more than 5 degrees"
    worst, wrong = "largest mean error of a lift in degrees, and the lift", "lifts with such an answer"
    heading = "face" if of == DRAWN else "seed"
    return [
        Cell(heading, group, heading),
        Cell("lifts", len(lifts), "lifts"),
        Cell("turned", turned, "turned", doc=turned_doc),
        Cell("mare_b", score.mare_b, "MARE, B", mare_text, "degrees, over phase B"),
        Cell("mare", score.mare, "MARE, B and C", mare_text, "degrees, over phases B and C"),
        Cell("worst", score.worst_text, "worst lift", doc=worst),
        Cell("answered", score.answered, "answered", ".1%", "share of the frames with an angle"),
        Cell("within_two_sigma", two_sigma, "within 2 sigma", ".0%", "share of the answers"),
        Cell("confidently_wrong", score.wrong_if_sigma, "confidently wrong", doc=wrong),
    ]


def judge_lifts(difficulty: str, lifts: Sequence[ScoredLift]) -> tuple[Measured, ...]:
    overall = score_all([lift.score for lift in lifts])
    within, most = overall.within_two_sigma, MOST_WITHIN if len(lifts) >= WHOLE_SET else 1.0
    return (
        at_most("MARE, degrees", overall.mare_deg, MARE_DEG[difficulty]),
        at_most("worst lift, degrees", overall.worst_deg, WORST_DEG[difficulty]),
        at_least("share of frames answered", overall.answered, ANSWERED),
        between("share of answers within two sigma", within, LEAST_WITHIN, most),
        at_most("lifts with an answer that is confidently wrong", overall.wrong_if_sigma, 0),
    )


def section(options: LiftsOptions) -> str:
    bench = None if options.of == DRAWN else load_calibrated_bench(options.of, lambda _: None)
    return f"lifts {DRAWN if bench is None else bench.name}"


SHARED = ("out", "resume", "readme", "jobs", "seed", "engine")
STUDY = Study("lifts", LiftsOptions, measure, "lifts", SHARED, section, keeps_results=True)
