"""Simulated images of turning contacts, with the part of the texture that turns with the object.

The contacts are soft faces on bulges that do not turn, and random shapes, on varied sensor units. Everything
here is SIMULATED. The faces do not occur on a bench, because their seeds start above those of lifts.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.types import Image
from fakes.gel.look import Look
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import Variation, coded, draw_codec, draw_variation
from fakes.objects.relief import Bulge, draw_bulge
from fakes.objects.surfaces import Surface, build_surface, depth_for_force, soft_surface
from fakes.studio.conditions import draw_kind, draw_unit
from fakes.studio.training_frames import mean_at_rest, random_contact, varied_look

FRAMES_PER_FACE = 6
TURN_DEG = 8.0
"""Rotation between the two noise-free images of a contact."""
_FACE_SHARES = {"lines": 0.23, "edge": 0.16, "corner": 0.10, "skin": 0.10, "creases": 0.06}
"""Fractions of soft faces, by kind; the others are random hard shapes."""
_SOFT_UNITS, _OTHER_MAKE, _MARKED, _CODED = 0.6, 0.7, 0.7, 0.5
_FIRST_FACE = 1 << 32
_LASTS_S = 30.0


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


def turning_frames(seed: int, look: Look | None = None) -> Iterator[list[TurningFrame]]:
    """Yield groups of images without end, each of one face on one unit; equal seeds give equal images.

    look: of a real unit; every second unit is drawn in a variation of it.
    """
    rng = np.random.default_rng((seed, 47))
    while True:
        number, variation = int(rng.integers(1 << 31)), _draw_variation(rng)
        unit = GelSensor(number, variation=variation, look=varied_look(look, rng))
        background = mean_at_rest(unit, rng)
        surface, bulge = _draw_face(rng)
        imprints = [_draw_imprint(surface, bulge, rng) for _ in range(FRAMES_PER_FACE)]
        yield [_frame(unit, background, imprint, rng) for imprint in imprints]


def _draw_variation(rng: np.random.Generator) -> Variation:
    if rng.random() >= _SOFT_UNITS:
        return replace(draw_variation(rng), film_px=int(rng.choice([3, 5])))
    make, marks = (int(rng.integers(1 << 31)) if rng.random() < p else None for p in (_OTHER_MAKE, _MARKED))
    return draw_unit(make, marks, rng)


def _draw_face(rng: np.random.Generator) -> tuple[Surface, Bulge | None]:
    kind, seed = draw_kind(_FACE_SHARES, rng), _FIRST_FACE + int(rng.integers(1 << 31))
    if kind is None:
        return build_surface(random_contact(rng), 1, seed), None
    return soft_surface(kind, 1, seed), draw_bulge(kind, rng)


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
        image = coded(image, to_ns(time_s), draw_codec(rng))
    after = replace(imprint, angle_deg=imprint.angle_deg + TURN_DEG)
    (across, down), (x_mm, y_mm) = unit.mm_per_px, imprint.centre_mm
    height, width = image.shape[:2]
    center_px = (0.5 * (width - 1) + x_mm / across, 0.5 * (height - 1) + y_mm / down)
    return TurningFrame(image, background, unit.change(imprint), unit.change(after), center_px, across / down)
