"""Run time per frame and stage: every contender on the same frames, one after the other, one thread."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from drivers.types import Image
from rig.benchmark.estimators.contenders import CONTENDERS, NO_SKIP, complete
from rig.benchmark.estimators.lifts import RecordedLift, Tips, open_lift
from rig.benchmark.harness import column
from rig.sessions.records import FinishedLift
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import DEFAULT_ESTIMATOR
from rig.tactile.paper.axis import largest_contour
from rig.tactile.paper.published import skeleton_angle, stretched
from rig.tactile.sample import SlipSample, State

PERCENTILES = (50, 90, 95, 99)
FRAMES_PER_LIFT = 600
"""Of a fingertip, from the grasp on: 10 s."""
TURN_FRAMES = 8
"""Frames that a contender gets in a row; the published second stage, which is slow, gets one of them."""


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
    """One contender: frame in to angle out on frames with contact, its stages, and the sum of all frames.

    total_s: over all frames, also those without contact.
    """

    contact: Spread
    stages: dict[str, Spread]
    frames: int
    total_s: float


@dataclass(frozen=True, slots=True)
class PublishedStage:
    """The published second stage: stretched mask to angle, and the thinning of its full picture alone.

    cropped: the same stage, bit for bit, if only the part of the picture that holds the contact is thinned.
    """

    stage: Spread
    thinning: Spread
    cropped: Spread


@dataclass(frozen=True, slots=True)
class Threads:
    """One OpenCV thread against two: medians in ms, and the largest difference of the angles, deg."""

    one_ms: float
    two_ms: float
    gap_deg: float
    frames: int


@dataclass(frozen=True, slots=True)
class TimingReport:
    """Everything timed in one pass. size_px: width and height of the frames."""

    size_px: tuple[int, int]
    contenders: dict[str, Timing]
    published: PublishedStage
    skip_saves: float
    threads: Threads


def time_lifts(
    folder: Path,
    tips: Tips,
    rows: Sequence[FinishedLift],
    progress: Callable[[int, int, str], None] = lambda done, total, note: None,
    names: Sequence[str] = CONTENDERS,
) -> TimingReport:
    """Time every contender on one fingertip's frames of some lifts, in this process, single-threaded.

    The contenders get a few frames in turn, in an order that moves on by one from turn to turn: a rig runs
    one of them, so that the cost of caches that the others have filled does not count.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        samples: dict[str, list[tuple[SlipSample, float]]] = {name: [] for name in names}
        stage: dict[str, list[float]] = {"stage": [], "thinning": [], "cropped": []}
        lift = open_lift(folder, tips, rows[0])
        for number, row in enumerate(rows):
            lift = open_lift(folder, tips, row)
            serial = list(tips)[number % len(tips)]
            _time_tip(lift, serial, samples, stage)
            progress(number + 1, len(rows), f"timed on lift {row.object}/{row.lift}")
        height, width = next(iter(lift.backgrounds.values())).shape[:2]
        contenders = {name: _timing(timed) for name, timed in samples.items()}
        published = PublishedStage(**{name: spread(values) for name, values in stage.items()})
        ours, whole = contenders[DEFAULT_ESTIMATOR].total_s, contenders[NO_SKIP].total_s
        return TimingReport((width, height), contenders, published, 1.0 - ours / whole, _threads(lift))
    finally:
        cv2.setNumThreads(before)


def spread(durations_s: Sequence[float]) -> Spread:
    """Return percentiles of durations in s, as ms; zeros without any."""
    values = np.asarray(durations_s if len(durations_s) else [0.0], float) * 1e3
    p50, p90, p95, p99 = (float(p) for p in np.percentile(values, PERCENTILES))
    return Spread(float(values.max()), p50, p90, p95, p99, len(durations_s))


def _time_tip(
    lift: RecordedLift,
    serial: str,
    samples: Mapping[str, list[tuple[SlipSample, float]]],
    stage: Mapping[str, list[float]],
) -> None:
    background, tip, names = lift.backgrounds[serial], lift.tips[serial], list(samples)
    estimators = {name: complete(name, background, tip.pixel_aspect, tip.sign) for name in names}
    finder = ContactFinder(background)
    frames = islice(lift.frames(serial), FRAMES_PER_LIFT)
    for number in count():
        turn = list(islice(frames, TURN_FRAMES))
        if not turn:
            return
        first = number % len(names)
        for name in names[first:] + names[:first]:
            for frame in turn:
                began = time.perf_counter()
                sample = estimators[name].update(frame.image, frame.time_ns)
                samples[name].append((sample, time.perf_counter() - began))
        _time_published(finder.find(turn[0].image).mask, stage)


def _time_published(mask: Image | None, stage: Mapping[str, list[float]]) -> None:
    """Time the script's way from a mask to an angle, with the full and with the cropped picture."""
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


def _timing(timed: Sequence[tuple[SlipSample, float]]) -> Timing:
    touching = [(s, cost) for s, cost in timed if s.state is not State.NO_CONTACT]
    names = dict.fromkeys(stage for s, _ in touching for stage in s.stage_s)
    return Timing(
        contact=spread([cost for _, cost in touching]),
        stages={n: spread([s.stage_s[n] for s, _ in touching if n in s.stage_s]) for n in names},
        frames=len(timed),
        total_s=sum(cost for _, cost in timed),
    )


def _threads(lift: RecordedLift) -> Threads:
    """Run the default estimator on one fingertip's frames with one OpenCV thread and with two."""
    serial = next(iter(lift.tips))
    costs: dict[int, list[float]] = {1: [], 2: []}
    angles: dict[int, list[float]] = {1: [], 2: []}
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        estimator = complete(DEFAULT_ESTIMATOR, lift.backgrounds[serial], lift.tips[serial].pixel_aspect)
        for frame in islice(lift.frames(serial), FRAMES_PER_LIFT):
            began = time.perf_counter()
            sample = estimator.update(frame.image, frame.time_ns)
            if sample.state is not State.NO_CONTACT:
                costs[threads].append(1e3 * (time.perf_counter() - began))
            angles[threads].append(np.nan if sample.angle_deg is None else sample.angle_deg)
    cv2.setNumThreads(1)
    apart = np.abs(np.subtract(angles[1], angles[2]))
    gap = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
    one, two = (float(np.median(costs[threads])) if costs[threads] else 0.0 for threads in (1, 2))
    return Threads(one, two, gap, len(angles[1]))
