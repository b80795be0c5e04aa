"""Reactions to objects that rest: hours of it, drawn again from what fingertips answered at rest, with drift.

Nothing is drawn or estimated twice: half a minute of answers is made by the estimator on simulated frames of
objects that are held and not lifted, and hours are put together from short pieces of it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Pose
from protocols.observer import Phase
from protocols.pump import Pump
from protocols.reaction import ReactionStep
from protocols.slip_trial import GRASP_S, REFERENCE_S
from protocols.steps import approach, close_to_contact, start_watching, tighten
from rig.bench.source import FreshBenches
from rig.experiments.lift_attempt import LiftTask, TrialSettings, derived_seed, new_measurement, plan_lift
from rig.lift.fusion import TipAnswer
from rig.lift.slip_watch import SlipSettings, SlipWatch
from rig.tactile.sample import SlipSample, State

RESTS_S = 6.0
"""So long each object is watched at rest after its noise was learnt."""
PIECE_S = 0.5
"""Pieces of this length keep what is alike from one answer to the next."""
DRIFT_DEG, DRIFT_PERIODS_S = 1.0, (300.0, 1800.0)
"""How far fingertips drift, each by itself, and how slowly (ours)."""
RATES_PER_HOUR = (10.0, 30.0, 100.0)

Answers = dict[str, list[TipAnswer]]


@dataclass(frozen=True, slots=True)
class Rest:
    """What fingertips answered of one object at rest, by serial: noise was learnt from the first part."""

    learnt: Answers
    after: Answers


def watch_at_rest(settings: TrialSettings, task: LiftTask) -> Rest:
    """Grasp an object, lift nothing, and return what the fingertips answer."""
    cv2.setNumThreads(1)
    measurement = new_measurement(settings)
    heard = _Heard()
    measurement.watch = heard
    seed = derived_seed(settings.seed, task.object_id, task.lift, attempt=0)
    plan = plan_lift(settings, task, Pose(settings.bench.table.position_m))
    with FreshBenches(settings.bench).for_lift(seed, task.name) as (bench, operator):
        bench.gripper.activate()
        operator.place(plan.object_id, plan.object_name)
        approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
        pump: Pump = start_watching(bench, measurement, REFERENCE_S)
        tighten(bench, pump, measurement, close_to_contact(bench, pump, measurement), plan.grip_counts)
        pump.run_for(GRASP_S)
        measurement.phase(Phase.LIFT, pump.seen_ns)
        pump.run_for(RESTS_S)
    return Rest(heard.learnt, heard.after)


def false_reactions(rests: Sequence[Rest], hours: float, false_alarms_per_hour: float, seed: int = 0) -> int:
    """Count the reactions in so many hours of rest, shared among the objects."""
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
    """Yield answers of all fingertips in the order of their times, from drawn pieces, each drifting."""
    told = sorted(
        ((answer.sample.time_ns, serial, answer) for serial, answers in after.items() for answer in answers),
        key=lambda each: each[:2],
    )
    times = np.array([time_ns for time_ns, _, _ in told])
    drifts = {serial: _Drift.drawn(rng) for serial in after}
    piece_ns, now_ns = to_ns(PIECE_S), int(times[-1])
    for _ in range(math.ceil(lasts_s / PIECE_S)):
        since_ns = int(rng.integers(times[0], times[-1] - piece_ns))
        first, last = np.searchsorted(times, (since_ns, since_ns + piece_ns))
        for time_ns, serial, answer in told[first:last]:
            yield serial, drifts[serial].added(answer, now_ns + time_ns - since_ns)
        now_ns += piece_ns


@dataclass(frozen=True, slots=True)
class _Drift:
    """A slow wave: its size in deg, its pulse in rad/s, its phase in rad."""

    size_deg: float
    pulse: float
    phase: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "_Drift":
        """Draw one."""
        pulse = 2.0 * math.pi / rng.uniform(*DRIFT_PERIODS_S)
        return cls(DRIFT_DEG, pulse, rng.uniform(0.0, 2.0 * math.pi))

    def added(self, answer: TipAnswer, time_ns: int) -> TipAnswer:
        """Return an answer at another time, drifted."""
        sample = replace(answer.sample, time_ns=time_ns)
        if answer.angle_deg is None or answer.rate_deg_s is None:
            return replace(answer, sample=sample)
        at = self.pulse * time_ns / NS_PER_S + self.phase
        angle_deg = answer.angle_deg + self.size_deg * math.sin(at)
        rate_deg_s = answer.rate_deg_s + self.size_deg * self.pulse * math.cos(at)
        return replace(answer, sample=sample, angle_deg=angle_deg, rate_deg_s=rate_deg_s)


class _Heard(SlipWatch):
    """Keeps what it is told, and raises nothing."""

    def __init__(self) -> None:
        super().__init__(SlipSettings())
        self.learnt: Answers = {}
        self.after: Answers = {}

    def begin(self, at_rest: Mapping[str, Sequence[TipAnswer]]) -> None:
        """Keep the answers that noise is learnt from."""
        self.learnt = {serial: list(answers) for serial, answers in at_rest.items()}

    def update(self, serial: str, answer: TipAnswer) -> None:
        """Keep an answer."""
        self.after.setdefault(serial, []).append(_bare(answer))


def _bare(answer: TipAnswer) -> TipAnswer:
    """An answer without what makes it large to keep."""
    sample = SlipSample(
        answer.sample.time_ns, State.TRACKING, answer.sample.angle_deg, answer.sample.sigma_deg
    )
    return TipAnswer(sample, answer.angle_deg, answer.sigma_deg, answer.rate_deg_s)
