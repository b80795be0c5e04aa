"""SIMULATED examples for the network that estimates which texture of a contact turns with the object.

The contacts are soft faces on bulges that do not turn, and random shapes, on varied sensor units. The faces
do not occur on a bench, because their seeds start above those of lifts. The ground truth is measured: a
contact is rendered before and after a small rotation, without noise. Texture counts as turning if it
resembles the earlier texture more after it was rotated back than before. To train the network, run
`python tools/train_turning.py --help`.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import Look, Variation, apply_codec, draw_codec, draw_variation
from fakes.objects.shapes import ContactShape, Pad
from fakes.objects.surfaces import (
    TEXTURES,
    Bulge,
    Surface,
    build_surface,
    depth_for_force,
    draw_bulge,
    soft_surface,
)
from fakes.studio.conditions import draw_kind, draw_unit
from fakes.studio.training_frames import mean_at_rest, random_contact, varied_look
from rig.experiments.process_pool import run_tasks
from rig.tactile.contact.gel_marks import GelMarks, found_marks
from rig.tactile.contact.relative import DARK_OFFSET, RelativeDifference, work_size
from rig.tactile.slip.height import Field
from rig.tactile.slip.texture import FINENESS, structure_of
from rig.tactile.slip.turning import SHARE_PX

SIZE = (120, 160)
"""(width, height) of the training images in px."""
FRAMES_PER_FACE = 6
TURN_DEG = 8.0
"""Rotation between the two noise-free images of a contact."""
_FACE_SHARES = {"lines": 0.23, "edge": 0.16, "corner": 0.10, "skin": 0.10, "creases": 0.06}
"""Fractions of soft faces, by kind; the others are random hard shapes."""
_WIDER = 0.44
"""Fraction of faces that vary more than those of a bench, as follows."""
_TEXTURED = 0.12
"""Fraction of flat faces with a regular texture, such as ribs, letters or leather."""
_NARROW, _NARROW_MM, _LONGEST = 0.35, (7.0, 25.0), 6.0
"""Fraction of narrow bulges (handles, rods, edges), their radius across, and largest ratio of the radii."""
_FAINT, _FAINTEST = 0.4, 0.3
"""Fraction of reliefs that are made fainter, and the smallest factor."""
_FILMS_PX, _NOISIEST = (3, 3, 5, 7), 1.8
"""Smoothing by the gel's film, and largest factor on the noise of a unit."""
_SOFT_UNITS, _OTHER_MAKE, _MARKED, _CODED = 0.6, 0.7, 0.7, 0.5
_FIRST_FACE = 1 << 32
_LASTS_S = 30.0
_NEIGHBOURS_PX = 1.5
"""Standard deviation of the window over which similarity is measured."""
_FAINTEST_SHARE = 0.05
"""Texture weaker than this share of an image's strong texture does not count as turning."""
_LEAST_WEIGHT = 0.03
_FACES_PER_TASK = 40


@dataclass(frozen=True, slots=True, eq=False)
class TurningFrame:
    """An image (H, W, 3) uint8 RGB, and the contact without noise before and after a small rotation.

    background: the unit's mean frame without contact. before, after: (H, W, 3) float32, change of the
    background by the contact, in grey levels. Between them the object has turned by `TURN_DEG` about
    center_px (x, y); nothing else differs. aspect: width over height of a pixel on the gel.
    """

    image: Image
    background: Image
    before: NDArray[np.float32]
    after: NDArray[np.float32]
    center_px: tuple[float, float]
    aspect: float


def turning_frames(seed: int, look: Look | None = None, part: int = 0) -> Iterator[list[TurningFrame]]:
    """Yield groups of images without end, each of one face on one unit; equal seeds give equal images.

    look: of a real unit; every second unit is drawn in a variation of it. part: number of a part of the
    images; other parts of a seed have other images.
    """
    rng = np.random.default_rng((seed, part, 47))
    while True:
        wider = bool(rng.random() < _WIDER)
        number, variation = int(rng.integers(1 << 31)), _draw_variation(wider, rng)
        unit = GelSensor(number, variation=variation, look=varied_look(look, rng))
        background = mean_at_rest(unit, rng)
        surface, bulge = _draw_face(wider, rng)
        imprints = [_draw_imprint(surface, bulge, rng) for _ in range(FRAMES_PER_FACE)]
        yield [_frame(unit, background, imprint, rng) for imprint in imprints]


def _draw_variation(wider: bool, rng: np.random.Generator) -> Variation:
    film_px = int(rng.choice(_FILMS_PX)) if wider else None
    if rng.random() >= _SOFT_UNITS:
        return replace(draw_variation(rng), film_px=film_px or int(rng.choice([3, 5])))
    make, marks = (int(rng.integers(1 << 31)) if rng.random() < p else None for p in (_OTHER_MAKE, _MARKED))
    unit = draw_unit(make, marks, rng)
    if film_px is None:
        return unit
    return replace(unit, film_px=film_px, noise=unit.noise * float(rng.uniform(1.0, _NOISIEST)))


def _draw_face(wider: bool, rng: np.random.Generator) -> tuple[Surface, Bulge | None]:
    if not wider:
        kind, seed = draw_kind(_FACE_SHARES, rng), _draw_seed(rng)
        if kind is None:
            return build_surface(random_contact(rng), 1, seed), None
        return soft_surface(kind, 1, seed), draw_bulge(kind, rng)
    if rng.random() < _TEXTURED:
        surface, kind = build_surface(_draw_textured(rng), 1, _draw_seed(rng)), "skin"
    else:
        kind = draw_kind(_FACE_SHARES, rng)
        if kind is None:
            return build_surface(random_contact(rng), 1, _draw_seed(rng)), None
        surface = soft_surface(kind, 1, _draw_seed(rng))
    factor = float(rng.uniform(_FAINTEST, 1.0)) if rng.random() < _FAINT else 1.0
    surface = replace(surface, height_mm=surface.height_mm * np.float32(factor))
    if rng.random() >= _NARROW:
        return surface, draw_bulge(kind, rng)
    across = float(np.exp(rng.uniform(*np.log(_NARROW_MM))))
    radii_mm = across * float(rng.uniform(1.2, _LONGEST)), across
    return surface, Bulge(radii_mm, float(rng.uniform(0.0, 180.0)))


def _draw_textured(rng: np.random.Generator) -> ContactShape:
    """Return a flat face with a regular texture, larger than the gel."""
    return ContactShape(
        (Pad(length_mm=60.0, width_mm=60.0),),
        texture=str(rng.choice(list(TEXTURES))),
        texture_mm=float(rng.uniform(0.02, 0.12)),
        pitch_mm=float(rng.uniform(0.8, 3.0)),
        texture_deg=float(rng.uniform(0.0, 180.0)),
        exact=True,
    )


def _draw_seed(rng: np.random.Generator) -> int:
    return _FIRST_FACE + int(rng.integers(1 << 31))


def _draw_imprint(surface: Surface, bulge: Bulge | None, rng: np.random.Generator) -> Imprint:
    """Return an imprint at a random position and angle; soft faces with up to five times the usual force."""
    turn_deg = float(rng.uniform(-180.0, 180.0))
    center_mm = (float(rng.normal(0.0, 1.5)), float(rng.normal(0.0, 2.5)))
    tilt = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.02)))
    force_n = float(rng.uniform(0.4, 1.2))
    if bulge is None:
        depth_mm = depth_for_force(surface, force_n, tilt, turn_deg, center_mm)
        return Imprint(surface, turn_deg, center_mm, depth_mm, tilt)
    force_n *= float(np.exp(rng.uniform(0.0, np.log(5.0))))
    depth_mm = depth_for_force(surface, force_n, tilt, turn_deg, center_mm, bulge)
    at_mm = (center_mm[0] + float(rng.normal(0.0, 1.2)), center_mm[1] + float(rng.normal(0.0, 1.2)))
    return Imprint(surface, turn_deg, center_mm, depth_mm, tilt, bulge=bulge, bulge_mm=at_mm)


def _frame(unit: GelSensor, background: Image, imprint: Imprint, rng: np.random.Generator) -> TurningFrame:
    time_s = float(rng.uniform(0.0, _LASTS_S))
    image = unit.render(imprint, time_s, rng)
    if rng.random() < _CODED:
        image = apply_codec(image, to_ns(time_s), draw_codec(rng))
    after = replace(imprint, angle_deg=imprint.angle_deg + TURN_DEG)
    (across, down), (x_mm, y_mm) = unit.mm_per_px, imprint.centre_mm
    height, width = image.shape[:2]
    center_px = (0.5 * (width - 1) + x_mm / across, 0.5 * (height - 1) + y_mm / down)
    return TurningFrame(image, background, unit.change(imprint), unit.change(after), center_px, across / down)


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
    faces: int, seed: int, progress: Callable[[int], None], look: Look | None = None, jobs: int = 1
) -> TurningExamples:
    """Render `faces` faces, `FRAMES_PER_FACE` images each. Equal arguments give equal images.

    progress: takes the number of finished faces. look: of a real unit; see `turning_frames`. jobs: number of
    processes.
    """
    starts = range(0, faces, _FACES_PER_TASK)
    tasks = [(min(_FACES_PER_TASK, faces - start), seed, start, look) for start in starts]
    examples, done = _empty(faces), 0
    for (count, _, start, _), part in run_tasks(_render, tasks, jobs):
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


def _render(task: tuple[int, int, int, Look | None]) -> TurningExamples:
    """Render some faces, of which the first has a given number."""
    faces, seed, first, look = task
    examples = _empty(faces)
    shown = chain.from_iterable(islice(turning_frames(seed, look, first), faces))
    for number, frame in enumerate(shown):
        difference, share, weight = example_of(frame)
        examples.differences[number] = cv2.resize(difference, SIZE).transpose(2, 0, 1)
        examples.shares[number], examples.weights[number] = _halve(share, weight)
    return examples


def example_of(shown: TurningFrame) -> tuple[Field, Field, Field]:
    """Return the relative difference (h, w, 3), the share that turns and its weight, (h, w), at fine size."""
    work = work_size(shown.image.shape, shown.aspect)
    size = (FINENESS * work[0], FINENESS * work[1])
    light = RelativeDifference(shown.background, size)
    marks = GelMarks(found_marks(shown.background, size), size)
    difference = marks.fill(light.of(light.reduce(shown.image)))
    around = cv2.resize(shown.background.astype(np.float32), size, interpolation=cv2.INTER_AREA) + DARK_OFFSET
    before, after = (
        structure_of(marks.fill(np.asarray(cv2.resize(change, size) / around, np.float32)))
        for change in (shown.before, shown.after)
    )
    height, width = shown.image.shape[:2]
    x, y = (
        (place + 0.5) * s / side - 0.5
        for place, s, side in zip(shown.center_px, size, (width, height), strict=True)
    )
    # residuals with and without rotating the texture back
    turned_back = _turn(after, (x, y), -TURN_DEG)
    if_turning, if_resting = (_near(np.square(other - before).sum(axis=2)) for other in (turned_back, after))
    share = np.asarray(if_resting / (if_turning + if_resting + np.float32(1e-12)), np.float32)
    strength = np.sqrt(_near(np.square(before).sum(axis=2)))
    weight = np.clip(strength / (np.percentile(strength, 98.0) + 1e-6), 0.0, 1.0)
    return (
        difference,
        np.where(weight > _FAINTEST_SHARE, share, 0.0).astype(np.float32),
        weight.astype(np.float32),
    )


def _turn(texture: Field, center_px: tuple[float, float], turn_deg: float) -> Field:
    """Rotate the positions and directions of a texture, counter-clockwise as seen."""
    height, width = texture.shape[:2]
    places = cv2.getRotationMatrix2D(center_px, turn_deg, 1.0)
    moved = np.asarray(cv2.warpAffine(texture, places, (width, height)), np.float32)
    directions = (moved[..., 0] + 1j * moved[..., 1]) * np.exp(-2j * math.radians(turn_deg))
    return np.dstack([directions.real, directions.imag, moved[..., 2]]).astype(np.float32)


def _near(squares: Field) -> Field:
    return np.asarray(cv2.GaussianBlur(squares, (0, 0), _NEIGHBOURS_PX), np.float32)


def _halve(share: Field, weight: Field) -> tuple[Field, Field]:
    """Return share and weight at the resolution of the network's output, `SHARE_PX` pixels in one."""
    size = (SIZE[0] // SHARE_PX, SIZE[1] // SHARE_PX)
    counted = np.maximum(weight, np.float32(_LEAST_WEIGHT))
    summed, total = (
        np.asarray(cv2.resize(a, size, interpolation=cv2.INTER_AREA), np.float32)
        for a in (share * counted, counted)
    )
    return np.asarray(summed / total, np.float32), total
