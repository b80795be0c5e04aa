"""A clip to be labelled: choice of frames, and their difference from the frame without contact."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import InputError, counted
from drivers.types import Image
from rig.frames.clips import clip_background
from rig.frames.estimates import estimate_series, zeroed
from rig.frames.series import FrameSeries, make_background
from rig.tactile.contact.relative import RelativeDifference
from rig.tactile.estimators import choose_estimator

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
        """Width and height of a frame."""
        return self.background.shape[1], self.background.shape[0]


def choose_frames(
    series: FrameSeries, background: Image, count: int, reference: int | None = None
) -> tuple[FrameChoice, str]:
    """Choose frames with contact, evenly spread from the reference on; return them and an explanation.

    The default reference is the zero of `rig estimate`: the first frame in which the contact has settled.
    Raises `InputError` if no frame shows a contact, or if the reference is not a frame with contact before
    another.
    """
    touching, zero, why = _scanned(series, background)
    if not touching:
        raise InputError(
            f"{series.name}: no frame shows a contact: compare the background with the frames, it may show "
            "the same contact"
        )
    seen = f"a contact is seen in frames {touching[0]} to {touching[-1]}"
    first = zero if reference is None else reference
    if first not in touching:
        raise InputError(f"{series.name}: --reference {first} shows no contact or cannot be read; {seen}")
    between = [number for number in touching if number >= first]
    if len(between) < 2:
        raise InputError(f"{series.name}: no contact follows frame {first}: choose an earlier --reference")
    places = np.unique(np.linspace(0, len(between) - 1, min(count, len(between))).round().astype(int))
    frames = tuple(between[place] for place in places)
    asked = why if reference is None else "as given"
    note = (
        f"{seen}; reference: frame {frames[0]} ({asked}); {counted(len(frames), 'frame')} to label, "
        f"up to {frames[-1]}"
    )
    return FrameChoice(frames[0], frames), note


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


def _scanned(series: FrameSeries, background: Image) -> tuple[list[int], int, str]:
    """Return the frames with contact, the frame of the zero, and a note on the zero."""
    estimator = choose_estimator(None, None).make(background, None)
    found = zeroed(estimate_series(series, estimator, series.count), None)
    touching = [number for number, sample in enumerate(found.samples) if sample.contact_area_px > 0]
    if found.zero is None:
        return touching, touching[0] if touching else 0, "no frame has an angle"
    return touching, found.times.index(found.zero), found.zero_note
