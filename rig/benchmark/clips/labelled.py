"""Labelled clips: a folder per clip with frames, a background, times and angles labelled by hand.

Frames are images, a video or a ROS bag. The trials of TactileTracking are read in their published
layout. Their angles are known in every frame; one every half second becomes a label.

Further versions of a clip are mirrored left-right, flipped top-bottom, and reversed in time. The labels are
transformed with the frames. An estimator that is overfitted to the objects, the light or the direction of
rotation of the clips has larger errors on these versions.
"""

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import InputError, no_such, unknown_name
from drivers.formats import number_in, quote, read_csv_rows, whole_in
from drivers.images import read_image
from drivers.types import Image
from rig.frames.clips import (
    LABELS,
    TIMES,
    TRIAL_VIDEO,
    clip_background,
    clip_frames,
    is_trial,
    trial_turns_deg,
)
from rig.frames.series import FrameSeries, TimedFrame, make_background, read_frames
from rig.frames.times import FrameTime
from rig.results.scores import AXIS_DEG, unwrap
from rig.tactile.angles import Angles

GROUPS, CONTACTS = "groups.csv", "contacts.csv"
NO_GROUP = "-"
LABEL_EVERY_NS = NS_PER_S // 2  # interval of the labels in public sets
_log = logging.getLogger(__name__)
_NEEDED = ("reference_frame", "keyframe", "angle_deg", "sigma_deg")


class ClipVersion(StrEnum):
    PLAIN = "plain"
    MIRROR = "mirror"
    FLIP = "flip"
    REVERSE = "reverse"


@dataclass(frozen=True, slots=True)
class ClipLabel:
    """An angle labelled by hand. frame: number from 0. angle_deg: counter-clockwise positive in the image."""

    frame: int
    angle_deg: float
    sigma_deg: float


@dataclass(frozen=True, slots=True)
class ContactSpan:
    """Consecutive frames, from `first` to `last` inclusive, that are all with or all without contact."""

    first: int
    last: int
    contact: bool


@dataclass(frozen=True, slots=True, eq=False)
class LabelledClip:
    name: str
    group: str
    series: FrameSeries
    background: Image  # (H, W, 3) uint8 RGB
    reference_frame: int  # number of the frame whose angle is 0
    labels: tuple[ClipLabel, ...]  # in order of frames, without the reference
    contacts: tuple[ContactSpan, ...] = ()  # frames with known contact state
    version: ClipVersion = ClipVersion.PLAIN


def read_clips(
    folder: Path, groups: Path | None = None, sign: int = 1, topic: str | None = None
) -> list[LabelledClip]:
    """Read one clip, or all clips of a folder sorted by name.

    folder: of the clips, or of one clip. groups: CSV with columns `clip,group`; by default `groups.csv` in
    the folder, else the column `group` of the labels. sign: -1 to negate the known angles of public sets.
    topic: image topic of ROS bags, see `read_frames`. Raises `InputError` if a file is missing or invalid.
    """
    if is_trial(folder):
        return [public_clip(folder, folder.stem, sign)]
    if not folder.is_dir():
        raise InputError(no_such(folder, "folder", "give one with a folder per labelled clip"))
    if (folder / LABELS).exists():
        return [_clip(folder, {}, topic)]
    own = folder / GROUPS
    table = groups or (own if own.exists() else None)
    rows = _rows(table, ("clip", "group")) if table else []
    named = {row["clip"].strip(): row["group"].strip() for _, row in rows}
    if folders := sorted(path.parent for path in folder.glob(f"*/{LABELS}")):
        return [_clip(clip, named, topic) for clip in folders]
    trials = sorted(path.parent for path in folder.rglob(TRIAL_VIDEO) if is_trial(path.parent))
    if not trials:
        raise InputError(f"{folder}: no folder in it has a {LABELS}: make one with rig label-angle CLIP")
    public = [public_clip(trial, str(trial.relative_to(folder)), sign) for trial in trials]
    return [replace(clip, group=named.get(clip.name, clip.group)) for clip in public]


def public_clip(path: Path, name: str, sign: int = 1) -> LabelledClip:
    """Read one trial of TactileTracking. Its group is the object. Raises `InputError`."""
    series = read_frames(path)
    background, _ = make_background(None, series)
    times_ns = [frame.time.time_ns for frame in series.read()]
    labels, last_ns = [], times_ns[0]
    for place, turn_deg in enumerate(trial_turns_deg(path, len(times_ns))):
        if times_ns[place] - last_ns >= LABEL_EVERY_NS:
            labels.append(ClipLabel(place, sign * float(turn_deg), 0.0))
            last_ns = times_ns[place]
    if not labels:
        raise InputError(f"{path}: is shorter than half a second, so there is no label to compare with")
    group = path.name.rstrip("0123456789")
    return LabelledClip(name, group, series, background, 0, tuple(labels))


def read_labels(path: Path) -> tuple[int, tuple[ClipLabel, ...], str]:
    """Read the labels of a clip; return reference frame, other labels and group. Raises `InputError`."""
    rows = _rows(path, _NEEDED)
    references = {_number(path, line, row, "reference_frame", whole=True) for line, row in rows}
    if len(references) != 1:
        raise InputError(f"{path}: {len(references)} reference frames: keep one")
    reference = int(references.pop())
    labels = []
    for line, row in rows:
        frame = int(_number(path, line, row, "keyframe", whole=True))
        angle, sigma = (_number(path, line, row, name) for name in ("angle_deg", "sigma_deg"))
        if sigma < 0.0:
            raise InputError(f"{path}: line {line}: sigma_deg {sigma:g} is negative: give 0 or more")
        labels.append(ClipLabel(frame, angle, sigma))
    frames = [label.frame for label in labels]
    if len(set(frames)) < len(frames):
        raise InputError(f"{path}: a frame has two labels: keep one row per frame")
    beside = sorted((label for label in labels if label.frame != reference), key=lambda label: label.frame)
    if not beside:
        raise InputError(f"{path}: no label except the reference frame {reference}: label at least one frame")
    return reference, tuple(beside), (rows[0][1].get("group") or NO_GROUP).strip()


def _clip(folder: Path, groups: Mapping[str, str], topic: str | None) -> LabelledClip:
    reference, labels, group = read_labels(folder / LABELS)
    times = folder / TIMES
    series = read_frames(clip_frames(folder), times if times.exists() else None, topic=topic)
    times_s = [frame.time.time_ns / NS_PER_S for frame in series.read()]
    count = len(times_s)
    last = max(reference, *(label.frame for label in labels))
    if not 0 <= last < count:
        raise InputError(
            f"{folder / LABELS}: frame {last} is labelled, but the clip has frames 0 to {count - 1}"
        )
    background = clip_background(folder)
    if background is None:
        raise InputError(f"{folder}: no background.png: add a frame without contact under this name")
    contacts = folder / CONTACTS
    return LabelledClip(
        name=f"SIMULATED {folder.name}" if series.simulated else folder.name,
        group=groups.get(folder.name, group),
        series=series,
        background=read_image(background),
        reference_frame=reference,
        labels=_unwrap(folder / LABELS, labels, reference, times_s),
        contacts=_contacts(contacts, count) if contacts.exists() else (),
    )


def _unwrap(
    path: Path, labels: Sequence[ClipLabel], reference: int, times_s: Sequence[float]
) -> tuple[ClipLabel, ...]:
    """Return labels without the steps of a wrapped angle, see `unwrap`; its notes are logged.

    reference: number of the frame whose angle is 0. times_s: of all frames.
    """
    rows = sorted([*labels, ClipLabel(reference, 0.0, 0.0)], key=lambda label: label.frame)
    since_s = np.array([times_s[row.frame] - times_s[0] for row in rows])
    labelled = Angles(since_s, np.array([row.angle_deg for row in rows]))
    plain, notes = unwrap(f"{path}: the labelled angle", labelled, AXIS_DEG)
    for note in notes:
        _log.warning(note)
    turns_deg = plain.angle_deg - labelled.angle_deg
    turns_deg -= turns_deg[[row.frame for row in rows].index(reference)]
    return tuple(
        replace(row, angle_deg=row.angle_deg + float(turn))
        for row, turn in zip(rows, turns_deg, strict=True)
        if row.frame != reference
    )


def _contacts(path: Path, frames: int) -> tuple[ContactSpan, ...]:
    """Read the spans of frames with and without contact. frames: of the clip. Raises `InputError`."""
    spans = []
    for line, row in _rows(path, ("first", "last", "contact")):
        first, last = (int(_number(path, line, row, name, whole=True)) for name in ("first", "last"))
        if not first <= last < frames:
            raise InputError(
                f"{path}: line {line}: frames {first} to {last}: the clip has frames 0 to {frames - 1}; "
                "give the first frame, then the last"
            )
        if row["contact"].strip() not in ("yes", "no"):
            raise InputError(f"{path}: line {line}: contact {quote(row['contact'])}: give yes or no")
        spans.append(ContactSpan(first, last, row["contact"].strip() == "yes"))
    return tuple(spans)


def _rows(path: Path, needed: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    rows = read_csv_rows(path, needed)
    if not rows:
        raise InputError(f"{path}: line 2 is missing: give at least one row")
    return rows


def _number(path: Path, line: int, row: Mapping[str, str], column: str, whole: bool = False) -> float:
    where = f"{path}: line {line}"
    value = whole_in(row, column, where) if whole else number_in(row, column, where)
    if abs(value) >= 1e9 or (whole and value < 0):
        wanted = "the number of a frame, from 0" if whole else "a number of degrees"
        raise InputError(f"{where}: {column} {quote(row[column])}: give {wanted}")
    return value


_IMAGE_AXIS = {ClipVersion.MIRROR: 1, ClipVersion.FLIP: 0}


def chosen_versions(text: str | None) -> tuple[ClipVersion, ...]:
    """Return the plain version and those of a comma-separated list. Raises `InputError`."""
    versions = [ClipVersion.PLAIN]
    for name in (part.strip() for part in (text or "").split(",")):
        if name and name not in [*ClipVersion]:
            raise InputError(unknown_name("version", name, [*ClipVersion][1:]))
        if name and ClipVersion(name) not in versions:
            versions.append(ClipVersion(name))
    return tuple(versions)


def clip_version(clip: LabelledClip, version: ClipVersion) -> LabelledClip:
    """Return a clip in a version, with the version in its name; the plain version is the clip itself."""
    if version is ClipVersion.PLAIN:
        return clip
    found = _backwards(clip) if version is ClipVersion.REVERSE else _mirror(clip, _IMAGE_AXIS[version])
    return replace(found, name=f"{clip.name} ({version})", version=version)


def _mirror(clip: LabelledClip, axis: int) -> LabelledClip:
    """Return a clip with frames and background mirrored along an image axis, which negates all angles."""

    def flip(image: Image) -> Image:
        return np.ascontiguousarray(np.flip(image, axis))

    def read() -> Iterator[TimedFrame]:
        for frame in clip.series.read():
            yield replace(frame, image=None if frame.image is None else flip(frame.image))

    return replace(
        clip,
        series=FrameSeries(clip.series.name, read, clip.series.notes),
        background=flip(clip.background),
        labels=tuple(replace(label, angle_deg=-label.angle_deg) for label in clip.labels),
    )


def _backwards(clip: LabelledClip) -> LabelledClip:
    """Return a clip that runs backwards from its last labelled frame, which becomes the reference.

    The background is unchanged. The former reference becomes a label. The intervals between frames keep their
    lengths, in reversed order.
    """
    reference = ClipLabel(clip.reference_frame, 0.0, 0.0)
    *earlier, last = sorted([*clip.labels, reference], key=lambda label: label.frame)
    surest_deg = min(label.sigma_deg for label in clip.labels)

    def read() -> Iterator[TimedFrame]:
        frames = [frame for number, frame in enumerate(clip.series.read()) if number <= last.frame]
        first_ns, last_ns = frames[0].time.time_ns, frames[-1].time.time_ns
        for frame in reversed(frames):
            time_ns = first_ns + last_ns - frame.time.time_ns
            yield replace(frame, time=FrameTime(f"{time_ns / NS_PER_S:.6f}", time_ns))

    def relative(label: ClipLabel) -> ClipLabel:
        # The variance of a label is the sum of those of two lines drawn by hand, one of them at the
        # reference. The line at the reference cancels in the difference of two labels. Its variance is
        # assumed to be half of the smallest variance of a label.
        common = 0.0 if reference in (label, last) else surest_deg**2
        variance = label.sigma_deg**2 + last.sigma_deg**2 - common
        return ClipLabel(last.frame - label.frame, label.angle_deg - last.angle_deg, math.sqrt(variance))

    spans = [
        ContactSpan(last.frame - min(span.last, last.frame), last.frame - span.first, span.contact)
        for span in clip.contacts
        if span.first <= last.frame
    ]
    return replace(
        clip,
        series=FrameSeries(clip.series.name, read, clip.series.notes),
        reference_frame=0,
        labels=tuple(relative(label) for label in reversed(earlier)),
        contacts=tuple(reversed(spans)),
    )
