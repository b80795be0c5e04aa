"""SIMULATED examples for the network that estimates which texture of a contact turns with the object.

The ground truth is measured: a contact is rendered before and after a small rotation, without noise. Texture
counts as turning if it resembles the earlier texture more after it was rotated back than before.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, islice

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.look import GelLook
from fakes.studio.turning_frames import FRAMES_PER_FACE, TURN_DEG, TurningFrame, turning_frames
from rig.experiments.process_pool import run_tasks
from rig.tactile.contact.gel_marks import GelMarks, found_marks
from rig.tactile.contact.relative import DARK_OFFSET, RelativeDifference, work_size
from rig.tactile.slip.height import Field
from rig.tactile.slip.texture import FINENESS, structure_of
from rig.tactile.slip.turning import SHARE_PX

SIZE = (120, 160)
"""(width, height) of the training images in px."""
_NEIGHBOURS_PX = 1.5
"""Standard deviation of the window over which similarity is measured."""
_FAINTEST = 0.05
"""Texture weaker than this share of an image's strong texture does not count as turning."""
_LEAST_WEIGHT = 0.03
_FACES_PER_TASK = 40


@dataclass(frozen=True, slots=True, eq=False)
class TurningExamples:
    """N images, the share of their texture that turns, and weights.

    differences: (N, 3, h, w) float16, relative. shares, weights: (N, h / 2, w / 2) float16, the share of the
    texture that turns with the object, and how strong the texture is, 0 to 1.
    """

    differences: NDArray[np.float16]
    shares: NDArray[np.float16]
    weights: NDArray[np.float16]

    def __len__(self) -> int:
        return len(self.differences)


def turning_examples(
    faces: int, seed: int, progress: Callable[[int], None], look: GelLook | None = None, jobs: int = 1
) -> TurningExamples:
    """Render `faces` faces, `FRAMES_PER_FACE` images each. Equal arguments give equal images.

    progress: takes the number of finished faces. look: of a real unit; see `turning_frames`. jobs: number of
    processes.
    """
    starts = range(0, faces, _FACES_PER_TASK)
    tasks = [(min(_FACES_PER_TASK, faces - start), seed, start, look) for start in starts]
    examples, done = _empty(faces), 0
    for (count, _, start, _), part in run_tasks(_rendered, tasks, jobs):
        at = slice(FRAMES_PER_FACE * start, FRAMES_PER_FACE * (start + count))
        for name in ("differences", "shares", "weights"):
            getattr(examples, name)[at] = getattr(part, name)
        done += count
        progress(done)
    return examples


def _empty(faces: int) -> TurningExamples:
    width, height = SIZE
    count = faces * FRAMES_PER_FACE
    shares, weights = (np.empty((count, height // SHARE_PX, width // SHARE_PX), np.float16) for _ in range(2))
    return TurningExamples(np.empty((count, 3, height, width), np.float16), shares, weights)


def _rendered(task: tuple[int, int, int, GelLook | None]) -> TurningExamples:
    """Render some faces, of which the first has a given number."""
    faces, seed, first, look = task
    examples = _empty(faces)
    shown = chain.from_iterable(islice(turning_frames(seed, look, first), faces))
    for number, frame in enumerate(shown):
        difference, share, weight = example_of(frame)
        examples.differences[number] = cv2.resize(difference, SIZE).transpose(2, 0, 1)
        examples.shares[number], examples.weights[number] = _halved(share, weight)
    return examples


def example_of(shown: TurningFrame) -> tuple[Field, Field, Field]:
    """Return the relative difference (h, w, 3), the share that turns and its weight, (h, w), at fine size."""
    work = work_size(shown.image.shape, shown.aspect)
    size = (FINENESS * work[0], FINENESS * work[1])
    light = RelativeDifference(shown.background, size)
    marks = GelMarks(found_marks(shown.background, size), size)
    difference = marks.mended(light.of(light.reduced(shown.image)))
    around = cv2.resize(shown.background.astype(np.float32), size, interpolation=cv2.INTER_AREA) + DARK_OFFSET
    before, after = (
        structure_of(marks.mended(np.asarray(cv2.resize(change, size) / around, np.float32)))
        for change in (shown.before, shown.after)
    )
    height, width = shown.image.shape[:2]
    x, y = (
        (place + 0.5) * s / side - 0.5
        for place, s, side in zip(shown.center_px, size, (width, height), strict=True)
    )
    # residuals with and without rotating the texture back
    turned_back = _turned(after, (x, y), -TURN_DEG)
    if_turning, if_resting = (_near(np.square(other - before).sum(axis=2)) for other in (turned_back, after))
    share = np.asarray(if_resting / (if_turning + if_resting + np.float32(1e-12)), np.float32)
    strength = np.sqrt(_near(np.square(before).sum(axis=2)))
    weight = np.clip(strength / (np.percentile(strength, 98.0) + 1e-6), 0.0, 1.0)
    return difference, np.where(weight > _FAINTEST, share, 0.0).astype(np.float32), weight.astype(np.float32)


def _turned(texture: Field, center_px: tuple[float, float], turn_deg: float) -> Field:
    """Rotate the positions and directions of a texture, counter-clockwise as seen."""
    height, width = texture.shape[:2]
    places = cv2.getRotationMatrix2D(center_px, turn_deg, 1.0)
    moved = np.asarray(cv2.warpAffine(texture, places, (width, height)), np.float32)
    directions = (moved[..., 0] + 1j * moved[..., 1]) * np.exp(-2j * math.radians(turn_deg))
    return np.dstack([directions.real, directions.imag, moved[..., 2]]).astype(np.float32)


def _near(squares: Field) -> Field:
    return np.asarray(cv2.GaussianBlur(squares, (0, 0), _NEIGHBOURS_PX), np.float32)


def _halved(share: Field, weight: Field) -> tuple[Field, Field]:
    """Return share and weight at the resolution of the network's output, `SHARE_PX` pixels in one."""
    size = (SIZE[0] // SHARE_PX, SIZE[1] // SHARE_PX)
    counted = np.maximum(weight, np.float32(_LEAST_WEIGHT))
    summed, total = (
        np.asarray(cv2.resize(a, size, interpolation=cv2.INTER_AREA), np.float32)
        for a in (share * counted, counted)
    )
    return np.asarray(summed / total, np.float32), total
