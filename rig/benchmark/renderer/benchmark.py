"""`rig benchmark renderer`: estimators on lifts that the second renderer drew, scored as a trial scores."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.benchmark.estimators.benchmark import machine
from rig.benchmark.estimators.lifts import fused_from
from rig.benchmark.estimators.scores import ContenderScore, SeriesScore, score_all, score_series
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.measured import Measured, at_least, at_most, between
from rig.benchmark.renderer.lifts import LIFT_NS, SIGNS, TURN_S, draw_course, frames, kind_of
from rig.benchmark.renderer.shapes import KIND_NAMES
from rig.benchmark.wrong_answers import is_confidently_wrong
from rig.experiments.process_pool import run_tasks
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import EstimatorChoice, choose_estimator
from rig.tactile.foreign import EstimatorFaults, faults_of, together
from rig.tactile.sample import SlipSample

SCHEMA = 1
LIFTS = 45
MOST_MARE_DEG, MOST_WORST_DEG, LEAST_ANSWERED = 0.5, 3.0, 0.95
LEAST_WITHIN, MOST_WITHIN = 0.90, 0.98
TIPS = {str(tip): sign for tip, sign in enumerate(SIGNS)}
"""The fingertips' signs by name."""
HOLD_NS = LIFT_NS + round(TURN_S * NS_PER_S)
Progress = Callable[[int, int, str], None]
"""Called with how many lifts are done, of how many, and the name of the last one."""


@dataclass(frozen=True, slots=True)
class DrawnLift:
    """One lift of one estimator. wrong: share of its frames that are confidently wrong.

    faults: where an estimator that is not the rig's own failed on frames.
    """

    kind: str
    score: SeriesScore
    wrong: float
    ms: tuple[float, ...]
    faults: EstimatorFaults | None = None


@dataclass(frozen=True, slots=True)
class RendererResult:
    """Everything measured. lifts: by estimator. limits: of the first estimator."""

    lifts: dict[str, tuple[DrawnLift, ...]]
    limits: tuple[Measured, ...]
    seed: int
    wall_s: float

    @property
    def faults(self) -> dict[str, EstimatorFaults]:
        """What estimators failed, by name."""
        failed = {name: [lift.faults for lift in lifts if lift.faults] for name, lifts in self.lifts.items()}
        return {name: together(faults) for name, faults in failed.items() if faults}

    def overall(self, estimator: str) -> ContenderScore:
        """Return one estimator's figures over all lifts."""
        return score_all([lift.score for lift in self.lifts[estimator]])


def run_renderer(
    names: Sequence[str],
    lifts: int = LIFTS,
    seed: int = 0,
    jobs: int | None = None,
    progress: Progress = lambda *_: None,
) -> RendererResult:
    """Draw lifts and let every estimator answer them. Raises `InputError` for an unknown estimator."""
    began = time.perf_counter()
    choices = [choose_estimator(name) for name in names]
    first = seed * 1000
    tasks = list(range(first, first + lifts))
    found: dict[int, dict[str, DrawnLift]] = {}
    for lift, told in run_tasks(partial(answer_lift, choices), tasks, jobs or os.cpu_count() or 1):
        found[lift] = told
        progress(len(found), lifts, f"{KIND_NAMES[kind_of(lift)]}/{lift - first + 1}")
    by_name = {c.name: tuple(found[lift][c.name] for lift in sorted(found)) for c in choices}
    return RendererResult(by_name, _limits(by_name[choices[0].name]), seed, time.perf_counter() - began)


def answer_lift(choices: Sequence[EstimatorChoice], lift: int) -> dict[str, DrawnLift]:
    """Draw one lift and return every estimator's answers, scored; what a worker process does."""
    cv2.setNumThreads(1)
    samples: dict[str, dict[str, list[SlipSample]]] = {choice.name: {} for choice in choices}
    spent: dict[str, list[float]] = {choice.name: [] for choice in choices}
    for tip, sign in TIPS.items():
        empty: list[Image] = []
        estimators: dict[str, Any] = {}
        for time_ns, image in frames(lift, int(tip)):
            if time_ns is None:
                empty.append(image)
                continue
            if not estimators:
                background = mean_background(empty)
                estimators = {c.name: c.make(background, 1.0, sign) for c in choices}
                samples = {name: {**told, tip: []} for name, told in samples.items()}
            for name, estimator in estimators.items():
                began = time.perf_counter()
                samples[name][tip].append(estimator.update(image, time_ns))
                spent[name].append((time.perf_counter() - began) * 1e3)
    return {name: _scored(lift, told, spent[name]) for name, told in samples.items()}


def lift_table(result: RendererResult) -> BenchmarkTable:
    """Return a row per estimator and kind of face, all kinds first."""
    rows = []
    for name, lifts in result.lifts.items():
        groups = {"all": lifts} | {k: tuple(lift for lift in lifts if lift.kind == k) for k in KIND_NAMES}
        rows += [_row(name if kind == "all" else "", kind, told) for kind, told in groups.items() if told]
    columns = (
        "estimator", "face", "lifts", "MARE", "worst lift", "answered", "within 2 sigma", "confidently wrong",
        "ms per frame: median, 99 %",
    )  # fmt: skip
    return BenchmarkTable("SIMULATED by the second renderer: rotational error in degrees", columns, rows)


def as_json(result: RendererResult) -> dict[str, Any]:
    """Return the result as JSON values, with what it was measured on."""
    return {
        "schema": SCHEMA,
        "simulated": True,
        "seed": result.seed,
        "machine": machine(),
        "estimators": {
            name: {
                "all": asdict(result.overall(name)),
                "lifts": [{"face": lift.kind, "wrong": lift.wrong, **asdict(lift.score)} for lift in lifts],
            }
            for name, lifts in result.lifts.items()
        },
        "faults": {name: asdict(faults) for name, faults in result.faults.items()},
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _scored(lift: int, samples: Mapping[str, list[SlipSample]], ms: list[float]) -> DrawnLift:
    fused = fused_from(LIFT_NS, TIPS, samples)
    course = draw_course(lift)
    times = np.array([course.time_ns(i) for i in range(len(course.turn_deg))])
    truth = np.interp([s.time_ns for s in fused], times, course.turn_deg) - course.turn_deg[0]
    angles, sigmas = [s.angle_deg for s in fused], [s.sigma_deg for s in fused]
    score = score_series(
        f"{KIND_NAMES[kind_of(lift)]}/{lift}",
        angles,
        sigmas,
        truth.tolist(),
        np.array([s.time_ns < HOLD_NS for s in fused], bool),
    )
    off = [
        is_confidently_wrong(angle - true, sigma)
        for angle, sigma, true in zip(angles, sigmas, truth, strict=True)
        if angle is not None
    ]
    wrong = float(np.mean(off)) if off else 0.0
    faults = faults_of(sample for tip in samples.values() for sample in tip)
    return DrawnLift(KIND_NAMES[kind_of(lift)], score, wrong, tuple(ms), faults)


def _limits(lifts: Sequence[DrawnLift]) -> tuple[Measured, ...]:
    overall = score_all([lift.score for lift in lifts])
    return (
        at_most("MARE, degrees", overall.mare and overall.mare.mean_deg, MOST_MARE_DEG),
        at_most("worst lift, degrees", overall.worst_deg, MOST_WORST_DEG),
        at_least("share of frames answered", overall.answered, LEAST_ANSWERED),
        between("share of answers within two sigma", overall.within_two_sigma, LEAST_WITHIN, MOST_WITHIN),
        at_most("lifts with an answer that is confidently wrong", _wrong_lifts(overall, lifts), 0),
    )


def _wrong_lifts(overall: ContenderScore, lifts: Sequence[DrawnLift]) -> int | None:
    """Lifts with a confidently wrong answer; None for an estimator without sigma."""
    return None if overall.within_two_sigma is None else sum(lift.wrong > 0 for lift in lifts)


def _row(name: str, kind: str, lifts: Sequence[DrawnLift]) -> tuple[str, ...]:
    score = score_all([lift.score for lift in lifts])
    ms = np.percentile([value for lift in lifts for value in lift.ms], [50, 99])
    return (
        name,
        kind,
        str(len(lifts)),
        "-" if score.mare is None else f"{score.mare.mean_deg:.2f}",
        "-" if score.worst_deg is None else f"{score.worst_deg:.2f}",
        f"{score.answered:.0%}",
        "-" if score.within_two_sigma is None else f"{score.within_two_sigma:.0%}",
        "-" if (wrong := _wrong_lifts(score, lifts)) is None else str(wrong),
        f"{ms[0]:.1f}, {ms[1]:.1f}",
    )
