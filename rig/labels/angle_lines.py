"""Angles from lines that a person draws twice on chosen frames of a clip."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import InputError, plural
from drivers.formats import read_bounded
from drivers.types import Image
from rig.frames.clips import clip_background
from rig.frames.estimates import apply_zero, estimate_series
from rig.frames.series import FrameSeries, make_background
from rig.frames.times import spacing_notes
from rig.sessions.codec import Codec, json_line, strict
from rig.sessions.files import write_file
from rig.tactile.contact.relative import RelativeDifference
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State

# A relative difference of this size is drawn in black or white.
DIFFERENCE_RANGE = 0.25


@dataclass(frozen=True, slots=True)
class FrameChoice:
    """Numbers of the frames to be labelled, from 0, in order. reference: the frame with angle 0."""

    reference: int
    frames: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ClipToLabel:
    """The chosen frames, (H, W, 3) uint8 RGB by number, and the frame without contact."""

    name: str
    choice: FrameChoice
    background: Image
    frames: dict[int, Image]

    @property
    def size_px(self) -> tuple[int, int]:
        return self.background.shape[1], self.background.shape[0]


def choose_frames(
    series: FrameSeries, background: Image, count: int, reference: int | None = None
) -> tuple[FrameChoice, str]:
    """Choose frames of the press with the reference, evenly spread from there on; also return an explanation.

    The default reference is the zero of `rig estimate`: the first frame in which the contact has settled.
    Raises `InputError` if no frame shows a contact, or if the reference is not a frame with contact before
    another.
    """
    estimator = choose_estimator(None, None).make(background, None)
    found = apply_zero(estimate_series(series, estimator, series.count), None)
    touching = [number for number, sample in enumerate(found.samples) if sample.contact_area_px > 0]
    if not touching:
        raise InputError(
            f"{series.name}: no frame shows a contact: compare the background with the frames, it may show "
            "the same contact"
        )
    seen = f"a contact is seen in frames {touching[0]} to {touching[-1]}"
    zero = touching[0] if found.zero is None else found.times.index(found.zero)
    first = zero if reference is None else reference
    if first not in touching:
        raise InputError(f"{series.name}: --reference {first} shows no contact or cannot be read; {seen}")
    left = (n for n, s in enumerate(found.samples) if n > first and s.state is State.NO_CONTACT)
    end = next(left, len(found.samples))  # of the press that shows the reference
    between = [number for number in touching if first <= number < end]
    if len(between) < 2:
        raise InputError(f"{series.name}: no contact follows frame {first}: choose an earlier --reference")
    places = np.unique(np.linspace(0, len(between) - 1, min(count, len(between))).round().astype(int))
    frames = tuple(between[place] for place in places)
    why = "no frame has an angle" if found.zero is None else found.zero_note
    asked = why if reference is None else "as given"
    note = (
        f"{seen}\nreference: frame {frames[0]} ({asked})\n"
        f"{plural(len(frames), 'frame')} to label, up to {frames[-1]}; the reference is one of them, "
        "with 0 degrees"
    )
    if touching[-1] >= end:
        note += (
            f"\nthe press ends at frame {end}; label a later one in a separate clip, or alone with "
            "--reference"
        )
    return FrameChoice(frames[0], frames), "\n".join([note, *spacing_notes([t.time_ns for t in found.times])])


def background_of(clip: Path, series: FrameSeries) -> tuple[Image, str]:
    """Return a clip's frame without contact, or its first frame if it has none, and a note on its origin."""
    own = clip_background(clip)
    background, note = make_background("first:1" if own is None else str(own), series)
    missing = "; rig benchmark clips needs a background.png, a frame without contact" if own is None else ""
    return background, note + missing


def load_clip(name: str, series: FrameSeries, background: Image, choice: FrameChoice) -> ClipToLabel:
    """Read the chosen frames. Raises `InputError` if one of them cannot be read."""
    wanted = set(choice.frames)
    frames = {n: f.image for n, f in enumerate(series) if n in wanted and f.image is not None}
    if missing := sorted(wanted - set(frames)):
        raise InputError(f"{series.name}: frame {missing[0]} cannot be read: copy the clip again")
    return ClipToLabel(name, choice, background, frames)


def difference(image: Image, background: Image) -> Image:
    """Return the relative difference from the frame without contact, (H, W, 3) uint8; 0 is grey."""
    light = RelativeDifference(background, (background.shape[1], background.shape[0]))
    change = cv2.GaussianBlur(light.of(image), (0, 0), 1.0)
    return np.clip(127.5 * (1.0 + np.asarray(change) / DIFFERENCE_RANGE), 0, 255).astype(np.uint8)


Line = tuple[float, float, float, float]
"""x and y of its first and of its second end in pixels of the frame, x right, y down."""

PASSES = 2
# Assumed standard deviation of a click in x and in y.
CLICK_PX = 0.7
SHORTEST_PX = 10.0
# If two passes differ by more, the person used another feature or swapped the ends of the line.
MOST_APART_DEG = 60.0
COLUMNS = ("reference_frame", "keyframe", "angle_deg", "sigma_deg", "angle_pass1_deg", "angle_pass2_deg")
ENDS = tuple(f"p{n}_{name}" for n in (1, 2) for name in ("x1", "y1", "x2", "y2"))
LINES = "label_lines.json"
SCHEMA = 1
MOST_CLICKS = 100_000
MOST_BYTES = 20_000_000


@dataclass(frozen=True, slots=True)
class AngleLabel:
    """Rotation of the object at a frame, counter-clockwise as seen, from two passes of drawn lines.

    angle_deg: mean of both passes. sigma_deg: its standard deviation. lines: one per pass.
    """

    frame: int
    angle_deg: float
    sigma_deg: float
    passes_deg: tuple[float, float]
    lines: tuple[Line, Line]


def angle_labels(passes: Sequence[Mapping[int, Line]], reference: int) -> list[AngleLabel]:
    """Return the labels of all frames, in order, from two passes of lines by frame.

    All lines run along the same feature in the same direction. Frames without a line in both passes are left
    out. Angles count from the line in the reference frame and are unwrapped from frame to frame. The sigma is
    the disagreement of both passes, pooled over the clip. It is at least the disagreement in this frame, and
    at least the effect of `CLICK_PX`. Raises `InputError` for a reference without lines, lines that are too
    short, or passes that contradict each other.
    """
    frames = sorted(set(passes[0]) & set(passes[1]))
    _check(passes, frames, reference)
    turned = [_rotations_deg({frame: lines[frame] for frame in frames}, reference) for lines in passes]
    gaps = {frame: turned[0][frame] - turned[1][frame] for frame in frames}
    for frame, gap in gaps.items():
        if abs(gap) > MOST_APART_DEG:
            raise InputError(
                f"frame {frame}: both passes differ by {gap:.0f} degrees: draw its line again, from the same "
                "end of the same feature as in the other frames"
            )
    pooled = math.sqrt(sum(gap**2 for gap in gaps.values()) / max(len(gaps) - 1, 1)) / 2.0
    labels = []
    for frame in frames:
        one, two = turned[0][frame], turned[1][frame]
        clicks = math.hypot(_click_deg(passes, frame), _click_deg(passes, reference))
        sigma = 0.0 if frame == reference else max(pooled, abs(one - two) / 2.0, clicks)
        lines = (passes[0][frame], passes[1][frame])
        labels.append(AngleLabel(frame, (one + two) / 2.0, sigma, (one, two), lines))
    return labels


def labels_csv(labels: Sequence[AngleLabel], reference: int) -> str:
    """Return the text of `labels.csv`, a row per label."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, *ENDS))
    for label in labels:
        angles = (label.angle_deg, label.sigma_deg, *label.passes_deg)
        ends = [value for line in label.lines for value in line]
        writer.writerow((reference, label.frame, *(f"{v:.2f}" for v in angles), *(f"{v:.1f}" for v in ends)))
    return text.getvalue()


def _rotations_deg(lines: Mapping[int, Line], reference: int) -> dict[int, float]:
    """Return the rotation since the reference, deg, by frame."""
    frames, headings = sorted(lines), {}
    for frame, (x1, y1, x2, y2) in lines.items():
        headings[frame] = math.degrees(-math.atan2(y2 - y1, x2 - x1))
    turned = {frames[0]: 0.0}
    for before, frame in pairwise(frames):
        turned[frame] = turned[before] + math.remainder(headings[frame] - headings[before], 360.0)
    return {frame: turn - turned[reference] for frame, turn in turned.items()}


def _length_px(line: Line) -> float:
    return math.hypot(line[2] - line[0], line[3] - line[1])


def _click_deg(passes: Sequence[Mapping[int, Line]], frame: int) -> float:
    """Return the standard deviation of the mean of both passes due to inexact clicks (`CLICK_PX`), deg."""
    each = [math.degrees(CLICK_PX * math.sqrt(2.0) / _length_px(lines[frame])) for lines in passes]
    return math.hypot(*each) / PASSES


def _check(passes: Sequence[Mapping[int, Line]], frames: Sequence[int], reference: int) -> None:
    if reference not in frames or len(frames) < 2:
        raise InputError(
            f"the reference frame {reference} and one other need a line in each of both passes: draw them"
        )
    for lines in passes:
        for frame in frames:
            if not all(map(math.isfinite, lines[frame])) or _length_px(lines[frame]) < SHORTEST_PX:
                raise InputError(
                    f"frame {frame}: its line is shorter than {SHORTEST_PX:g} px, too short for an angle: "
                    "draw it from end to end of a long feature"
                )


@strict
@dataclass(frozen=True, slots=True)
class Click:
    """One end of a line. drawn_in: the pass, 0 or 1. x, y: px in the frame, integer at a pixel's centre."""

    drawn_in: int
    frame: int
    x: float
    y: float


@strict
@dataclass(frozen=True, slots=True)
class DrawnLines:
    """The content of `label_lines.json`. clicks: in the order in which they were made."""

    schema: int
    size_px: tuple[int, int]
    choice: FrameChoice
    clicks: tuple[Click, ...]


_FILE = Codec[DrawnLines](DrawnLines)


def read_drawn(path: Path) -> DrawnLines | None:
    """Read stored lines; None without a file. Raises `InputError` for an invalid file."""
    if not path.exists():
        return None
    try:
        drawn = _FILE.parse(read_bounded(path, MOST_BYTES))
    except ValueError as error:
        raise InputError(f"{path}: {error}: move the file away to begin again") from error
    if drawn.schema != SCHEMA:
        raise InputError(f"{path}: its schema is {drawn.schema}, this version reads {SCHEMA}: update the rig")
    if drawn.choice.reference not in drawn.choice.frames:
        raise InputError(f"{path}: the reference is not one of its frames: move the file away to begin again")
    return drawn


def chosen_frames(
    series: FrameSeries, background: Image, count: int | None, reference: int | None, drawn: DrawnLines | None
) -> tuple[FrameChoice, str]:
    """Return the frames to label, and a note for the user.

    These are the frames of `drawn` if labelling was begun, otherwise newly chosen ones. count: number of
    frames, by default ten. reference: the frame with angle 0. Raises `InputError` if count or reference
    differ from those of `drawn`.
    """
    if drawn is None:
        return choose_frames(series, background, count or 10, reference)
    begun = drawn.choice
    if count not in (None, len(begun.frames)) or reference not in (None, begun.reference):
        raise InputError(
            f"{LINES} was begun with {plural(len(begun.frames), 'frame')} and the reference "
            f"{begun.reference}: leave --count and --reference out to go on, or move the file "
            "away to start again"
        )
    return begun, f"continuing with {plural(len(drawn.clicks), 'click')} from before"


def ends_in(clicks: Sequence[Click], drawn_in: int) -> dict[int, list[tuple[float, float]]]:
    """Return the ends of the newest line of each frame in one pass: two, or one of an unfinished line."""
    ends: dict[int, list[tuple[float, float]]] = {}
    for click in clicks:
        if click.drawn_in == drawn_in:
            before = ends.get(click.frame, [])
            ends[click.frame] = [*(before if len(before) == 1 else []), (click.x, click.y)]
    return ends


class LineLog:
    """The clicks on one clip. Each click is written to `file` before it is accepted.

    drawn: the earlier content of `file`. Raises `InputError` if its frames have another size.
    """

    def __init__(self, file: Path, clip: ClipToLabel, drawn: DrawnLines | None = None) -> None:
        if drawn is not None and drawn.size_px != clip.size_px:
            raise InputError(f"{file}: is of frames of another size: move it away to begin again")
        self.file, self._clip = file, clip
        self._clicks = () if drawn is None else drawn.clicks
        for click in self._clicks:
            self._check(click)

    @property
    def clicks(self) -> tuple[Click, ...]:
        return self._clicks

    def add(self, click: Click) -> None:
        """Add a click. Raises `InputError` for an invalid one, `RecordingError` if it cannot be stored."""
        self._check(click)
        begun = ends_in(self._clicks, click.drawn_in).get(click.frame, [])
        if len(begun) == 1 and math.dist(begun[0], (click.x, click.y)) < SHORTEST_PX:
            raise InputError(f"less than {SHORTEST_PX:g} px from the first end: click farther away")
        self._keep((*self._clicks, click))

    def undo(self) -> Click | None:
        """Remove and return the last click; None without any."""
        last = self._clicks[-1] if self._clicks else None
        self._keep(self._clicks[:-1])
        return last

    def passes(self) -> list[dict[int, Line]]:
        """Return the finished lines of both passes by frame."""
        both = [ends_in(self._clicks, drawn_in) for drawn_in in range(PASSES)]
        return [{n: (*ends[0], *ends[1]) for n, ends in one.items() if len(ends) == 2} for one in both]

    def _keep(self, clicks: tuple[Click, ...]) -> None:
        drawn = DrawnLines(SCHEMA, self._clip.size_px, self._clip.choice, clicks)
        write_file(self.file, json_line(drawn))
        self._clicks = clicks

    def _check(self, click: Click) -> None:
        width, height = self._clip.size_px
        if click.drawn_in not in range(PASSES) or click.frame not in self._clip.frames:
            raise InputError(
                f"a click on frame {click.frame}, which is not labelled here: load the page again"
            )
        if not (-1.0 <= click.x <= width and -1.0 <= click.y <= height):
            raise InputError(f"a click at {click.x:g}, {click.y:g} is outside the frame: click inside")
        if len(self._clicks) > MOST_CLICKS:
            raise InputError(f"more than {MOST_CLICKS} clicks: begin again")
