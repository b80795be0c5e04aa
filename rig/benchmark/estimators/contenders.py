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
from rig.benchmark.timing import REFERENCE, Reference, Streamed
from rig.frames.estimates import estimate_frames, estimate_together
from rig.frames.of_session import SessionSeries, recording_frames
from rig.lift.object_angle import object_angle
from rig.lift.onset import estimated_onset_ns
from rig.lift.recording import recorded_truth
from rig.results.metrics import Mare, mare_of
from rig.results.scores import SeriesScore, score_angles
from rig.results.shares import Share, share_of
from rig.sessions.reading import phase_times
from rig.sessions.records import Lift
from rig.tactile.angles import FUSED, Angles
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.estimators import DEFAULT_ESTIMATOR, ECC, PUBLISHED, choose_estimator
from rig.tactile.paper.axis import METHODS, largest_contour
from rig.tactile.paper.estimator import AxisEstimator, FindsContact, WindowMean
from rig.tactile.paper.published import ANGLES, ScriptAngle, ScriptError, ScriptFilter, stretch
from rig.tactile.sample import EstimatorFaults, SlipSample, State, TactileEstimator, faults_of

PAPER = (*METHODS, *(name + PUBLISHED for name in ANGLES))
CONTENDERS = (DEFAULT_ESTIMATOR, ECC, *PAPER)
WINDOWS = tuple(range(1, 11))  # windows to compare; 1 is no filter. The paper compares 2 to 10.
FRAMES_PER_LIFT = 600  # frames of a fingertip that are timed, from the grasp on, 10 s
TURN_FRAMES = 8
"""Frames that an estimator gets in a row; the published second stage, which is slow, gets one of them."""


def make_unfiltered(
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


def filter_samples(name: str, samples: Sequence[SlipSample], window: int) -> list[SlipSample]:
    if name in PAPER and name.endswith(PUBLISHED):
        script, found = ScriptFilter(window), []
        for sample in samples:  # frames without contact pass through the script's filter, but stay unchanged
            angle_deg = sample.angle_deg if sample.state is State.LOST else script.update(sample.angle_deg)
            found.append(sample if sample.state is State.NO_CONTACT else replace(sample, angle_deg=angle_deg))
        return found
    if window == 1:
        return list(samples)
    mean = WindowMean(_Replayed(samples), window)
    unseen = np.empty((0, 0, 3), np.uint8)
    return [mean.update(unseen, sample.time_ns) for sample in samples]


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
            angle_deg = self.angle(stretch(contact.mask))
        except (ScriptError, cv2.error):
            return SlipSample(time_ns, State.LOST)
        return SlipSample(time_ns, State.TRACKING, angle_deg)


class _Replayed(TactileEstimator):
    def __init__(self, samples: Sequence[SlipSample]) -> None:
        self._samples = iter(samples)

    def update(self, image: Image, time_ns: int) -> SlipSample:
        return next(self._samples)


Passes = dict[str, dict[str, list[SlipSample]]]  # samples by estimator and fingertip


@dataclass(frozen=True, slots=True, eq=False)
class KnownLift:
    """A lift with ground truth, recorded or drawn: fingertips by name, and the starts of its phases, ns."""

    name: str
    tips: Mapping[str, SessionSeries]
    truth: Angles
    lift_ns: int
    hold_ns: int
    end_ns: int

    def passes(self, make: Callable[[SessionSeries], Mapping[str, TactileEstimator]]) -> Passes:
        """Run estimators on the frames. make: returns the estimators of a fingertip by name."""
        of_tips = {name: estimate_together(make(tip), tip.frames) for name, tip in self.tips.items()}
        names = next(iter(of_tips.values()))
        return {name: {tip: samples[name] for tip, samples in of_tips.items()} for name in names}

    def score(self, samples: Mapping[str, Sequence[SlipSample]], onset_s: float | None = None) -> SeriesScore:
        """Score samples by fingertip, over phases B and C. onset_s: true onset since the lift began."""
        angle = object_angle({name: tip.sign for name, tip in self.tips.items()}, samples, self.lift_ns)
        lifted = [sample for sample in angle.fused if sample.time_ns < self.end_ns]
        fused = Angles.of(lifted, FUSED)
        onsets_s = [
            None if time_ns is None or time_ns >= self.end_ns else (time_ns - self.lift_ns) / NS_PER_S
            for time_ns in (estimated_onset_ns(fused), angle.alarm_ns)
        ]
        return replace(
            score_angles(self.name, fused, self.truth.at(fused.time_s), self.hold_ns),
            onset_truth_s=onset_s,
            onset_estimate_s=onsets_s[0],
            onset_event_s=onsets_s[1],
            has_rates=any(sample.rate_deg_s is not None for sample in lifted),
        )


def open_lift(recording: Path, name: str) -> KnownLift:
    """Open the recording of a lift. Raises `SessionError` if it is missing or damaged."""
    tips = {tip.serial: tip for tip in recording_frames(recording)}
    phases = phase_times(recording)
    times_ns = phases[Phase.LIFT], phases[Phase.HOLD], phases[Phase.LOWER]
    return KnownLift(name, tips, recorded_truth(recording), *times_ns)


@dataclass(frozen=True, slots=True)
class LiftScores:
    scores: dict[tuple[str, int], SeriesScore]  # by estimator and window
    frames: int  # number of frames of the default estimator
    skipped: dict[str, int] = field(default_factory=dict)  # how often each stage was skipped in these frames
    faults: dict[str, EstimatorFaults] = field(default_factory=dict)  # of foreign estimators, by name


def score_lift(folder: Path, names: Sequence[str], row: Lift) -> LiftScores:
    """Run every estimator on the frames of one lift, in a worker process. names: of the estimators."""
    cv2.setNumThreads(1)
    lift = open_lift(folder / row.recording, f"{row.object}/{row.lift}")
    passes = lift.passes(lambda tip: make_unfiltered(tip.background, tip.aspect, names, tip.sign))
    scores = {
        (name, window): lift.score(
            {s: filter_samples(name, p, window) for s, p in of.items()}, row.onset_truth_s
        )
        for name, of in passes.items()
        for window in WINDOWS
    }
    every = {name: [sample for tip in of.values() for sample in tip] for name, of in passes.items()}
    ours = every[DEFAULT_ESTIMATOR]
    skipped = dict(Counter(stage for sample in ours for stage in sample.skipped))
    faults = {name: found for name, samples in every.items() if (found := faults_of(samples))}
    return LiftScores(scores, len(ours), skipped, faults)


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
    contact: Spread  # from frame to angle, on frames with contact
    stages: dict[str, Spread]  # of each stage on these frames
    frames: int  # number of all frames
    total_s: float  # sum over all frames, also those without contact


@dataclass(frozen=True, slots=True)
class TimingReport:
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

    It is the time through `rig.estimator`, with its checks. The reference of `rig.benchmark.timing` is among
    the estimators.

    The estimators get several frames in a row, in turn, in an order that is rotated from turn to turn. In use
    only one estimator runs, and caches that other estimators have filled would increase its time.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    samples: dict[str, list[SlipSample]] = {name: [] for name in (*names, REFERENCE)}
    published: list[float] = []
    size_px = (0, 0)
    try:
        for number, row in enumerate(rows):
            tips = recording_frames(folder / row.recording)
            height, width = tips[0].background.shape[:2]
            size_px = width, height
            _time_tip(tips[number % len(tips)], samples, published)
            progress(number + 1, len(rows), f"timed on lift {row.object}/{row.lift}")
    finally:
        cv2.setNumThreads(before)
    contenders = {name: _timing(timed) for name, timed in samples.items()}
    return TimingReport(size_px, contenders, spread(published))


def spread(durations_s: Sequence[float]) -> Spread:
    values = np.asarray(durations_s if len(durations_s) else [0.0], float) * 1e3
    p50, p90, p95, p99 = (float(p) for p in np.percentile(values, (50, 90, 95, 99)))
    return Spread(float(values.max()), p50, p90, p95, p99, len(durations_s))


def _time_tip(tip: SessionSeries, samples: Mapping[str, list[SlipSample]], published: list[float]) -> None:
    names = list(samples)
    estimators: dict[str, TactileEstimator] = {
        name: Streamed(choose_estimator(name).make(tip.background, tip.aspect, tip.sign), tip.background)
        for name in names
        if name != REFERENCE
    }
    estimators[REFERENCE] = Reference()
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
    picture = stretch(mask)
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


ELONGATED = ("t1", "t2", "t3", "t4", "t6", "t7")  # objects with elongated contacts
ONSET_WITHIN_S = 0.05  # largest error of an onset that counts as within
EARLY_S = 0.1  # an onset reported earlier than this before the true one is a false alarm


@dataclass(frozen=True, slots=True)
class OnsetScore:
    """Slip onsets over many lifts."""

    true: int  # number of lifts with an onset
    error_s: float | None  # median of |estimated - true|
    within: Share | None  # share of the true onsets that were reported with an error of at most 50 ms
    missed: int  # number of lifts whose onset was not reported
    false_alarms: int  # lifts with a report but without an onset, or with a report over 100 ms too early


@dataclass(frozen=True, slots=True)
class ContenderScore:
    """Figures of one estimator over many lifts or clips; the MAREs are those of `SeriesScore`."""

    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    mare_unsigned: Mare | None
    mare_elongated: Mare | None  # over objects with elongated contacts
    worst_deg: float | None  # largest mean error of a lift or clip
    worst: str  # its key
    answered: float  # fraction of frames with an angle
    within_two_sigma: float | None  # fraction of these frames, None without sigmas
    wrong_lifts: int  # number of lifts with a confidently wrong angle
    onset: OnsetScore  # onsets found afterwards
    event: OnsetScore | None  # onsets reported during the lift; None for an estimator without rates

    @property
    def mare_deg(self) -> float | None:
        return self.mare and self.mare.mean_deg

    @property
    def wrong_if_sigma(self) -> int | None:
        """Number of lifts with a confidently wrong angle; None for an estimator without sigma."""
        return None if self.within_two_sigma is None else self.wrong_lifts

    @property
    def worst_text(self) -> str:
        return "-" if self.worst_deg is None else f"{self.worst_deg:.2f} ({self.worst})"


def score_all(series: Sequence[SeriesScore]) -> ContenderScore:
    """Combine the scores of lifts or clips; the key of a lift begins with its object, as "t1/3"."""
    means = [(s.re.mean_deg, s.key) for s in series if s.re]
    worst_deg, worst = max(means, default=(None, ""))
    long = [s for s in series if s.key.split("/")[0] in ELONGATED]
    sure = sum(s.sure for s in series)
    frames = sum(s.frames for s in series)
    return ContenderScore(
        mare=mare_of(s.re for s in series),
        mare_b=mare_of(s.re_b for s in series),
        mare_held=mare_of(s.re_held for s in series),
        mare_unsigned=mare_of(s.re_unsigned for s in series),
        mare_elongated=mare_of(s.re for s in long),
        worst_deg=worst_deg,
        worst=worst,
        answered=sum(s.answered * s.frames for s in series) / frames if frames else 0.0,
        within_two_sigma=sum(s.within for s in series) / sure if sure else None,
        wrong_lifts=sum(s.wrong > 0 for s in series),
        onset=_onsets([(s.onset_truth_s, s.onset_estimate_s) for s in series]),
        event=_onsets([(s.onset_truth_s, s.onset_event_s) for s in series])
        if any(s.has_rates for s in series)
        else None,
    )


def _onsets(onsets_s: Sequence[tuple[float | None, float | None]]) -> OnsetScore:
    """Score pairs of true and estimated onset, None without an onset."""
    errors = [e - t for t, e in onsets_s if t is not None and e is not None]
    true = sum(t is not None for t, _ in onsets_s)
    unfounded = sum(t is None and e is not None for t, e in onsets_s)
    return OnsetScore(
        true=true,
        error_s=float(np.median(np.abs(errors))) if errors else None,
        within=share_of([*(abs(e) <= ONSET_WITHIN_S for e in errors), *[False] * (true - len(errors))]),
        missed=true - len(errors),
        false_alarms=unfounded + sum(e < -EARLY_S for e in errors),
    )
