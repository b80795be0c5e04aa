"""Run every estimator on the stored frames of a session's lifts: scores as in a trial, and run times.

An estimator runs once without window, and every window is applied afterwards.
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Image
from protocols.observer import Phase
from rig.benchmark.harness import column
from rig.frames.estimates import estimate_frames, estimate_together
from rig.frames.of_session import SessionSeries, recording_frames
from rig.lift.object_angle import object_angle
from rig.lift.onset import estimated_onset_ns
from rig.lift.recording import recorded_truth
from rig.results.scores import SeriesScore, score_angles
from rig.sessions.reading import phase_times
from rig.sessions.records import Lift
from rig.tactile.angles import FUSED, Angles
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.estimators import DEFAULT_ESTIMATOR, ECC, PUBLISHED, choose_estimator
from rig.tactile.paper.axis import METHODS, largest_contour
from rig.tactile.paper.estimator import AxisEstimator, FindsContact, WindowMean
from rig.tactile.paper.published import ANGLES, ScriptAngle, ScriptError, ScriptFilter, stretched
from rig.tactile.sample import EstimatorFaults, SlipSample, State, TactileEstimator, faults_of

PAPER = (*METHODS, *(name + PUBLISHED for name in ANGLES))
CONTENDERS = (DEFAULT_ESTIMATOR, ECC, *PAPER)
WINDOWS = tuple(range(1, 11))  # windows to compare; 1 is no filter. The paper compares 2 to 10.
FRAMES_PER_LIFT = 600  # frames of a fingertip that are timed, from the grasp on, 10 s
TURN_FRAMES = 8
"""Frames that an estimator gets in a row; the published second stage, which is slow, gets one of them."""


def unfiltered(
    background: Image, aspect: float | None = None, names: Sequence[str] = CONTENDERS, sign: int = 1
) -> dict[str, TactileEstimator]:
    """Make estimators without a window, by name; those of the paper share one contact mask.

    A published estimator reports the script's angle of the frame (clockwise, signed), None without contact.
    """
    finder = SharedContact(ContactFinder(background))
    made: dict[str, TactileEstimator] = {}
    for name in names:
        if name in PAPER and name.endswith(PUBLISHED):
            made[name] = ScriptPass(finder, ANGLES[name.removesuffix(PUBLISHED)])
        elif name in METHODS:
            made[name] = AxisEstimator(finder, METHODS[name])
        else:
            made[name] = choose_estimator(name, 1).make(background, aspect, sign)
    return made


def filtered(name: str, samples: Sequence[SlipSample], window: int) -> list[SlipSample]:
    if name in PAPER and name.endswith(PUBLISHED):
        script = ScriptFilter(window)
        return [_published(sample, script) for sample in samples]
    if window == 1:
        return list(samples)
    mean = WindowMean(_Replayed(samples), window)
    unseen = np.empty((0, 0, 3), np.uint8)
    return [mean.update(unseen, sample.time_ns) for sample in samples]


def _published(sample: SlipSample, script: ScriptFilter) -> SlipSample:
    """Return a sample after the script's filter; a sample without contact is unchanged."""
    if sample.state is State.LOST:
        return sample
    angle_deg = script.update(sample.angle_deg)
    return sample if sample.state is State.NO_CONTACT else replace(sample, angle_deg=angle_deg)


class SharedContact:
    """Finds the contact once per frame for several estimators. cost_s: run time of each search."""

    def __init__(self, finder: FindsContact) -> None:
        self._finder = finder
        self._of: Image | None = None
        self._found: Contact | None = None
        self.cost_s: list[float] = []

    def find(self, image: Image) -> Contact:
        """Return the contact in a frame; repeated calls with the same array do not search again."""
        if self._found is None or image is not self._of:
            began = time.perf_counter()
            self._of, self._found = image, self._finder.find(image)
            self.cost_s.append(time.perf_counter() - began)
        return self._found


@dataclass(slots=True)
class ScriptPass(TactileEstimator):
    """Reports the published script's angle before its filter; the state is `lost` if the script raises."""

    finder: FindsContact
    angle: ScriptAngle

    def update(self, image: Image, time_ns: int) -> SlipSample:
        contact = self.finder.find(image)
        if contact.mask is None:
            return SlipSample(time_ns, State.NO_CONTACT)
        try:
            angle_deg = self.angle(stretched(contact.mask))
        except (ScriptError, cv2.error):
            return SlipSample(time_ns, State.LOST)
        return SlipSample(time_ns, State.TRACKING, angle_deg)


class _Replayed(TactileEstimator):
    """Returns stored samples in order."""

    def __init__(self, samples: Sequence[SlipSample]) -> None:
        self._samples = iter(samples)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        return next(self._samples)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedLift:
    """One stored lift: its row in the session, its recording, and its fingertips by serial."""

    row: Lift
    recording: Path
    phases: Mapping[str, int]
    tips: Mapping[str, SessionSeries]

    @property
    def name(self) -> str:
        return f"{self.row.object}/{self.row.lift}"


@dataclass(frozen=True, slots=True)
class LiftScores:
    """One lift: a score per estimator and window."""

    scores: dict[tuple[str, int], SeriesScore]
    frames: int  # number of frames of the default estimator
    skipped: dict[str, int] = field(default_factory=dict)  # how often each stage was skipped in these frames
    faults: dict[str, EstimatorFaults] = field(default_factory=dict)  # of foreign estimators, by name


def open_lift(folder: Path, row: Lift) -> RecordedLift:
    """Open the recording of a lift. Raises `SessionError` if it is missing or damaged."""
    recording = folder / row.recording
    tips = {tip.serial: tip for tip in recording_frames(recording)}
    return RecordedLift(row, recording, phase_times(recording), tips)


def score_lift(folder: Path, names: Sequence[str], row: Lift) -> LiftScores:
    """Run every estimator on the frames of one lift, in a worker process. names: of the estimators."""
    cv2.setNumThreads(1)
    lift = open_lift(folder, row)
    passes: dict[str, dict[str, list[SlipSample]]] = {name: {} for name in names}
    for serial, tip in lift.tips.items():
        estimators = unfiltered(tip.background, tip.aspect, names, tip.sign)
        for name, timed in estimate_together(estimators, tip.frames).items():
            passes[name][serial] = timed
    truth = recorded_truth(lift.recording)
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


def _scored(lift: RecordedLift, truth: Angles, samples: Mapping[str, list[SlipSample]]) -> SeriesScore:
    lift_ns, end_ns = lift.phases[Phase.LIFT], lift.phases[Phase.LOWER]
    angle = object_angle({serial: tip.sign for serial, tip in lift.tips.items()}, samples, lift_ns)
    lifted = [sample for sample in angle.fused if sample.time_ns < end_ns]
    fused = Angles.of(lifted, FUSED)
    alarm_ns = angle.alarm_ns
    return replace(
        score_angles(lift.name, fused, truth.at(fused.time_s), lift.phases[Phase.HOLD]),
        onset_truth_s=lift.row.onset_truth_s,
        onset_estimate_s=_since(estimated_onset_ns(fused), lift_ns),
        onset_event_s=_since(alarm_ns if alarm_ns is None or alarm_ns < end_ns else None, lift_ns),
        has_rates=any(sample.rate_deg_s is not None for sample in lifted),
    )


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class Spread:
    """Percentiles of a duration in ms, over `count` frames."""

    max_ms: float
    p50_ms: float = column("median, ms", ".2f")
    p90_ms: float = column("90 %", ".2f")
    p95_ms: float = column("95 %", ".2f")
    p99_ms: float = column("99 %", ".2f")
    count: int = column("frames")


@dataclass(frozen=True, slots=True)
class Timing:
    """Run time of one estimator."""

    contact: Spread  # from frame to angle, on frames with contact
    stages: dict[str, Spread]  # of each stage on these frames
    frames: int  # number of all frames
    total_s: float  # sum over all frames, also those without contact


@dataclass(frozen=True, slots=True)
class TimingReport:
    """Everything timed in one pass."""

    size_px: tuple[int, int]  # width and height of the frames
    contenders: dict[str, Timing]
    published: Spread  # the published second stage, stretched mask to angle


def time_lifts(
    folder: Path,
    rows: Sequence[Lift],
    progress: Callable[[int, int, str], None] = lambda done, total, note: None,
    names: Sequence[str] = CONTENDERS,
) -> TimingReport:
    """Measure the run time of every estimator on one fingertip's frames of some lifts, in one thread.

    The estimators get several frames in a row, in turn, in an order that is rotated from turn to turn. In use
    only one estimator runs, and caches that other estimators have filled would increase its time.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        samples: dict[str, list[SlipSample]] = {name: [] for name in names}
        published: list[float] = []
        lift = open_lift(folder, rows[0])
        for number, row in enumerate(rows):
            lift = open_lift(folder, row)
            tips = list(lift.tips.values())
            _time_tip(tips[number % len(tips)], samples, published)
            progress(number + 1, len(rows), f"timed on lift {row.object}/{row.lift}")
        height, width = next(iter(lift.tips.values())).background.shape[:2]
        contenders = {name: _timing(timed) for name, timed in samples.items()}
        return TimingReport((width, height), contenders, spread(published))
    finally:
        cv2.setNumThreads(before)


def spread(durations_s: Sequence[float]) -> Spread:
    values = np.asarray(durations_s if len(durations_s) else [0.0], float) * 1e3
    p50, p90, p95, p99 = (float(p) for p in np.percentile(values, (50, 90, 95, 99)))
    return Spread(float(values.max()), p50, p90, p95, p99, len(durations_s))


def _time_tip(tip: SessionSeries, samples: Mapping[str, list[SlipSample]], published: list[float]) -> None:
    names = list(samples)
    estimators = {name: choose_estimator(name).make(tip.background, tip.aspect, tip.sign) for name in names}
    finder, frames = ContactFinder(tip.background), islice(tip.frames, FRAMES_PER_LIFT)
    for number in count():
        turn = list(islice(frames, TURN_FRAMES))
        if not turn:
            return
        first = number % len(names)
        for name in names[first:] + names[:first]:
            samples[name].extend(estimate_frames(estimators[name], turn))
        mask = None if turn[0].image is None else finder.find(turn[0].image).mask
        if mask is not None:
            published += _published_s(mask)


def _published_s(mask: Image) -> list[float]:
    """Return the time of the script from a mask to an angle, which thins the full picture, s; [] without."""
    began = time.perf_counter()
    picture = stretched(mask)
    contour = largest_contour(picture)
    filled = np.zeros(picture.shape, np.uint8)
    if contour is None or len(contour) < 5:
        return []
    cv2.ellipse(filled, cv2.fitEllipse(contour), 255, -1)
    thinned = cv2.ximgproc.thinning(filled, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    lines, _ = cv2.findContours(thinned, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not lines:
        return []
    cv2.fitLine(lines[0], cv2.DIST_L2, 0, 0.01, 0.001)
    return [time.perf_counter() - began]


def _timing(timed: Sequence[SlipSample]) -> Timing:
    touching = [of for of in timed if of.state is not State.NO_CONTACT]
    stages = [of.stage_s for of in touching]
    names = dict.fromkeys(name for of in stages for name in of)
    return Timing(
        contact=spread([of.cost_s or 0.0 for of in touching]),
        stages={name: spread([of[name] for of in stages if name in of]) for name in names},
        frames=len(timed),
        total_s=sum(of.cost_s or 0.0 for of in timed),
    )
