"""Measure the run time per frame and stage of every estimator, and an hour of a static contact."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Frame, Image
from fakes.studio.clips import Scene, resting_frames
from rig.benchmark.estimators.contenders import CONTENDERS, NO_SKIP, complete
from rig.benchmark.estimators.lifts import RecordedLift, open_lift
from rig.benchmark.harness import column
from rig.frames.estimates import TimedSample, estimate_frames
from rig.frames.of_session import SessionSeries
from rig.sessions.records import FinishedLift
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import DEFAULT_ESTIMATOR
from rig.tactile.paper.axis import largest_contour
from rig.tactile.paper.published import skeleton_angle, stretched
from rig.tactile.sample import State
from rig.tactile.slip.estimator import SlipEstimator

PERCENTILES = (50, 90, 95, 99)
FRAMES_PER_LIFT = 600
"""Frames of a fingertip from the grasp on, 10 s."""
TURN_FRAMES = 8
"""Frames that an estimator gets in a row; the published second stage, which is slow, gets one of them."""


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
    """Run time of one estimator.

    contact: from frame to angle, on frames with contact. stages: of each stage on these frames. frames:
    number of all frames. total_s: sum over all frames, also those without contact.
    """

    contact: Spread
    stages: dict[str, Spread]
    frames: int
    total_s: float


@dataclass(frozen=True, slots=True)
class PublishedStage:
    """Run time of the published second stage.

    stage: from the stretched mask to the angle. thinning: of its thinning of the full image. cropped: of the
    stage if only the bounding box of the contact is thinned, which gives the same angle.
    """

    stage: Spread
    thinning: Spread
    cropped: Spread


@dataclass(frozen=True, slots=True)
class Threads:
    """One and two OpenCV threads: median run times in ms, and the largest difference of the angles, deg."""

    one_ms: float
    two_ms: float
    gap_deg: float
    frames: int


@dataclass(frozen=True, slots=True)
class TimingReport:
    """All run times. size_px: width, height of the frames. skip_saves: fraction of time saved by skipping."""

    size_px: tuple[int, int]
    contenders: dict[str, Timing]
    published: PublishedStage
    skip_saves: float
    threads: Threads


def time_lifts(
    folder: Path,
    rows: Sequence[FinishedLift],
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
        samples: dict[str, list[TimedSample]] = {name: [] for name in names}
        stage: dict[str, list[float]] = {"stage": [], "thinning": [], "cropped": []}
        lift = open_lift(folder, rows[0])
        for number, row in enumerate(rows):
            lift = open_lift(folder, row)
            tips = list(lift.tips.values())
            _time_tip(tips[number % len(tips)], samples, stage)
            progress(number + 1, len(rows), f"timed on lift {row.object}/{row.lift}")
        height, width = next(iter(lift.tips.values())).background.shape[:2]
        contenders = {name: _timing(timed) for name, timed in samples.items()}
        published = PublishedStage(**{name: spread(values) for name, values in stage.items()})
        ours, whole = contenders[DEFAULT_ESTIMATOR].total_s, contenders[NO_SKIP].total_s
        return TimingReport((width, height), contenders, published, 1.0 - ours / whole, _threads(lift))
    finally:
        cv2.setNumThreads(before)


def spread(durations_s: Sequence[float]) -> Spread:
    """Return the percentiles of durations in s, in ms; zeros if there are none."""
    values = np.asarray(durations_s if len(durations_s) else [0.0], float) * 1e3
    p50, p90, p95, p99 = (float(p) for p in np.percentile(values, PERCENTILES))
    return Spread(float(values.max()), p50, p90, p95, p99, len(durations_s))


def _time_tip(
    tip: SessionSeries,
    samples: Mapping[str, list[TimedSample]],
    stage: Mapping[str, list[float]],
) -> None:
    names = list(samples)
    estimators = {name: complete(name, tip.background, tip.aspect, tip.sign) for name in names}
    finder = ContactFinder(tip.background)
    frames = islice(tip.frames, FRAMES_PER_LIFT)
    for number in count():
        turn = list(islice(frames, TURN_FRAMES))
        if not turn:
            return
        first = number % len(names)
        for name in names[first:] + names[:first]:
            samples[name].extend(estimate_frames(estimators[name], turn))
        if turn[0].image is not None:
            _time_published(finder.find(turn[0].image).mask, stage)


def _time_published(mask: Image | None, stage: Mapping[str, list[float]]) -> None:
    """Measure the time of the published script from mask to angle, with the full and the cropped image."""
    if mask is None:
        return
    began = time.perf_counter()
    picture = stretched(mask)
    contour = largest_contour(picture)
    filled = np.zeros(picture.shape, np.uint8)
    if contour is None or len(contour) < 5:
        return
    cv2.ellipse(filled, cv2.fitEllipse(contour), 255, -1)
    thinning_began = time.perf_counter()
    thinned = cv2.ximgproc.thinning(filled, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    thinning_s = time.perf_counter() - thinning_began
    lines, _ = cv2.findContours(thinned, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not lines:
        return
    cv2.fitLine(lines[0], cv2.DIST_L2, 0, 0.01, 0.001)
    stage["stage"].append(time.perf_counter() - began)
    stage["thinning"].append(thinning_s)
    began = time.perf_counter()
    skeleton_angle(stretched(mask))
    stage["cropped"].append(time.perf_counter() - began)


def _timing(timed: Sequence[TimedSample]) -> Timing:
    touching = [of for of in timed if of.sample.state is not State.NO_CONTACT]
    stages = [of.sample.stage_s for of in touching]
    names = dict.fromkeys(name for of in stages for name in of)
    return Timing(
        contact=spread([of.cost_s or 0.0 for of in touching]),
        stages={name: spread([of[name] for of in stages if name in of]) for name in names},
        frames=len(timed),
        total_s=sum(of.cost_s or 0.0 for of in timed),
    )


def _threads(lift: RecordedLift) -> Threads:
    """Compare one and two OpenCV threads with the default estimator on the frames of one fingertip."""
    tip = next(iter(lift.tips.values()))
    passes = []
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        estimator = complete(DEFAULT_ESTIMATOR, tip.background, tip.aspect)
        passes.append(list(estimate_frames(estimator, islice(tip.frames, FRAMES_PER_LIFT))))
    cv2.setNumThreads(1)
    apart = np.abs(np.subtract(*(np.array([of.sample.angle_deg for of in timed], float) for timed in passes)))
    gap = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
    one, two = (_timing(timed).contact.p50_ms for timed in passes)
    return Threads(one, two, gap, len(passes[0]))


RATE_HZ = 60.0
FRAMES = 216_000
WARM_UP_S = 1.0
"""Time after which the angle is evaluated; its zero is the mean over the next second."""
CONTACT = "t1:0"
_STATM = Path("/proc/self/statm")
_PAGE_MB = 4096 / 2**20


@dataclass(frozen=True, slots=True)
class Endurance:
    """Results of an hour of a static contact.

    wander_deg: largest deviation of the angle from its zero. answered: fraction of frames with an angle.
    grown_mb: growth of the resident memory from a tenth of the frames to the end; None if the system does not
    report it.
    """

    frames: int
    wander_deg: float
    answered: float
    grown_mb: float | None


def measure_endurance(
    seed: int = 0, frames: int = FRAMES, progress: Callable[[int, int, str], None] = lambda *_: None
) -> Endurance:
    """Run `slip` without skipping on a static contact with noise and drifting light."""
    background, stream = resting_frames(Scene(CONTACT, rate_hz=RATE_HZ, seed=seed))
    tracker = SlipEstimator(background, skip=False)
    angles, before = np.full(frames, np.nan), None
    shown = (Frame(next(stream), to_ns(i / RATE_HZ) + NS_PER_S, i, "") for i in range(frames))
    for i, of in enumerate(estimate_frames(tracker, shown)):
        angles[i] = np.nan if of.sample.angle_deg is None else of.sample.angle_deg
        if i == frames // 10:
            before = _resident_mb()
        if i % (frames // 100 or 1) == 0:
            progress(i, frames, f"an hour at rest: frame {i}")
    after = _resident_mb()
    first = round(WARM_UP_S * RATE_HZ)
    angles = angles[first:]
    zero = np.nanmean(angles[: round(RATE_HZ)])
    return Endurance(
        frames=frames,
        wander_deg=float(np.nanmax(np.abs(angles - zero))),
        answered=float(np.isfinite(angles).mean()),
        grown_mb=None if before is None or after is None else after - before,
    )


def _resident_mb() -> float | None:
    if not _STATM.exists():
        return None
    return int(_STATM.read_text().split()[1]) * _PAGE_MB
