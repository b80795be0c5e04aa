"""`rig benchmark contact`: how often estimators say contact where there is one, and where there is none."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2

from drivers.errors import EstimatorError, InputError
from drivers.types import Image
from rig.benchmark.contact.spans import ContactClip, FrameSpan
from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.harness import machine
from rig.benchmark.measured import Measured, at_least, at_most
from rig.frames.series import FrameSeries, read_frames
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import State

SCHEMA = 1
MOST_EMPTY, LEAST_HELD = 0.05, 0.95
Progress = Callable[[int, int, str], None]
"""Called with how many clips are done, of how many, and the name of the last one."""


@dataclass(frozen=True, slots=True)
class ContactCounts:
    """Frames of one kind, and how many of them were told as contact."""

    frames: int
    told: int

    @property
    def share(self) -> float | None:
        """The share told as contact, None without frames."""
        return self.told / self.frames if self.frames else None

    def __add__(self, other: "ContactCounts") -> "ContactCounts":
        return ContactCounts(self.frames + other.frames, self.told + other.told)


@dataclass(frozen=True, slots=True)
class ContactScore:
    """One estimator's answers on one clip, or on all of them."""

    empty: ContactCounts = ContactCounts(0, 0)
    held: ContactCounts = ContactCounts(0, 0)

    def __add__(self, other: "ContactScore") -> "ContactScore":
        return ContactScore(self.empty + other.empty, self.held + other.held)


@dataclass(frozen=True, slots=True)
class ContactResult:
    """Everything measured. clips: by estimator and clip. limits: of the first estimator."""

    folder: Path
    clips: dict[str, dict[str, ContactScore]]
    limits: tuple[Measured, ...]
    wall_s: float

    def overall(self, estimator: str) -> ContactScore:
        """Return one estimator's answers on all clips together."""
        return sum(self.clips[estimator].values(), ContactScore())


def run_contact(
    folder: Path,
    clips: Sequence[ContactClip],
    choices: Sequence[EstimatorChoice],
    most_empty: float = MOST_EMPTY,
    least_held: float = LEAST_HELD,
    progress: Progress = lambda *_: None,
) -> ContactResult:
    """Let every estimator see all frames of all clips. Raises `InputError` for clips that are not there."""
    cv2.setNumThreads(1)
    began = time.perf_counter()
    found: dict[str, dict[str, ContactScore]] = {choice.name: {} for choice in choices}
    for done, clip in enumerate(clips, 1):
        background = mean_background(_images(folder, clip.background))
        for choice in choices:
            found[choice.name][clip.clip] = _score(folder, clip, background, choice)
        progress(done, len(clips), clip.clip)
    first = sum(found[choices[0].name].values(), ContactScore())
    limits = (
        at_most("share of emptied frames told as contact", first.empty.share, most_empty),
        at_least("share of held frames told as contact", first.held.share, least_held),
    )
    return ContactResult(folder, found, limits, time.perf_counter() - began)


def contact_table(result: ContactResult) -> BenchmarkTable:
    """Return a row per estimator and clip, all clips first."""
    rows = [
        (name if clip == "all" else "", clip, *_cells(score))
        for name, clips in result.clips.items()
        for clip, score in {"all": result.overall(name), **clips}.items()
    ]
    columns = ("estimator", "clip", "empty frames", "told as contact", "held frames", "told as contact")
    return BenchmarkTable("Contact told from an empty gel", columns, rows)


def as_json(result: ContactResult) -> dict[str, Any]:
    """Return the result as JSON values, with what it was measured on."""
    estimators = {
        name: {"all": asdict(result.overall(name)), "clips": {c: asdict(s) for c, s in clips.items()}}
        for name, clips in result.clips.items()
    }
    return {
        "schema": SCHEMA,
        "folder": str(result.folder),
        "machine": machine(),
        "estimators": estimators,
        "limits": [asdict(limit) for limit in result.limits],
        "wall_s": round(result.wall_s, 1),
    }


def _score(folder: Path, clip: ContactClip, background: Image, choice: EstimatorChoice) -> ContactScore:
    estimator, told = choice.make(background), []
    for frame in _series(folder, clip.clip):
        sample = None if frame.image is None else estimator.update(frame.image, frame.time.time_ns)
        if sample is not None and sample.fault:
            raise EstimatorError(f"{clip.clip}: {sample.fault}")
        told.append(sample is not None and sample.state is not State.NO_CONTACT)
    return ContactScore(_counts(told, clip.empty), _counts(told, clip.held))


def _counts(told: Sequence[bool], spans: Sequence[FrameSpan]) -> ContactCounts:
    for span in spans:
        if span.last >= len(told):
            raise InputError(
                f"{span.clip}: frame {span.last} is named, the clip has {len(told)}: correct the table"
            )
    frames = [told[number] for span in spans for number in range(span.first, span.last + 1)]
    return ContactCounts(len(frames), sum(frames))


def _images(folder: Path, span: FrameSpan) -> list[Image]:
    """Return the frames of a span. Raises `InputError` where there are fewer."""
    images = list(islice(_series(folder, span.clip).images(), span.first, span.last + 1))
    if len(images) < span.last + 1 - span.first:
        raise InputError(f"{span.clip}: has no frames {span.first} to {span.last}: correct the table")
    return images


def _series(folder: Path, clip: str) -> FrameSeries:
    return read_frames(folder / clip)


def _cells(score: ContactScore) -> tuple[str, ...]:
    return tuple(
        text for counts in (score.empty, score.held) for text in (str(counts.frames), _share(counts.share))
    )


def _share(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}%"
