"""Simulated trials of one seed after the other: the errors of their lifts, and confidently wrong answers."""

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError, counted
from protocols.grasps import TRIAL_OBJECTS
from protocols.observer import Phase
from rig.benchmark.estimators.benchmark import machine
from rig.benchmark.estimators.scores import SeriesScore, score_all, score_series
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.measured import Measured, at_least, at_most
from rig.benchmark.wrong_answers import is_confidently_wrong
from rig.config import BenchConfig
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.trial import run_trial
from rig.lift.marker_truth import interpolate
from rig.lift.recorded_truth import recorded_truth
from rig.results.metrics import HEADING, mare_text
from rig.sessions.codec import Codec, json_line
from rig.sessions.files import append_line
from rig.sessions.manifest import is_session
from rig.sessions.reading import phase_times, recorded_angles
from rig.sessions.recorder import FUSED_TOPIC
from rig.sessions.records import FinishedLift
from rig.sessions.rows import read_finished_lifts, read_rows
from rig.tactile.estimators import choose_estimator

SCHEMA = 2
SEEDS = "seeds.jsonl"
LIFTS = 5
MARE_DEG, WORST_DEG = {"easy": 0.32, "hard": 0.6}, {"easy": 2.2, "hard": 4.0}
"""By the difficulty of the bench."""
ANSWERED = 0.95
TURNED_DEG = 5.0


@dataclass(frozen=True, slots=True)
class SeedLift:
    """One lift of a trial: its score, how far it turned, and how many frames are confidently wrong.

    See `rig.benchmark.wrong_answers`.
    """

    seed: int
    score: SeriesScore
    turned_deg: float
    confidently_wrong: int


@dataclass(frozen=True, slots=True)
class SeedTrial:
    """All lifts of one seed: a line of `SEEDS`, written when the trial is done."""

    seed: int
    lifts: tuple[SeedLift, ...]


TRIAL: Codec[SeedTrial] = Codec(SeedTrial)


@dataclass(frozen=True, slots=True)
class SeedsResult:
    """All lifts of all seeds."""

    bench: str
    lifts: tuple[SeedLift, ...]
    limits: tuple[Measured, ...]
    wall_s: float


def run_seeds(
    folder: Path,
    bench: BenchConfig,
    seeds: Sequence[int],
    jobs: int,
    resume: bool = False,
    objects: Sequence[str] = TRIAL_OBJECTS,
    lifts: int = LIFTS,
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> SeedsResult:
    """Carry out the trials that a folder does not hold yet, each lift scored as it was answered online.

    Of a trial that is done the recordings go: 45 lifts take 0.9 GB. Raises `InputError` for a bench that is
    not simulated in this process, or a folder that holds results and is not to be resumed; and what
    `run_trial` raises.
    """
    began = time.perf_counter()
    if not bench.in_process:
        raise InputError(f"bench '{bench.name}': seeds are drawn by benches simulated in this process alone")
    folder.mkdir(parents=True, exist_ok=True)
    told = {trial.seed: trial.lifts for trial in read_rows(folder / SEEDS, TRIAL)}
    if told and not resume:
        raise InputError(
            f"{folder}: holds {counted(len(told), 'trial')}; go on with --resume, or give another folder"
        )
    each = len(objects) * lifts
    for place, seed in enumerate(seeds):
        if seed in told:
            continue
        trial, session = TrialSettings(bench, seed, choose_estimator()), folder / f"seed_{seed}"
        run_trial(
            session,
            trial,
            list(objects),
            lifts,
            jobs,
            is_session(session),
            progress=lambda done, _, row, at=place: progress(
                at * each + done, len(seeds) * each, f"{row.object}/{row.lift}"
            ),
        )
        told[seed] = tuple(_scored(session, seed, row) for row in read_finished_lifts(session))
        append_line(folder / SEEDS, json_line(SeedTrial(seed, told[seed])))
        shutil.rmtree(session)
    kept = tuple(lift for seed in seeds for lift in told[seed])
    return SeedsResult(bench.name, kept, judge_lifts(bench.difficulty, kept), time.perf_counter() - began)


def table(result: SeedsResult) -> BenchmarkTable:
    """Return a row for each seed, and one for all."""
    seeds = dict.fromkeys(lift.seed for lift in result.lifts)
    by_seed = {str(seed): [lift for lift in result.lifts if lift.seed == seed] for seed in seeds}
    groups = {"all": list(result.lifts), **(by_seed if len(seeds) > 1 else {})}
    columns = (
        "seed", "lifts", "turned", "MARE, B", "MARE, B and C", "worst lift", "answered", "within 2 sigma",
        "confidently wrong",
    )  # fmt: skip
    title = f"SIMULATED on bench '{result.bench}': rotational error in degrees, {HEADING}"
    return BenchmarkTable(title, columns, [_row(name, lifts) for name, lifts in groups.items()])


def as_json(result: SeedsResult) -> dict[str, Any]:
    """Return the result as JSON values, with what it was measured on."""
    return {
        "schema": SCHEMA,
        "simulated": True,
        "bench": result.bench,
        "machine": machine(),
        "all": asdict(score_all([lift.score for lift in result.lifts])),
        "lifts": [asdict(lift) for lift in result.lifts],
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _scored(session: Path, seed: int, row: FinishedLift) -> SeedLift:
    """Score the angles that a lift was answered with, over phases B and C."""
    recording = session / row.recording
    phases, truth = phase_times(recording), recorded_truth(recording)
    told = recorded_angles(recording, FUSED_TOPIC)[FUSED_TOPIC]
    told = [angle for angle in told if phases[Phase.LIFT] <= angle.time_ns < phases[Phase.LOWER]]
    true = [interpolate(truth, angle.time_ns) for angle in told]
    angles, sigmas = [angle.angle_deg for angle in told], [angle.sigma_deg for angle in told]
    in_b = np.array([angle.time_ns < phases[Phase.HOLD] for angle in told], bool)
    wrong = sum(
        angle is not None and known is not None and is_confidently_wrong(angle - known, sigma)
        for angle, sigma, known in zip(angles, sigmas, true, strict=True)
    )
    return SeedLift(
        seed,
        score_series(f"{row.object}/{row.lift}", angles, sigmas, true, in_b),
        row.final_truth_deg or 0.0,
        wrong,
    )


def judge_lifts(difficulty: str, lifts: Sequence[SeedLift]) -> tuple[Measured, ...]:
    """Return the limits on the lifts of a bench, easy or hard."""
    overall = score_all([lift.score for lift in lifts])
    return (
        at_most("MARE, degrees", overall.mare and overall.mare.mean_deg, MARE_DEG[difficulty]),
        at_most("worst lift, degrees", overall.worst_deg, WORST_DEG[difficulty]),
        at_least("share of frames answered", overall.answered, ANSWERED),
        at_most(
            "lifts with an answer that is confidently wrong",
            sum(lift.confidently_wrong > 0 for lift in lifts),
            0,
        ),
    )


def _row(name: str, lifts: Sequence[SeedLift]) -> tuple[str, ...]:
    score = score_all([lift.score for lift in lifts])
    b, both = (mare_text(of) for of in (score.mare_b, score.mare))
    return (
        name,
        str(len(lifts)),
        str(sum(abs(lift.turned_deg) > TURNED_DEG for lift in lifts)),
        b,
        both,
        "-" if score.worst_deg is None else f"{score.worst_deg:.2f} ({score.worst})",
        f"{score.answered:.1%}",
        "-" if score.within_two_sigma is None else f"{score.within_two_sigma:.0%}",
        str(sum(lift.confidently_wrong > 0 for lift in lifts)),
    )
