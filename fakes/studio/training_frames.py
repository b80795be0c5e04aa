"""Simulated frames with labels: objects and random shapes on randomised units for training, and hard lifts.

Domain randomisation: each group of training frames comes from another sensor unit, with other light, gel,
membrane, streaks and noise (`fakes.gel.variation`). The frames of hard lifts show soft faces, growing
contacts, worn gels, light of other makes and codecs (`fakes.studio.conditions`); no network was trained on
them. Everything here is SIMULATED, so figures measured on it do not apply to real sensors.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.clock import to_ns
from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import FAMILY, Look, apply_codec, draw_variation
from fakes.objects.catalogue import GraspSite, load_catalogue
from fakes.objects.shapes import SHAPES, ContactShape, Shape
from fakes.objects.surfaces import GEL_HALF_MM, TEXTURES, build_surface, depth_for_force, face_surface
from fakes.studio.conditions import Conditions, draw_conditions

FRAMES_PER_UNIT = 12
REFERENCE_FRAMES = 6
RANDOM_SHAPE = "random"
LOOK_SEEDS_FROM = 1_000_000
"""First seed for variations of a look in training; benches and benchmarks use smaller seeds."""
_LOOK_SHARE = 0.5
_NO_CONTACT_SHARE = 0.04
_DRIFT_SPAN_S = 300.0
_FILMS_PX = (5, 7, 9, 11)
"""Widths over which the film smooths a dent in trainings with a look, in pixels of the geometry.

5 to 11 px are 0.6 to 1.3 mm. On three real units the colour change at 1.2 radii of a ball's circle is 0.3 to
0.5 of its maximum; the narrowest film has 0.25 there."""
_HARDER, _DEEPEST_MM = (1.0, 1.0, 2.0, 4.0), 1.6
"""Factors on the force in trainings with a look, and the greatest depth. By its circles, the 8.8 mm ball was
pressed 0.8 to 1.8 mm deep into unit D20641."""
FRAMES_PER_LIFT = 4
_LIFT_S, _LIFT_TURN_DEG = 30.0, 40.0
_KINDS = ("ball", "cylinder", "cylinder", "pad", "edge", "rim")
_PARTS = (1, 1, 1, 2, 3)
_PLAIN_SHARE = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrame:
    """A frame of one unit, (H, W, 3) uint8 RGB, with its label.

    background: the unit's mean frame without contact. touching: the geometric contact at half the frame's
    size, not 0 where object and gel touch; None without contact. object_id: of the catalogue, or "random".
    """

    image: Image
    background: Image
    touching: Image | None
    object_id: str


def training_frames(
    objects: Sequence[str],
    seed: int,
    random_share: float = 0.0,
    family: bool = False,
    look: Look | None = None,
) -> Iterator[list[TrainingFrame]]:
    """Yield the frames of one unit after the other, without end.

    objects: ids of the catalogue. random_share: fraction of frames that show random shapes instead. family:
    whether units are like those of a bench, instead of randomised. look: of a real unit; every second unit is
    a variation of it. The same seed gives the same frames.
    """
    rng = np.random.default_rng((seed, 41))
    while True:
        number, variation = int(rng.integers(1 << 31)), FAMILY if family else draw_variation(rng)
        if look is not None:
            drawn = np.random.default_rng((variation.light_seed or 0, 61))
            variation = replace(variation, film_px=int(drawn.choice(_FILMS_PX)))
        unit = GelSensor(number, variation=variation, look=varied_look(look, rng))
        background = mean_at_rest(unit, rng)
        hard = look is not None
        yield [_frame(unit, background, objects, random_share, rng, hard) for _ in range(FRAMES_PER_UNIT)]


def varied_look(look: Look | None, rng: np.random.Generator) -> Look | None:
    """Return a variation of a look for every second unit, by seeds that no bench uses; else None."""
    if look is None or rng.random() >= _LOOK_SHARE:
        return None
    return look.varied(LOOK_SEEDS_FROM + int(rng.integers(1 << 20)))


def mean_at_rest(unit: GelSensor, rng: np.random.Generator) -> Image:
    """Return a unit's mean frame without contact, before any drift of the light."""
    total = sum(unit.render(None, 0.0, rng).astype(np.float32) for _ in range(REFERENCE_FRAMES))
    return np.rint(total / np.float32(REFERENCE_FRAMES)).astype(np.uint8)


def _frame(
    unit: GelSensor, background: Image, objects: Sequence[str], random_share: float, rng: np.random.Generator,
    hard: bool,
) -> TrainingFrame:  # fmt: skip
    if rng.random() < random_share:
        name, contact = RANDOM_SHAPE, random_contact(rng)
    else:
        name = str(rng.choice(list(objects)))
        sites = load_catalogue()[name].sites
        contact = sites[int(rng.integers(len(sites)))].contact
    time_s = float(rng.uniform(0.0, _DRIFT_SPAN_S))
    if rng.random() < _NO_CONTACT_SHARE:
        return TrainingFrame(unit.render(None, time_s, rng), background, None, name)
    imprint = _imprint(contact, name == RANDOM_SHAPE, rng, hard)
    image = unit.render(imprint, time_s, rng)
    return TrainingFrame(image, background, unit.touching(imprint)[::2, ::2], name)


def _imprint(contact: ContactShape, any_angle: bool, rng: np.random.Generator, hard: bool) -> Imprint:
    """Return an imprint with random position, angle, tilt and force (0.2 to 2.5 N).

    hard: whether half of the imprints have two or four times that force, as if pressed by hand.
    """
    surface = build_surface(contact, int(rng.choice([-1, 1])), int(rng.integers(1 << 31)))
    tilt = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.02)))
    # objects are grasped near the middle; a random shape may extend beyond the gel
    if any_angle and rng.random() < 0.4:
        across, down = _between(rng, -1.0, 1.0), _between(rng, -1.0, 1.0)
        centre_mm = across * GEL_HALF_MM[0], down * GEL_HALF_MM[1]
    else:
        centre_mm = (float(rng.normal(0.0, 2.0)), float(rng.normal(0.0, 2.2)))
    angle_deg = float(rng.uniform(-180.0, 180.0) if any_angle else rng.uniform(-60.0, 60.0))
    force_n = float(np.exp(rng.uniform(np.log(0.2), np.log(2.5))))
    if hard:  # drawn apart, so that the other values stay those of a training without a look
        force_n *= float(np.random.default_rng(int(force_n * 1e9) % (1 << 31)).choice(_HARDER))
    depth_mm = depth_for_force(surface, force_n, tilt, angle_deg, centre_mm)
    depth_mm = min(_DEEPEST_MM, depth_mm) if hard else depth_mm
    return Imprint(surface, angle_deg, centre_mm, depth_mm, tilt, float(rng.normal(0.0, 0.6)))


def hard_frames(objects: Sequence[str], seed: int) -> Iterator[list[TrainingFrame]]:
    """Yield some frames of one fingertip's lift after the other, without end.

    objects: ids of the catalogue, grasped at any of their sites. The same seed gives the same frames.
    """
    rng = np.random.default_rng((seed, 43))
    while True:
        lift, side = int(rng.integers(1 << 31)), int(rng.choice([-1, 1]))
        conditions = draw_conditions("hard", lift, side)
        unit = GelSensor(int(rng.integers(1 << 31)), variation=conditions.unit)
        background = mean_at_rest(unit, rng)
        name = str(rng.choice(list(objects)))
        site = rng.choice(np.asarray(load_catalogue()[name].sites, object))
        frames = []
        for imprint in [_hard_imprint(site, conditions, lift, side, rng) for _ in range(FRAMES_PER_LIFT)]:
            time_s = float(rng.uniform(0.0, _LIFT_S))
            image = unit.render(imprint, time_s, rng)
            if conditions.codec is not None:
                image = apply_codec(image, to_ns(time_s), conditions.codec)
            frames.append(TrainingFrame(image, background, unit.touching(imprint)[::2, ::2], name))
        yield frames


def _hard_imprint(
    site: GraspSite, conditions: Conditions, lift: int, side: int, rng: np.random.Generator
) -> Imprint:
    """Return an imprint of the lift's face at a random rotation and force (0.4 to 1.2 N, plus the growth)."""
    kind, bulge = conditions.face(site.contact)
    surface = face_surface(site, kind, side, lift)
    turn_deg = float(rng.uniform(0.0, _LIFT_TURN_DEG))
    force_n = float(rng.uniform(0.4, 1.2)) * conditions.pressed_more(turn_deg)
    centre_mm = (float(rng.normal(0.0, 1.0)), float(rng.normal(0.0, 1.5)))
    tilt = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.02)))
    depth_mm = depth_for_force(surface, force_n, tilt, side * turn_deg, centre_mm, bulge)
    bulge_mm = centre_mm if bulge else (0.0, 0.0)
    return Imprint(surface, side * turn_deg, centre_mm, depth_mm, tilt, bulge=bulge, bulge_mm=bulge_mm)


def random_contact(rng: np.random.Generator) -> ContactShape:
    """Draw one to three shapes near one another, with or without a texture."""
    parts = tuple(_random_part(rng) for _ in range(int(rng.choice(_PARTS))))
    texture = "none" if rng.random() < _PLAIN_SHARE else str(rng.choice(list(TEXTURES)))
    return ContactShape(
        parts,
        texture=texture,
        texture_mm=_between(rng, 0.03, 0.20),
        pitch_mm=_between(rng, 0.8, 4.0),
        texture_deg=_between(rng, 0.0, 180.0),
    )


def _random_part(rng: np.random.Generator) -> Shape:
    values = {
        "x_mm": _between(rng, -4.0, 4.0),
        "z_mm": _between(rng, -4.0, 4.0),
        "axis_deg": _between(rng, -90.0, 90.0),
        "drop_mm": abs(float(rng.normal(0.0, 0.12))),
    }
    bend_per_mm, kind = _between(rng, -0.02, 0.02), str(rng.choice(_KINDS))
    if kind not in ("ball", "rim"):
        values["bend_per_mm"] = bend_per_mm
    sizes = {name: draw(rng, low, high) for name, (draw, low, high) in _SIZES[kind].items()}
    return SHAPES[kind](**values, **sizes)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _any_scale(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _or_none(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a radius, or 0 (straight, flat) with a probability of one half."""
    return 0.0 if rng.random() < 0.5 else _between(rng, low, high)


_SIZES: dict[str, dict[str, tuple[Callable[[np.random.Generator, float, float], float], float, float]]] = {
    "ball": {"radius_mm": (_any_scale, 3.0, 60.0)},
    "cylinder": {
        "radius_mm": (_any_scale, 2.0, 50.0), "length_mm": (_between, 4.0, 30.0),
        "end_radius_mm": (_between, 0.5, 6.0), "waist_radius_mm": (_or_none, 40.0, 200.0),
        "taper_per_mm": (_between, -0.03, 0.03),
    },
    "pad": {
        "length_mm": (_between, 4.0, 18.0), "width_mm": (_between, 3.0, 10.0),
        "corner_mm": (_between, 0.3, 1.2), "edge_mm": (_between, 0.2, 0.3),
        "crown_radius_mm": (_or_none, 15.0, 100.0), "taper_per_mm": (_between, -0.03, 0.03),
    },
    "edge": {
        "slope": (_between, 0.2, 1.2), "slope_below": (_between, 0.2, 1.2),
        "nose_mm": (_between, 0.3, 5.0), "length_mm": (_between, 5.0, 40.0),
    },
    "rim": {"radius_mm": (_between, 1.5, 15.0), "wire_mm": (_between, 0.4, 2.5)},
}  # fmt: skip
"""Sizes of random shapes, in the order in which they are drawn: distribution, lowest and highest value."""
