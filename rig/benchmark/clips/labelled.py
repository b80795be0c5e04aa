"""Labelled clips: a folder per clip, with frames, a background, times and hand-measured angles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from drivers.formats import read_csv_rows, shown
from drivers.images import read_image
from drivers.types import Image
from rig.frames.clips import LABELS, clip_background, clip_frames
from rig.frames.series import FrameSeries, read_frames

TIMES, GROUPS = "timestamps.csv", "groups.csv"
NO_GROUP = "-"
_NEEDED = ("reference_frame", "keyframe", "angle_deg", "sigma_deg")


@dataclass(frozen=True, slots=True)
class ClipLabel:
    """An angle measured by hand at a frame (numbered from 0), counter-clockwise as seen, and its sigma."""

    frame: int
    angle_deg: float
    sigma_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class LabelledClip:
    """A clip and what is known of it.

    reference_frame: the frame whose angle is 0. labels: in the order of frames, without the reference.
    background: (H, W, 3) uint8 RGB.
    """

    name: str
    group: str
    series: FrameSeries
    background: Image
    reference_frame: int
    labels: tuple[ClipLabel, ...]


def read_clips(folder: Path, groups: Path | None = None) -> list[LabelledClip]:
    """Read all clips of a folder, or the one clip that it is, sorted by name.

    groups: CSV with columns `clip,group`; by default `groups.csv` in the folder, else the column `group` of
    each clip's labels. Raises `InputError` naming what is missing or wrong.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: give one with a folder per labelled clip")
    if (folder / LABELS).exists():
        return [_clip(folder, {})]
    own = folder / GROUPS
    table = groups or (own if own.exists() else None)
    named = {} if table is None else _groups(table)
    folders = sorted(path.parent for path in folder.glob(f"*/{LABELS}"))
    if not folders:
        raise InputError(f"{folder}: no folder in it has a {LABELS}: rig label-angle CLIP makes one")
    return [_clip(clip, named) for clip in folders]


def read_labels(path: Path) -> tuple[int, tuple[ClipLabel, ...], str]:
    """Read a clip's labels: the reference frame, the labels beside it, the group. Raises `InputError`."""
    rows = _rows(path, _NEEDED)
    references = {_number(path, line, row, "reference_frame", whole=True) for line, row in rows}
    if len(references) != 1:
        raise InputError(f"{path}: {len(references)} reference frames: keep one")
    reference = int(references.pop())
    labels = [_label(path, line, row) for line, row in rows]
    frames = [label.frame for label in labels]
    if len(set(frames)) < len(frames):
        raise InputError(f"{path}: a frame has two labels: keep one row a frame")
    beside = sorted((label for label in labels if label.frame != reference), key=lambda label: label.frame)
    if not beside:
        raise InputError(f"{path}: no label beside the reference frame {reference}: label one frame or more")
    return reference, tuple(beside), (rows[0][1].get("group") or NO_GROUP).strip()


def _label(path: Path, line: int, row: Mapping[str, str]) -> ClipLabel:
    frame = int(_number(path, line, row, "keyframe", whole=True))
    angle, sigma = (_number(path, line, row, name) for name in ("angle_deg", "sigma_deg"))
    if sigma < 0.0:
        raise InputError(f"{path}: line {line}: sigma_deg {sigma:g} is negative: give degrees from 0 on")
    return ClipLabel(frame, angle, sigma)


def _clip(folder: Path, groups: Mapping[str, str]) -> LabelledClip:
    reference, labels, group = read_labels(folder / LABELS)
    times = folder / TIMES
    series = read_frames(clip_frames(folder), times if times.exists() else None)
    count = sum(1 for _ in series.read())
    last = max(reference, *(label.frame for label in labels))
    if not 0 <= last < count:
        raise InputError(f"{folder / LABELS}: frame {last} is labelled, the clip has frames 0 to {count - 1}")
    background = clip_background(folder)
    if background is None:
        raise InputError(f"{folder}: no background.png: put one there, a frame without contact")
    named = groups.get(folder.name, group)
    return LabelledClip(folder.name, named, series, read_image(background), reference, labels)


def _groups(path: Path) -> dict[str, str]:
    return {row["clip"].strip(): row["group"].strip() for _, row in _rows(path, ("clip", "group"))}


def _rows(path: Path, needed: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    rows = read_csv_rows(path, needed)
    if not rows:
        raise InputError(f"{path}: line 2 is missing: give a row per label")
    return rows


def _number(path: Path, line: int, row: Mapping[str, str], column: str, whole: bool = False) -> float:
    text = row[column].strip()
    try:
        value = float(int(text)) if whole else float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9 or (whole and value < 0):
        wanted = "a frame's number from 0 on" if whole else "a number of degrees"
        raise InputError(f"{path}: line {line}: {column} {shown(text)}: give {wanted}")
    return value
