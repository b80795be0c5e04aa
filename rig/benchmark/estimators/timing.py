"""Run time per frame and stage of every contender in one thread."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from drivers.types import Image
from rig.benchmark.estimators.contenders import CONTENDERS, complete
from rig.benchmark.estimators.lifts import open_lift
from rig.benchmark.harness import column
from rig.frames.estimates import TimedSample, estimate_frames
from rig.frames.of_session import SessionSeries
from rig.sessions.records import FinishedLift
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.paper.axis import largest_contour
from rig.tactile.paper.published import stretched
from rig.tactile.sample import State

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
class TimingReport:
    """Everything timed in one pass.

    size_px: width and height of the frames. published: the published second stage, stretched mask to angle.
    """

    size_px: tuple[int, int]
    contenders: dict[str, Timing]
    published: Spread


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
    """Return the percentiles of durations in s, in ms; zeros if there are none."""
    values = np.asarray(durations_s if len(durations_s) else [0.0], float) * 1e3
    p50, p90, p95, p99 = (float(p) for p in np.percentile(values, PERCENTILES))
    return Spread(float(values.max()), p50, p90, p95, p99, len(durations_s))


def _time_tip(
    tip: SessionSeries,
    samples: Mapping[str, list[TimedSample]],
    published: list[float],
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
            _time_published(finder.find(turn[0].image).mask, published)


def _time_published(mask: Image | None, published: list[float]) -> None:
    """Time the script's way from a mask to an angle, which thins the full picture."""
    if mask is None:
        return
    began = time.perf_counter()
    picture = stretched(mask)
    contour = largest_contour(picture)
    filled = np.zeros(picture.shape, np.uint8)
    if contour is None or len(contour) < 5:
        return
    cv2.ellipse(filled, cv2.fitEllipse(contour), 255, -1)
    thinned = cv2.ximgproc.thinning(filled, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    lines, _ = cv2.findContours(thinned, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not lines:
        return
    cv2.fitLine(lines[0], cv2.DIST_L2, 0, 0.01, 0.001)
    published.append(time.perf_counter() - began)


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
