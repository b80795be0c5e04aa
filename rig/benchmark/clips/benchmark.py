"""`rig benchmark clips`: any estimators on labelled clips, side by side.

`rotation_clip_halves.csv` divides 24 real clips of a GelSight Mini in two halves by object: of all such
divisions the one whose halves are most nearly as hard as one another (mean errors and shares within limits
of the estimator that was there before). Whatever is tuned on clips is tuned on the one named `development`.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2

from rig.benchmark.clips.labelled import LabelledClip, read_clips
from rig.benchmark.clips.limits import ClipLimits, judge
from rig.benchmark.clips.scores import ClipScore, JudgedLabel, score
from rig.benchmark.harness import machine
from rig.benchmark.measured import Measured
from rig.frames.estimates import Answer, Estimate, zeroed
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.foreign import EstimatorFaults, faults_of
from rig.tactile.sample import SlipSample, State, TactileEstimator

SCHEMA = 1
ESTIMATORS = ("slip", "ecc", "polar", "ellipse", "pca", "anglenet")
"""Those that stand beside one another in the README."""

Progress = Callable[[int, int, str], None]
"""Called with how many clips are done, of how many, and the name of the last one."""


@dataclass(frozen=True, slots=True, eq=False)
class ClipRun:
    """One estimator on one clip.

    estimate: its answers from the clip's reference. frame_ms: (N,) time of each frame. contacts: see `score`.
    """

    clip: LabelledClip
    estimate: Estimate
    labels: tuple[JudgedLabel, ...]
    frame_ms: tuple[float, ...]
    has_sigma: bool
    contacts: tuple[tuple[bool, bool], ...]

    @property
    def score(self) -> ClipScore:
        """Figures of this clip."""
        return score(self.labels, self.frame_ms, self.has_sigma, self.contacts)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorRuns:
    """One estimator on all clips. groups: its figures by group, in the order of names."""

    name: str
    runs: tuple[ClipRun, ...]
    overall: ClipScore
    groups: dict[str, ClipScore]

    @property
    def faults(self) -> EstimatorFaults | None:
        """Where an estimator that is not the rig's own failed on frames."""
        return faults_of(answer.sample for run in self.runs for answer in run.estimate.answers)


@dataclass(frozen=True, slots=True, eq=False)
class ClipsResult:
    """Everything measured. limits: of the first estimator, over `group`, all clips where that is None."""

    folder: Path
    group: str | None
    estimators: tuple[EstimatorRuns, ...]
    limits: tuple[Measured, ...]
    wall_s: float

    @property
    def faults(self) -> dict[str, EstimatorFaults]:
        """What estimators failed, by name."""
        return {of.name: of.faults for of in self.estimators if of.faults}


def run_clips(
    folder: Path,
    choices: Sequence[EstimatorChoice],
    limits: ClipLimits,
    groups: Path | None = None,
    progress: Progress = lambda *_: None,
    sign: int = 1,
) -> ClipsResult:
    """Let every estimator answer all clips, in this process. Raises `InputError` for what is no clip.

    sign: of the known turns of public sets, see `read_clips`.
    """
    cv2.setNumThreads(1)
    began = time.perf_counter()
    clips = read_clips(folder, groups, sign)
    limits.check(clips)
    runs: list[list[ClipRun]] = [[] for _ in choices]
    for done, clip in enumerate(clips, 1):
        for choice, of in zip(choices, runs, strict=True):
            of.append(run_clip(clip, choice))
        progress(done, len(clips), clip.name)
    estimators = tuple(_summed(choice, of) for choice, of in zip(choices, runs, strict=True))
    first = estimators[0]
    counted = first.overall if limits.group is None else first.groups[limits.group]
    return ClipsResult(folder, limits.group, estimators, judge(counted, limits), time.perf_counter() - began)


def run_clip(clip: LabelledClip, choice: EstimatorChoice) -> ClipRun:
    """Let one estimator answer one clip."""
    answers, frame_ms = _timed(clip, choice.make(clip.background))
    estimate = zeroed(answers, answers[clip.reference_frame].time)
    labels = tuple(_judged(clip, estimate))
    has_sigma = any(sigma is not None for sigma in estimate.sigmas_deg)
    return ClipRun(clip, estimate, labels, tuple(frame_ms), has_sigma, tuple(_reported(clip, answers)))


def as_json(result: ClipsResult) -> dict[str, Any]:
    """Return the result as JSON values, with what it was measured on."""
    return {
        "schema": SCHEMA,
        "folder": str(result.folder),
        "machine": machine(),
        "estimators": {of.name: _estimator_json(of) for of in result.estimators},
        "faults": {name: asdict(faults) for name, faults in result.faults.items()},
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _timed(clip: LabelledClip, estimator: TactileEstimator) -> tuple[list[Answer], list[float]]:
    answers: list[Answer] = []
    frame_ms: list[float] = []
    for frame in clip.series:
        sample = SlipSample(frame.time.time_ns, State.LOST)
        if frame.image is not None:
            began = time.perf_counter()
            sample = estimator.update(frame.image, frame.time.time_ns)
            frame_ms.append(1e3 * (time.perf_counter() - began))
        answers.append(Answer(frame.time, sample))
    return answers, frame_ms


def _judged(clip: LabelledClip, estimate: Estimate) -> list[JudgedLabel]:
    angles, sigmas = estimate.angles_deg, estimate.sigmas_deg
    start = clip.reference_frame
    return [
        JudgedLabel(
            clip.name, label, angles[label.frame], sigmas[label.frame], _held(angles[start : label.frame + 1])
        )
        for label in clip.labels
    ]


def _reported(clip: LabelledClip, answers: Sequence[Answer]) -> Iterator[tuple[bool, bool]]:
    """Yield, for each frame of a contact span, whether it is in contact and whether it was reported so."""
    for span in clip.contacts:
        for answer in answers[span.first : span.last + 1]:
            yield span.contact, answer.sample.state is not State.NO_CONTACT


def _held(angles: Sequence[float | None]) -> float:
    """Return the last angle answered, 0 before any."""
    return next((angle for angle in reversed(angles) if angle is not None), 0.0)


def _summed(choice: EstimatorChoice, runs: Sequence[ClipRun]) -> EstimatorRuns:
    names = sorted({run.clip.group for run in runs})
    groups = {name: _together([run for run in runs if run.clip.group == name]) for name in names}
    return EstimatorRuns(choice.name, tuple(runs), _together(runs), groups)


def _together(runs: Sequence[ClipRun]) -> ClipScore:
    labels = [label for run in runs for label in run.labels]
    frame_ms = [ms for run in runs for ms in run.frame_ms]
    contacts = [contact for run in runs for contact in run.contacts]
    return score(labels, frame_ms, any(run.has_sigma for run in runs), contacts)


def _estimator_json(of: EstimatorRuns) -> dict[str, Any]:
    return {
        "all": asdict(of.overall),
        "groups": {name: asdict(found) for name, found in of.groups.items()},
        "clips": {run.clip.name: _clip_json(run) for run in of.runs},
    }


def _clip_json(run: ClipRun) -> dict[str, Any]:
    labels = [
        {
            "frame": judged.label.frame,
            "label_deg": judged.label.angle_deg,
            "label_sigma_deg": judged.label.sigma_deg,
            "angle_deg": judged.angle_deg,
            "sigma_deg": judged.sigma_deg,
            "error_deg": judged.error_deg,
        }
        for judged in run.labels
    ]
    zero = run.estimate.zero_note
    return {"group": run.clip.group, "zero": zero, **asdict(run.score), "by_label": labels}
