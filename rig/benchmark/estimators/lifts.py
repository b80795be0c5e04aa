"""Every contender on the stored frames of a session's lifts, scored as a trial scores its own."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Frame, Image
from protocols.observer import Phase
from rig.benchmark.estimators.contenders import CONTENDERS, NO_SKIP, WINDOWS, filtered, unfiltered
from rig.benchmark.estimators.scores import SeriesScore, score_series
from rig.config.models import TactileConfig
from rig.experiments.stored_trial import stored_trial
from rig.lift.fusion import FusedSample
from rig.lift.marker_truth import interpolate
from rig.lift.object_angle import object_angle
from rig.lift.onset import OnsetAlarm, estimated_onset_ns
from rig.lift.recorded_truth import recorded_truth
from rig.sessions.reading import phase_times, recorded_frames
from rig.sessions.records import FinishedLift
from rig.sessions.rows import read_finished_lifts
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import DEFAULT_ESTIMATOR
from rig.tactile.foreign import EstimatorFaults, faults_of
from rig.tactile.sample import SlipSample

Scores = dict[tuple[str, int], SeriesScore]
Tips = Mapping[str, TactileConfig]
Passes = dict[str, dict[str, list[SlipSample]]]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLift:
    """One stored lift: its row in the session, and what the contenders need of its recording.

    tips: the bench's tactile sensors by serial. backgrounds: their frames without contact.
    """

    row: FinishedLift
    recording: Path
    tips: Tips
    phases: Mapping[str, int]
    backgrounds: Mapping[str, Image]

    def frames(self, serial: str) -> Iterator[Frame]:
        """Yield a fingertip's frames from phase A on."""
        for frame in recorded_frames(self.recording, serial):
            if frame.time_ns >= self.phases[Phase.GRASP]:
                yield frame


@dataclass(frozen=True, slots=True)
class LiftScores:
    """One lift: a score per contender and window, and how far `--no-skip` is from skipping.

    skip_gap_deg: largest difference of the two fused angles. skip_apart: frames that only one
    of them answers. skipped: stages left out, by name, and `frames` looked at. faults: where
    contenders that are not the rig's own failed, by name.
    """

    scores: Scores
    skip_gap_deg: float
    skip_apart: int
    frames: int
    skipped: dict[str, int] = field(default_factory=dict)
    faults: dict[str, EstimatorFaults] = field(default_factory=dict)


def session_lifts(folder: Path) -> tuple[Tips, list[FinishedLift]]:
    """Return the fingertips and the rows of a session's accepted lifts. Raises `SessionError`."""
    bench = stored_trial(folder).settings.bench
    rows = read_finished_lifts(folder)
    aspects = bench.pixel_aspects()
    return {t.serial: t.model_copy(update={"pixel_aspect": aspects[t.serial]}) for t in bench.tactile}, rows


def open_lift(folder: Path, tips: Tips, row: FinishedLift) -> RecordedLift:
    """Read what comes before the grasp. Raises `SessionError` for a missing or damaged recording."""
    recording = folder / row.recording
    phases = phase_times(recording)
    backgrounds = {}
    for serial in tips:
        before = takewhile(lambda f: f.time_ns < phases[Phase.GRASP], recorded_frames(recording, serial))
        backgrounds[serial] = mean_background([frame.image for frame in before])
    return RecordedLift(row, recording, tips, phases, backgrounds)


def score_lift(folder: Path, tips: Tips, names: Sequence[str], row: FinishedLift) -> LiftScores:
    """Run every contender over one lift's frames; what a worker process does. names: theirs."""
    cv2.setNumThreads(1)
    lift = open_lift(folder, tips, row)
    passes = run_passes(lift, names)
    truth = truth_at(lift, passes[DEFAULT_ESTIMATOR])
    scores = {
        (name, window): _scored(lift, truth, {s: filtered(name, p, window) for s, p in passes[name].items()})
        for name in names
        for window in WINDOWS
        if name != NO_SKIP or window == 1
    }
    gap, apart = _skip_gap(lift, passes)
    ours = [s for samples in passes[DEFAULT_ESTIMATOR].values() for s in samples]
    skipped = dict(Counter(stage for sample in ours for stage in sample.skipped))
    faults = {
        name: found for name in names if (found := faults_of(s for tip in passes[name].values() for s in tip))
    }
    return LiftScores(scores, gap, apart, len(ours), skipped, faults)


def run_passes(lift: RecordedLift, names: Sequence[str] = CONTENDERS) -> Passes:
    """Return every contender's unfiltered samples of every fingertip, from phase A on."""
    passes: Passes = {name: {} for name in names}
    for serial, background in lift.backgrounds.items():
        tip = lift.tips[serial]
        estimators = unfiltered(background, tip.pixel_aspect, names, tip.sign)
        samples: dict[str, list[SlipSample]] = {name: [] for name in names}
        for frame in lift.frames(serial):
            for name, estimator in estimators.items():
                samples[name].append(estimator.update(frame.image, frame.time_ns))
        for name, made in samples.items():
            passes[name][serial] = made
    return passes


def _scored(
    lift: RecordedLift, truth: Mapping[int, float | None], samples: Mapping[str, list[SlipSample]]
) -> SeriesScore:
    """Score the fused angle over phases B and C, as `rig.lift.result` does."""
    lift_ns, hold_ns = lift.phases[Phase.LIFT], lift.phases[Phase.HOLD]
    fused = [s for s in _fused(lift, samples) if s.time_ns < lift.phases[Phase.LOWER]]
    onset_ns = estimated_onset_ns((s.time_ns, s.angle_deg) for s in fused)
    alarm = OnsetAlarm()
    for sample in fused:
        alarm.update(sample.time_ns, sample.angle_deg, sample.rate_deg_s)
    return score_series(
        f"{lift.row.object}/{lift.row.lift}",
        [s.angle_deg for s in fused],
        [s.sigma_deg for s in fused],
        [truth[s.time_ns] for s in fused],
        np.array([s.time_ns < hold_ns for s in fused], bool),
        (lift.row.onset_truth_s, _since(onset_ns, lift_ns), _since(alarm.raised_ns, lift_ns)),
        any(sample.rate_deg_s is not None for sample in fused),
    )


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S


def _fused(lift: RecordedLift, samples: Mapping[str, list[SlipSample]]) -> list[FusedSample]:
    signs = {serial: tip.sign for serial, tip in lift.tips.items()}
    return object_angle(signs, samples, lift.phases[Phase.LIFT]).fused


def truth_at(lift: RecordedLift, samples: Mapping[str, list[SlipSample]]) -> dict[int, float | None]:
    """Return the true angle in degrees at every tactile frame, None where there is no truth."""
    series = recorded_truth(lift.recording)
    return {s.time_ns: interpolate(series, s.time_ns) for tip in samples.values() for s in tip}


def _skip_gap(lift: RecordedLift, passes: Passes) -> tuple[float, int]:
    """Largest difference in degrees between skipping and not, and frames that one alone answers.

    Of the fused angles since the trial's zero: an estimator's own zero means nothing.
    """
    gap, apart = 0.0, 0
    pairs = zip(*(_fused(lift, passes[name]) for name in (DEFAULT_ESTIMATOR, NO_SKIP)), strict=True)
    for a, b in pairs:
        if a.angle_deg is not None and b.angle_deg is not None:
            gap = max(gap, abs(a.angle_deg - b.angle_deg))
        else:
            apart += (a.angle_deg is None) != (b.angle_deg is None)
    return gap, apart
