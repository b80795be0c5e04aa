"""False reactions to objects at rest: hours of estimates, resampled from half a minute, with added drift.

The estimator answers simulated frames of objects that are held and not lifted. Hours of answers are
composed of random short pieces of these, so that no frame is drawn or estimated twice.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.stats import poisson

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Pose
from protocols.observer import Phase, ReactionStep
from protocols.pump import Pump
from protocols.reaction import ReactionKind
from protocols.slip_trial import GRASP_S, REFERENCE_S, SETTLE_S
from protocols.steps import approach, close_to_contact, start_watching, tighten
from rig.bench.source import FreshBenches
from rig.benchmark.measured import Measured, at_most
from rig.experiments.lift_plan import LiftTask, TrialSettings, new_measurement, plan_lift
from rig.experiments.seeds import derived_seed
from rig.lift.fusion import TipAnswer
from rig.lift.slip_watch import SlipSettings, SlipWatch
from rig.tactile.sample import SlipSample, State

RESTS_S = 6.0
"""Time for which each object is watched at rest after its noise was learnt."""
PIECE_S = 0.5
"""Length of a piece: long enough to keep the correlation of successive answers."""
DRIFT_DEG, DRIFT_PERIODS_S = 1.0, (300.0, 1800.0)
"""Amplitude and range of periods of the drift of each fingertip (assumed)."""
RATES_PER_HOUR = (10.0, 30.0, 100.0)
"""Rates of false reactions that are accepted."""
CONFIDENCE = 0.95

Answers = dict[str, list[TipAnswer]]


@dataclass(frozen=True, slots=True)
class Rest:
    """Answers of fingertips on one object at rest, by serial: noise was learnt from the first part."""

    learnt: Answers
    after: Answers


def watch_at_rest(settings: TrialSettings, task: LiftTask) -> Rest:
    """Grasp an object without lifting it, and return the fingertips' answers."""
    cv2.setNumThreads(1)
    measurement = new_measurement(replace(settings, react=ReactionKind.NONE))
    tips = measurement.angle.tips
    seed = derived_seed(settings.seed, task.object_id, task.lift, attempt=0)
    plan = plan_lift(settings, task, Pose(settings.bench.table.position_m))
    with FreshBenches(settings.bench).for_lift(seed, task.name) as (bench, operator):
        bench.gripper.activate()
        operator.place(plan.object_id, plan.object_name)
        approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
        pump: Pump = start_watching(bench, measurement, REFERENCE_S)
        tighten(bench, pump, measurement, close_to_contact(bench, pump, measurement), plan.grip_steps)
        pump.run_for(GRASP_S)
        lift_ns = pump.seen_ns
        measurement.phase(Phase.LIFT, lift_ns)
        before = {serial: len(tip.samples) for serial, tip in tips.items()}
        pump.run_for(RESTS_S)
    since_ns = lift_ns - to_ns(SETTLE_S)
    return Rest(
        {
            n: [tip.answer(s) for s in tip.samples if since_ns <= s.time_ns < lift_ns]
            for n, tip in tips.items()
        },
        {n: [_bare(tip.answer(s)) for s in tip.samples[before[n] :]] for n, tip in tips.items()},
    )


def at_rest(rests: Sequence[Rest], hours: float) -> list[Measured]:
    """Return the number of reactions to resting objects, for each accepted rate.

    The limit is the upper end of the Poisson interval of the count. There may be fewer, since no slip is
    detected below the angle by which the gel yields, however small the noise is.
    """
    return [
        at_most(
            f"reactions in {hours:g} hours at rest with drift, {rate:g} an hour accepted",
            false_reactions(rests, hours, rate),
            float(poisson.interval(CONFIDENCE, hours * rate)[1]),
        )
        for rate in RATES_PER_HOUR
    ]


def false_reactions(rests: Sequence[Rest], hours: float, false_alarms_per_hour: float, seed: int = 0) -> int:
    """Count the reactions in some hours of rest, shared equally among the objects."""
    rng = np.random.default_rng(seed)
    each_s = 3600.0 * hours / len(rests)
    count = 0
    for rest in rests:
        watch = SlipWatch(SlipSettings(false_alarms_per_hour))
        watch.begin(rest.learnt)
        for serial, answer in _resting(rest.after, each_s, rng):
            watch.update(serial, answer)
            if (due_ns := watch.slip_ns()) is not None:
                count += 1
                watch.reacted(ReactionStep.STOP, due_ns, 0)
                watch.reacted(ReactionStep.REST, due_ns, 0)
    return count


def _resting(after: Answers, lasts_s: float, rng: np.random.Generator) -> Iterator[tuple[str, TipAnswer]]:
    """Yield answers of all fingertips from random pieces, in the order of their times, with drift."""
    answers = sorted(
        ((answer.sample.time_ns, serial, answer) for serial, of in after.items() for answer in of),
        key=lambda each: each[:2],
    )
    times = np.array([time_ns for time_ns, _, _ in answers])
    drifts = {serial: _Drift.drawn(rng) for serial in after}
    piece_ns, now_ns = to_ns(PIECE_S), int(times[-1])
    for _ in range(math.ceil(lasts_s / PIECE_S)):
        since_ns = int(rng.integers(times[0], times[-1] - piece_ns))
        first, last = np.searchsorted(times, (since_ns, since_ns + piece_ns))
        for time_ns, serial, answer in answers[first:last]:
            yield serial, drifts[serial].added(answer, now_ns + time_ns - since_ns)
        now_ns += piece_ns


@dataclass(frozen=True, slots=True)
class _Drift:
    """A slow sine: amplitude, angular frequency and phase."""

    size_deg: float
    rad_s: float
    phase_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "_Drift":
        """Draw one at random."""
        rad_s = 2.0 * math.pi / rng.uniform(*DRIFT_PERIODS_S)
        return cls(DRIFT_DEG, rad_s, rng.uniform(0.0, 2.0 * math.pi))

    def added(self, answer: TipAnswer, time_ns: int) -> TipAnswer:
        """Return an answer at another time, with drift added."""
        sample = replace(answer.sample, time_ns=time_ns)
        if answer.angle_deg is None or answer.rate_deg_s is None:
            return replace(answer, sample=sample)
        at = self.rad_s * time_ns / NS_PER_S + self.phase_rad
        angle_deg = answer.angle_deg + self.size_deg * math.sin(at)
        rate_deg_s = answer.rate_deg_s + self.size_deg * self.rad_s * math.cos(at)
        return replace(answer, sample=sample, angle_deg=angle_deg, rate_deg_s=rate_deg_s)


def _bare(answer: TipAnswer) -> TipAnswer:
    """Return an answer without its large parts."""
    sample = SlipSample(
        answer.sample.time_ns, State.TRACKING, answer.sample.angle_deg, answer.sample.sigma_deg
    )
    return TipAnswer(sample, answer.angle_deg, answer.sigma_deg, answer.rate_deg_s)
