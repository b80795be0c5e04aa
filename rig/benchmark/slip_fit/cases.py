"""Clips and lifts with known angles, stored as plain arrays, and the likelihood of their angles.

The images are stored once and read as memory maps, because the estimator runs on each case many times.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from protocols.observer import Phase
from rig.benchmark.clips.labelled import LabelledClip
from rig.benchmark.renderer import BACKGROUND_FRAMES, LIFT_NS, SIGNS, draw_course, frames
from rig.benchmark.seeds import LiftCase, recorded_lift
from rig.config import BenchConfig
from rig.frames.of_session import recording_frames
from rig.lift.object_angle import TipTrack, object_angle
from rig.lift.recording import recorded_truth
from rig.sessions.reading import phase_times
from rig.tactile.contact.background import mean_background
from rig.tactile.sample import SlipSample
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.parameters import Values, use

STRIDE = 15
"""Every 15th frame of a lift counts, because the errors of neighbouring frames are correlated."""
RESOLUTION_DEG = 0.3
"""Errors below the one of the markers (contract) do not matter; added to sigma."""
OUTLIERS, ANY_DEG = 0.01, 120.0
"""Fraction of outliers, as many as may be confidently wrong. Outliers and refused angles are uniformly
distributed over this range, degrees."""
TRUTH = "truth.npz"


class Kind(StrEnum):
    """Where a case comes from."""

    CLIP = "clips"
    RENDERER = "second renderer"
    EASY = "bench fake"
    HARD = "bench hard"


@dataclass(frozen=True, slots=True)
class Case:
    """A clip or a lift in a folder. unit: cases of the same unit are versions of each other."""

    kind: Kind
    unit: str
    folder: Path

    @property
    def stored(self) -> bool:
        """Whether the folder is complete; the truth is written last."""
        return (self.folder / TRUTH).exists()


@dataclass(frozen=True, slots=True, eq=False)
class Tip:
    """The frames of one fingertip, (N, H, W, 3) uint8, and their times, (N,) ns. aspect: None if unknown."""

    sign: int
    aspect: float | None
    background: Image
    times_ns: NDArray[np.int64]
    images: Image


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true angles, degrees, with sigmas and times. zero_ns: begin of the lift, or the reference."""

    zero_ns: int
    end_ns: int
    times_ns: NDArray[np.int64]
    angles_deg: NDArray[np.float64]
    sigmas_deg: NDArray[np.float64]


def store_clip(folder: Path, clip: LabelledClip, unit: str) -> Case:
    """Store a clip with its labels, unless it is stored. unit: name of the clip that this is a version of."""
    case = Case(Kind.CLIP, unit, folder)
    if case.stored:
        return case
    read = list(clip.series.read())
    times = np.array([frame.time.time_ns for frame in read], np.int64)
    labels = clip.labels
    truth = Truth(
        int(times[clip.reference_frame]),
        int(times[-1]),
        times[[label.frame for label in labels]],
        np.array([label.angle_deg for label in labels]),
        np.array([label.sigma_deg for label in labels]),
    )
    shown = _arrays((frame.time.time_ns, frame.image) for frame in read)
    _store(folder, [Tip(1, None, clip.background, *shown)], truth)
    return case


def store_rendered(folder: Path, lift: int) -> Case:
    """Draw and store a lift of the second renderer, unless it is stored."""
    case = Case(Kind.RENDERER, folder.name, folder)
    if case.stored:
        return case
    course, tips = draw_course(lift), []
    for tip, sign in enumerate(SIGNS):
        drawn = list(frames(lift, tip))
        background = mean_background([frame.image for frame in islice(drawn, BACKGROUND_FRAMES)])
        shown = drawn[BACKGROUND_FRAMES:]
        tips.append(Tip(sign, 1.0, background, *_arrays((f.time_ns, f.image) for f in shown)))
    times = np.array([course.time_ns(number) for number in range(len(course.turn_deg))], np.int64)
    truth = Truth(LIFT_NS, int(times[-1]), times, course.turn_deg, np.zeros(len(times)))
    _store(folder, tips, truth)
    return case


def store_lift(folder: Path, bench: BenchConfig, lift: LiftCase) -> Case:
    """Carry out a lift on a simulated bench and store its frames, unless they are stored."""
    case = Case(Kind.HARD if bench.difficulty == "hard" else Kind.EASY, folder.name, folder)
    if case.stored:
        return case
    with recorded_lift(bench, lift) as (recording, _):
        phases, series = phase_times(recording), recorded_truth(recording)
        tips = [
            Tip(t.sign, t.aspect, t.background, *_arrays((f.time.time_ns, f.image) for f in t.frames.read()))
            for t in recording_frames(recording)
        ]
        span = phases[Phase.LIFT], phases[Phase.LOWER]
        truth = Truth(*span, series.time_ns, series.angle_deg, series.sigma_deg)
        _store(folder, tips, truth)
    return case


def penalty(values: Values, case: Case) -> float:
    """Return the mean negative log likelihood of the true angles of a case, given the reported ones.

    Runs in a worker process, and leaves `values` in use there.
    """
    cv2.setNumThreads(1)
    use(values)
    truth, tips = _truth(case.folder), _tips(case.folder)
    samples = [_samples(tip) for tip in tips]
    known = _at_labels(samples[0], truth) if case.kind is Kind.CLIP else _in_lift(tips, samples, truth)
    return float(np.mean([surprise(*one) for one in known]))


def surprise(
    angle_deg: float | None, sigma_deg: float | None, true_deg: float, true_sigma_deg: float
) -> float:
    """Return the negative log likelihood of a true angle, given an answer and its sigma."""
    outlier = 1.0 / ANY_DEG
    if angle_deg is None or sigma_deg is None:
        return -math.log(outlier)
    variance = sigma_deg**2 + true_sigma_deg**2 + RESOLUTION_DEG**2
    normal = math.exp(-0.5 * (angle_deg - true_deg) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
    return -math.log((1.0 - OUTLIERS) * normal + OUTLIERS * outlier)


Known = tuple[float | None, float | None, float, float]
"""Angle and sigma, true angle and its sigma, degrees."""


def _at_labels(samples: Sequence[SlipSample], truth: Truth) -> Iterator[Known]:
    track = TipTrack(1, list(samples))
    later = [s for s in samples if s.time_ns >= truth.zero_ns and s.angle_deg is not None]
    track.zero_sample = later[0] if later else None
    track.zero_deg = later[0].angle_deg if later else None
    by_time = {sample.time_ns: sample for sample in samples}
    for time_ns, angle, sigma in zip(truth.times_ns, truth.angles_deg, truth.sigmas_deg, strict=True):
        sample = by_time.get(int(time_ns))
        if sample is None:
            yield None, None, angle, sigma
        else:
            answer = track.answer(sample)
            yield answer.angle_deg, answer.sigma_deg, angle, sigma


def _in_lift(tips: Sequence[Tip], samples: Sequence[Sequence[SlipSample]], truth: Truth) -> Iterator[Known]:
    names = [str(number) for number in range(len(tips))]
    angle = object_angle(
        {name: tip.sign for name, tip in zip(names, tips, strict=True)},
        dict(zip(names, samples, strict=True)),
        truth.zero_ns,
    )
    answers = [
        [(s.time_ns, (of := tip.answer(s)).angle_deg, of.sigma_deg) for s in tip.samples]
        for tip in angle.tips.values()
    ]
    answers.append([(s.time_ns, s.angle_deg, s.sigma_deg) for s in angle.fused][:: len(tips)])
    for series in answers:
        inside = [one for one in series if truth.zero_ns <= one[0] < truth.end_ns]
        for time_ns, angle_deg, sigma_deg in inside[::STRIDE]:
            true = float(np.interp(time_ns, truth.times_ns, truth.angles_deg))
            yield angle_deg, sigma_deg, true, float(np.interp(time_ns, truth.times_ns, truth.sigmas_deg))


def _samples(tip: Tip) -> list[SlipSample]:
    estimator = SlipEstimator(tip.background, tip.aspect)
    return [
        estimator.update(np.asarray(image), int(time_ns))
        for image, time_ns in zip(tip.images, tip.times_ns, strict=True)
    ]


def _arrays(frames: Iterable[tuple[int, Image | None]]) -> tuple[NDArray[np.int64], Image]:
    shown = [(time_ns, image) for time_ns, image in frames if image is not None]
    return np.array([time_ns for time_ns, _ in shown], np.int64), np.stack([image for _, image in shown])


def _store(folder: Path, tips: Sequence[Tip], truth: Truth) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, tip in enumerate(tips):
        np.save(folder / f"images_{number}.npy", tip.images)
        np.savez(
            folder / f"tip_{number}.npz",
            sign=tip.sign,
            aspect=math.nan if tip.aspect is None else tip.aspect,
            background=tip.background,
            times_ns=tip.times_ns,
        )
    span = {"zero_ns": truth.zero_ns, "end_ns": truth.end_ns, "times_ns": truth.times_ns}
    np.savez(folder / TRUTH, **span, angles_deg=truth.angles_deg, sigmas_deg=truth.sigmas_deg)


def _truth(folder: Path) -> Truth:
    of = np.load(folder / TRUTH)
    return Truth(int(of["zero_ns"]), int(of["end_ns"]), of["times_ns"], of["angles_deg"], of["sigmas_deg"])


def _tips(folder: Path) -> list[Tip]:
    tips = []
    for number in range(len(list(folder.glob("tip_*.npz")))):
        of = np.load(folder / f"tip_{number}.npz")
        aspect = float(of["aspect"])
        images = np.load(folder / f"images_{number}.npy", mmap_mode="r")
        known = None if math.isnan(aspect) else aspect
        tips.append(Tip(int(of["sign"]), known, of["background"], of["times_ns"], images))
    return tips
