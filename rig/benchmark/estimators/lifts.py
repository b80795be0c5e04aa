"""Run every estimator on the stored frames of a session's lifts, and score it as in a trial."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2

from drivers.clock import NS_PER_S
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import WINDOWS, filtered, unfiltered
from rig.frames.estimates import estimate_together
from rig.frames.of_session import SessionSeries, recording_frames
from rig.lift.marker_truth import interpolate
from rig.lift.object_angle import ObjectAngle, object_angle
from rig.lift.onset import estimated_onset_ns
from rig.lift.recording import recorded_truth
from rig.results.scores import SeriesScore, score_angles
from rig.sessions.reading import phase_times
from rig.sessions.records import FinishedLift
from rig.tactile.estimators import DEFAULT_ESTIMATOR
from rig.tactile.sample import EstimatorFaults, SlipSample, faults_of

Scores = dict[tuple[str, int], SeriesScore]
Passes = dict[str, dict[str, list[SlipSample]]]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLift:
    """One stored lift: its row in the session, its recording, and its fingertips by serial."""

    row: FinishedLift
    recording: Path
    phases: Mapping[str, int]
    tips: Mapping[str, SessionSeries]

    @property
    def name(self) -> str:
        """Object and number of the lift, as "t1/3"."""
        return f"{self.row.object}/{self.row.lift}"


@dataclass(frozen=True, slots=True)
class LiftScores:
    """One lift: a score per estimator and window.

    frames: number of frames of the default estimator. skipped: how often each stage was skipped in these
    frames. faults: of foreign estimators, by name.
    """

    scores: Scores
    frames: int
    skipped: dict[str, int] = field(default_factory=dict)
    faults: dict[str, EstimatorFaults] = field(default_factory=dict)


def open_lift(folder: Path, row: FinishedLift) -> RecordedLift:
    """Open the recording of a lift. Raises `SessionError` if it is missing or damaged."""
    recording = folder / row.recording
    tips = {tip.serial: tip for tip in recording_frames(recording)}
    return RecordedLift(row, recording, phase_times(recording), tips)


def score_lift(folder: Path, names: Sequence[str], row: FinishedLift) -> LiftScores:
    """Run every estimator on the frames of one lift, in a worker process. names: of the estimators."""
    cv2.setNumThreads(1)
    lift = open_lift(folder, row)
    passes = _passes(lift, names)
    truth = truth_at(lift, passes[DEFAULT_ESTIMATOR])
    scores = {
        (name, window): _scored(lift, truth, {s: filtered(name, p, window) for s, p in passes[name].items()})
        for name in names
        for window in WINDOWS
    }
    ours = [s for samples in passes[DEFAULT_ESTIMATOR].values() for s in samples]
    skipped = dict(Counter(stage for sample in ours for stage in sample.skipped))
    faults = {
        name: found for name in names if (found := faults_of(s for tip in passes[name].values() for s in tip))
    }
    return LiftScores(scores, len(ours), skipped, faults)


def _passes(lift: RecordedLift, names: Sequence[str]) -> Passes:
    """Return the unfiltered samples of every estimator and fingertip, from phase A on."""
    passes: Passes = {name: {} for name in names}
    for serial, tip in lift.tips.items():
        estimators = unfiltered(tip.background, tip.aspect, names, tip.sign)
        for name, timed in estimate_together(estimators, tip.frames).items():
            passes[name][serial] = [of.sample for of in timed]
    return passes


def _scored(
    lift: RecordedLift, truth: Mapping[int, float | None], samples: Mapping[str, list[SlipSample]]
) -> SeriesScore:
    """Score the fused angle over phases B and C."""
    lift_ns, end_ns = lift.phases[Phase.LIFT], lift.phases[Phase.LOWER]
    angle = _object_angle(lift, samples)
    fused = [s for s in angle.fused if s.time_ns < end_ns]
    alarm_ns = angle.alarm.raised_ns
    return replace(
        score_angles(lift.name, fused, [truth[s.time_ns] for s in fused], lift.phases[Phase.HOLD]),
        onset_truth_s=lift.row.onset_truth_s,
        onset_estimate_s=_since(estimated_onset_ns((s.time_ns, s.angle_deg) for s in fused), lift_ns),
        onset_event_s=_since(alarm_ns if alarm_ns is None or alarm_ns < end_ns else None, lift_ns),
        has_rates=any(sample.rate_deg_s is not None for sample in fused),
    )


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S


def _object_angle(lift: RecordedLift, samples: Mapping[str, list[SlipSample]]) -> ObjectAngle:
    signs = {serial: tip.sign for serial, tip in lift.tips.items()}
    return object_angle(signs, samples, lift.phases[Phase.LIFT])


def truth_at(lift: RecordedLift, samples: Mapping[str, list[SlipSample]]) -> dict[int, float | None]:
    """Return the true angle in degrees at the time of every tactile frame; None if it is unknown."""
    series = recorded_truth(lift.recording)
    return {s.time_ns: interpolate(series, s.time_ns) for tip in samples.values() for s in tip}
