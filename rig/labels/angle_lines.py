"""Angles from lines that a person drew on frames, twice: what a clip's `labels.csv` holds."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from drivers.errors import InputError

Line = tuple[float, float, float, float]
"""x and y of its first and of its second end in pixels of the frame, x right, y down."""

PASSES = 2
# A click is as exact as a pixel, one standard deviation in x and in y.
CLICK_PX = 0.7
SHORTEST_PX = 10.0
# Two passes that are farther apart are of two features, or of one with its ends swapped.
MOST_APART_DEG = 60.0
COLUMNS = ("reference_frame", "keyframe", "angle_deg", "sigma_deg", "angle_pass1_deg", "angle_pass2_deg")
ENDS = tuple(f"p{n}_{name}" for n in (1, 2) for name in ("x1", "y1", "x2", "y2"))


@dataclass(frozen=True, slots=True)
class AngleLabel:
    """How far the object has turned at a frame, counter-clockwise as seen, by two passes.

    lines: of the passes. sigma_deg: one standard deviation of angle_deg, their mean.
    """

    frame: int
    angle_deg: float
    sigma_deg: float
    passes_deg: tuple[float, float]
    lines: tuple[Line, Line]


def angle_labels(passes: Sequence[Mapping[int, Line]], reference: int) -> list[AngleLabel]:
    """Return the labels of all frames, in order, from two passes of lines by frame.

    Each line goes from the same end to the same end of one feature; frames without a line in both passes are
    left out. Angles count from the reference frame's line and are unwrapped from frame to frame. The sigma is
    what both passes disagree by, pooled over the clip, no less than what this frame's or a click alone allow.
    Raises `InputError` for a reference without lines, lines that are too short, or passes that contradict.
    """
    frames = sorted(set(passes[0]) & set(passes[1]))
    _check(passes, frames, reference)
    turned = [_turned({frame: lines[frame] for frame in frames}, reference) for lines in passes]
    _check_ends(turned)
    gaps = {frame: turned[0][frame] - turned[1][frame] for frame in frames if frame != reference}
    pooled = math.sqrt(sum(gap**2 for gap in gaps.values()) / max(len(gaps), 1)) / 2.0
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


def _turned(lines: Mapping[int, Line], reference: int) -> dict[int, float]:
    """Return the turn since the reference, deg, by frame."""
    frames = sorted(lines)
    headings = {frame: _heading_deg(lines[frame]) for frame in frames}
    turned = {frames[0]: 0.0}
    for before, frame in pairwise(frames):
        turned[frame] = turned[before] + math.remainder(headings[frame] - headings[before], 360.0)
    return {frame: turn - turned[reference] for frame, turn in turned.items()}


def _heading_deg(line: Line) -> float:
    x1, y1, x2, y2 = line
    return math.degrees(-math.atan2(y2 - y1, x2 - x1))


def _length_px(line: Line) -> float:
    return math.hypot(line[2] - line[0], line[3] - line[1])


def _click_deg(passes: Sequence[Mapping[int, Line]], frame: int) -> float:
    """What clicks that err by a pixel leave open of the mean of both passes, deg."""
    each = [math.degrees(CLICK_PX * math.sqrt(2.0) / _length_px(lines[frame])) for lines in passes]
    return math.hypot(*each) / PASSES


def _check(passes: Sequence[Mapping[int, Line]], frames: Sequence[int], reference: int) -> None:
    if reference not in frames or len(frames) < 2:
        raise InputError(
            f"the reference frame {reference} and one other need a line in each of both passes: draw them"
        )
    for lines in passes:
        for frame in frames:
            if (
                not all(math.isfinite(value) for value in lines[frame])
                or _length_px(lines[frame]) < SHORTEST_PX
            ):
                raise InputError(
                    f"frame {frame}: its line is shorter than {SHORTEST_PX:g} px, too short for an angle: "
                    "draw it from end to end of a long feature"
                )


def _check_ends(turned: Sequence[Mapping[int, float]]) -> None:
    """Refuse passes that differ by more than hands do: ends were swapped, or another feature was taken."""
    for frame, one in turned[0].items():
        if abs(gap := one - turned[1][frame]) > MOST_APART_DEG:
            raise InputError(
                f"frame {frame}: both passes differ by {gap:.0f} degrees: draw its line again, from the same "
                "end of the same feature as in the other frames"
            )
