"""Simulated frames to train on: units unlike one another, objects of the catalogue and random shapes.

Domain randomisation: every group of frames comes from a sensor unit of its own, with its own light,
gel, membrane, streaks and noise (`fakes.gel.variation`). Everything here is SIMULATED; no figure
reached on it says how well a real sensor would do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import FAMILY, draw_variation
from fakes.objects.catalogue import load_catalogue
from fakes.objects.random_contact import random_contact
from fakes.objects.shapes import ContactShape
from fakes.objects.surfaces import GEL_HALF_MM, build_surface, depth_for_force

FRAMES_PER_UNIT = 12
REFERENCE_FRAMES = 6
RANDOM_SHAPE = "random"
_NO_CONTACT_SHARE = 0.04
_DRIFT_SPAN_S = 300.0


@dataclass(frozen=True, slots=True, eq=False)
class TrainingFrame:
    """A frame of one unit, (H, W, 3) uint8 RGB, and what it shows.

    background: the unit's mean frame without contact. touching: (H, W), not 0 where object and gel
    touch, at half the frame's size; None without a contact. object_id: of the catalogue, or "random".
    """

    image: Image
    background: Image
    touching: Image | None
    object_id: str


def training_frames(
    objects: Sequence[str], seed: int, random_share: float = 0.0, family: bool = False
) -> Iterator[list[TrainingFrame]]:
    """Yield the frames of one unit after the other, without end.

    objects: ids of the catalogue. random_share: share of frames that show random shapes instead.
    family: units as a bench has them, instead of randomised ones. The same seed gives the same frames.
    """
    rng = np.random.default_rng((seed, 41))
    while True:
        unit = GelSensor(int(rng.integers(1 << 31)), variation=FAMILY if family else draw_variation(rng))
        background = mean_at_rest(unit, rng)
        yield [_frame(unit, background, objects, random_share, rng) for _ in range(FRAMES_PER_UNIT)]


def mean_at_rest(unit: GelSensor, rng: np.random.Generator) -> Image:
    """Return a unit's mean frame without contact, taken before the light begins to drift."""
    total = sum(unit.render(None, 0.0, rng).astype(np.float32) for _ in range(REFERENCE_FRAMES))
    return np.rint(total / np.float32(REFERENCE_FRAMES)).astype(np.uint8)


def _frame(
    unit: GelSensor, background: Image, objects: Sequence[str], random_share: float, rng: np.random.Generator
) -> TrainingFrame:
    name, contact = _drawn_object(objects, random_share, rng)
    time_s = float(rng.uniform(0.0, _DRIFT_SPAN_S))
    if rng.random() < _NO_CONTACT_SHARE:
        return TrainingFrame(unit.render(None, time_s, rng), background, None, name)
    imprint = _imprint(contact, name == RANDOM_SHAPE, rng)
    image = unit.render(imprint, time_s, rng)
    return TrainingFrame(image, background, unit.touching(imprint)[::2, ::2], name)


def _drawn_object(
    objects: Sequence[str], random_share: float, rng: np.random.Generator
) -> tuple[str, ContactShape]:
    if rng.random() < random_share:
        return RANDOM_SHAPE, random_contact(rng)
    name = str(rng.choice(list(objects)))
    sites = load_catalogue()[name].sites
    return name, sites[int(rng.integers(len(sites)))].contact


def _imprint(contact: ContactShape, any_angle: bool, rng: np.random.Generator) -> Imprint:
    """Press at a random place, angle, tilt and force (0.2 to 2.5 N)."""
    surface = build_surface(contact, int(rng.choice([-1, 1])), int(rng.integers(1 << 31)))
    tilt = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.02)))
    # an object's grasp is near the middle; a random shape may lie half outside
    if any_angle and rng.random() < 0.4:
        centre_mm = (
            float(rng.uniform(-1.0, 1.0)) * GEL_HALF_MM[0],
            float(rng.uniform(-1.0, 1.0)) * GEL_HALF_MM[1],
        )
    else:
        centre_mm = (float(rng.normal(0.0, 2.0)), float(rng.normal(0.0, 2.2)))
    angle_deg = float(rng.uniform(-180.0, 180.0) if any_angle else rng.uniform(-60.0, 60.0))
    force_n = float(np.exp(rng.uniform(np.log(0.2), np.log(2.5))))
    depth_mm = depth_for_force(surface, force_n, tilt, angle_deg, centre_mm)
    return Imprint(surface, angle_deg, centre_mm, depth_mm, tilt, float(rng.normal(0.0, 0.6)))
