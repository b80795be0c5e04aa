"""Simulated training frames: units unlike one another, objects of the catalogue and random shapes.

Domain randomisation: every group of frames comes from a sensor unit of its own, with its own light,
gel, membrane, streaks and noise (`fakes.variation`). Everything here is SIMULATED; no figure
reached on it says how well a real sensor would do.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from drivers.types import Image
from fakes.catalogue import load_catalogue
from fakes.optics import GelSensor, Imprint
from fakes.random_contact import random_contact
from fakes.shapes import Contact
from fakes.surfaces import GEL_HALF_MM, build_surface, depth_for_force
from fakes.variation import FAMILY, draw_variation
from rig.labels.outline import contact_label
from rig.training.examples import Examples, sized

FRAMES_PER_UNIT = 12
REFERENCE_FRAMES = 6
RANDOM_SHAPE = "random"
_NO_CONTACT_SHARE = 0.04
_DRIFT_SPAN_S = 300.0


def simulated_examples(
    objects: Sequence[str],
    count: int,
    seed: int,
    size: tuple[int, int],
    random_share: float = 0.0,
    family: bool = False,
    progress: Callable[[int], None] = lambda done: None,
) -> Examples:
    """Render labelled frames.

    objects: ids of the catalogue. size: (width, height) in px that frames are kept at. random_share:
    share of frames that show random shapes instead. family: units as a bench has them, instead of
    randomised ones. The same seed gives the same frames.
    """
    rng = np.random.default_rng((seed, 41))
    frames, backgrounds, labels, ids = [], [], [], []
    while len(frames) < count:
        unit = GelSensor(int(rng.integers(1 << 31)), variation=FAMILY if family else draw_variation(rng))
        background = _reference(unit, rng, size)
        for frame, label, name in _frames(unit, objects, random_share, rng):
            frames.append(sized(frame, size))
            labels.append(sized(label, size))
            backgrounds.append(background)
            ids.append(name)
        progress(min(len(frames), count))
    kept = slice(count)
    return Examples(
        np.stack(frames[kept]), np.stack(backgrounds[kept]), np.stack(labels[kept]), tuple(ids[kept]), True
    )


def _reference(unit: GelSensor, rng: np.random.Generator, size: tuple[int, int]) -> Image:
    """The unit's mean frame without contact, taken before the light begins to drift."""
    total = sum(unit.render(None, 0.0, rng).astype(np.float32) for _ in range(REFERENCE_FRAMES))
    return sized(np.rint(total / np.float32(REFERENCE_FRAMES)).astype(np.uint8), size)


def _frames(
    unit: GelSensor, objects: Sequence[str], random_share: float, rng: np.random.Generator
) -> Iterator[tuple[Image, Image, str]]:
    """Yield frame, label and object id of one unit's frames."""
    for _ in range(FRAMES_PER_UNIT):
        name, contact = _drawn_object(objects, random_share, rng)
        time_s = float(rng.uniform(0.0, _DRIFT_SPAN_S))
        if rng.random() < _NO_CONTACT_SHARE:
            frame = unit.render(None, time_s, rng)
            yield frame, np.zeros(frame.shape[:2], np.uint8), name
        else:
            imprint = _imprint(contact, name == RANDOM_SHAPE, rng)
            yield unit.render(imprint, time_s, rng), contact_label(unit.touching(imprint)[::2, ::2]), name


def _drawn_object(
    objects: Sequence[str], random_share: float, rng: np.random.Generator
) -> tuple[str, Contact]:
    if rng.random() < random_share:
        return RANDOM_SHAPE, random_contact(rng)
    name = str(rng.choice(list(objects)))
    sites = load_catalogue()[name].sites
    return name, sites[int(rng.integers(len(sites)))].contact


def _imprint(contact: Contact, any_angle: bool, rng: np.random.Generator) -> Imprint:
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
