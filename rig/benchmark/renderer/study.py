"""`rig benchmark renderer`: estimators on lifts of the second renderer, scored as in a trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from rig.benchmark.estimators.scores import ContenderScore, score_all
from rig.benchmark.harness import Report, Run, Study, Table, column, option, table_of
from rig.benchmark.measured import Measured, at_least, at_most, between
from rig.benchmark.renderer.lifts import (
    BACKGROUND_FRAMES,
    LIFT_NS,
    SIGNS,
    TURN_S,
    draw_course,
    frames,
    kind_of,
)
from rig.benchmark.renderer.shapes import KIND_NAMES
from rig.frames.estimates import FRAME_MS, contact_ms, estimate_together, frame_ms
from rig.lift.object_angle import object_angle
from rig.results.scores import SeriesScore, score_angles
from rig.tactile.angles import FUSED, Angles
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import EstimatorChoice, choose_estimator
from rig.tactile.sample import EstimatorFaults, SlipSample, faults_of, together

MOST_MARE_DEG, MOST_WORST_DEG, LEAST_ANSWERED = 0.5, 3.0, 0.95
LEAST_WITHIN, MOST_WITHIN = 0.90, 0.98
TIPS = {str(tip): sign for tip, sign in enumerate(SIGNS)}
"""The fingertips' signs by name."""
HOLD_NS = LIFT_NS + round(TURN_S * NS_PER_S)
LIFTS_PER_SEED = 1000
"""Seed n draws the lifts from 1000 n on."""


@dataclass(frozen=True, slots=True)
class RendererOptions:
    """Options of `rig benchmark renderer`."""

    estimator: list[str] | None = option(
        None,
        "Repeat for more, also your own as package.module:Class; limits are for the first. Default: slip.",
    )
    lifts: int = option(45, "Number of lifts.", min=1, max=1000)


@dataclass(frozen=True, slots=True)
class DrawnLift:
    """One lift of one estimator. faults: failures of a lab's own estimator."""

    kind: str
    score: SeriesScore
    ms: tuple[float, ...]
    faults: EstimatorFaults | None = None


@dataclass(frozen=True, slots=True)
class FaceRow:
    """The lifts of one estimator with one kind of face, or with all: a row of the table."""

    estimator: str = column("estimator")
    face: str = column("face")
    lifts: int = column("lifts")
    mare_deg: float | None = column("MARE", ".2f", "degrees")
    worst_deg: float | None = column("worst lift", ".2f", "largest mean error of a lift, degrees")
    answered: float = column("answered", ".0%", "share of the frames with an angle")
    within_two_sigma: float | None = column("within 2 sigma", ".0%", "share of the answers")
    confidently_wrong: int | None = column("confidently wrong", doc="lifts with such an answer")
    ms: tuple[float, float, float] | None = column(FRAME_MS, ".1f")


def measure(options: RendererOptions, run: Run) -> Report:
    """Score estimators on SIMULATED lifts of a second renderer, independent of the bench's.

    It shares no code with the renderer of the simulated bench, and has another gel, LEDs, object faces and
    rotations. An estimator that is overfitted to the simulated bench has larger errors here. The exit code is
    4 if the first estimator misses a limit.

    Examples:
      rig benchmark renderer

      rig benchmark renderer --estimator slip --estimator ecc --lifts 16 --json

    """
    choices = [choose_estimator(name) for name in options.estimator or ["slip"]]
    first = LIFTS_PER_SEED * run.seed
    numbers = range(first, first + options.lifts)
    drawn = run.each(
        partial(answer_lift, choices), numbers, lambda lift: f"{KIND_NAMES[kind_of(lift)]}/{lift}"
    )
    by_name = {choice.name: [lift[choice.name] for lift in drawn] for choice in choices}
    failed = {name: [lift.faults for lift in lifts if lift.faults] for name, lifts in by_name.items()}
    return Report(
        tables=(face_table(by_name),),
        limits=judge_lifts(by_name[choices[0].name]),
        limits_of=f"'{choices[0].name}'",
        faults={name: together(faults) for name, faults in failed.items() if faults},
    )


def answer_lift(choices: Sequence[EstimatorChoice], lift: int) -> dict[str, DrawnLift]:
    """Draw one lift and return the scored answers of each estimator. Runs in a worker process."""
    cv2.setNumThreads(1)
    samples: dict[str, dict[str, list[SlipSample]]] = {choice.name: {} for choice in choices}
    spent_ms: dict[str, list[float]] = {choice.name: [] for choice in choices}
    for tip, sign in TIPS.items():
        drawn = frames(lift, int(tip))
        background = mean_background([frame.image for frame in islice(drawn, BACKGROUND_FRAMES)])
        estimators = {choice.name: choice.make(background, 1.0, sign) for choice in choices}
        for name, timed in estimate_together(estimators, drawn).items():
            samples[name][tip] = timed
            spent_ms[name] += contact_ms(timed)
    return {name: _scored(lift, of, spent_ms[name]) for name, of in samples.items()}


def face_table(by_estimator: Mapping[str, Sequence[DrawnLift]]) -> Table:
    """Return a row per estimator and kind of face, all kinds first."""
    rows = []
    for name, lifts in by_estimator.items():
        groups = {"all": lifts} | {kind: [lift for lift in lifts if lift.kind == kind] for kind in KIND_NAMES}
        rows += [_row(name if kind == "all" else "", kind, of) for kind, of in groups.items() if of]
    return table_of("SIMULATED by the second renderer: rotational error in degrees", FaceRow, rows, left=2)


def judge_lifts(lifts: Sequence[DrawnLift]) -> tuple[Measured, ...]:
    """Return the limits on the lifts of one estimator."""
    overall = score_all([lift.score for lift in lifts])
    return (
        at_most("MARE, degrees", overall.mare and overall.mare.mean_deg, MOST_MARE_DEG),
        at_most("worst lift, degrees", overall.worst_deg, MOST_WORST_DEG),
        at_least("share of frames answered", overall.answered, LEAST_ANSWERED),
        between("share of answers within two sigma", overall.within_two_sigma, LEAST_WITHIN, MOST_WITHIN),
        at_most("lifts with an answer that is confidently wrong", _wrong_lifts(overall), 0),
    )


def _scored(lift: int, samples: Mapping[str, list[SlipSample]], ms: list[float]) -> DrawnLift:
    fused = Angles.of(object_angle(TIPS, samples, LIFT_NS).fused, FUSED)
    course, kind = draw_course(lift), KIND_NAMES[kind_of(lift)]
    times = np.array([course.time_ns(i) for i in range(len(course.turn_deg))])
    truth = np.interp(fused.time_ns, times, course.turn_deg) - course.turn_deg[0]
    score = score_angles(f"{kind}/{lift}", fused, truth, HOLD_NS)
    faults = faults_of(sample for tip in samples.values() for sample in tip)
    return DrawnLift(kind, score, tuple(ms), faults)


def _row(name: str, face: str, lifts: Sequence[DrawnLift]) -> FaceRow:
    score = score_all([lift.score for lift in lifts])
    return FaceRow(
        estimator=name,
        face=face,
        lifts=len(lifts),
        mare_deg=score.mare and score.mare.mean_deg,
        worst_deg=score.worst_deg,
        answered=score.answered,
        within_two_sigma=score.within_two_sigma,
        confidently_wrong=_wrong_lifts(score),
        ms=frame_ms([value for lift in lifts for value in lift.ms]),
    )


def _wrong_lifts(overall: ContenderScore) -> int | None:
    """Return the number of lifts with a confidently wrong answer; None for an estimator without sigma."""
    return None if overall.within_two_sigma is None else overall.wrong_lifts


STUDY = Study(name="renderer", options=RendererOptions, measure=measure, cases="lifts")
