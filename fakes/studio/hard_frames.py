"""Simulated frames of hard lifts, with their labels.

Soft faces, growing contacts, worn gels, other makes' light, codecs (see `fakes.studio.conditions`). No
network was trained on them. Everything here is SIMULATED.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.clock import to_ns
from fakes.gel.codec import coded
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import GraspSite, load_catalogue
from fakes.objects.surfaces import build_surface, depth_for_force, soft_surface
from fakes.studio.conditions import Conditions, draw_conditions
from fakes.studio.training_frames import TrainingFrame, mean_at_rest

FRAMES_PER_LIFT = 4
_LASTS_S, _TURNS_DEG = 30.0, 40.0


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
        imprints = [_imprint(site, conditions, lift, side, rng) for _ in range(FRAMES_PER_LIFT)]
        yield [_frame(unit, background, imprint, conditions, name, rng) for imprint in imprints]


def _frame(
    unit: GelSensor,
    background: np.ndarray,
    imprint: Imprint,
    conditions: Conditions,
    name: str,
    rng: np.random.Generator,
) -> TrainingFrame:
    time_s = float(rng.uniform(0.0, _LASTS_S))
    image = unit.render(imprint, time_s, rng)
    if conditions.codec is not None:
        image = coded(image, to_ns(time_s), conditions.codec)
    return TrainingFrame(image, background, unit.touching(imprint)[::2, ::2], name)


def _imprint(
    site: GraspSite, conditions: Conditions, lift: int, side: int, rng: np.random.Generator
) -> Imprint:
    """Press the lift's face at a turn it may have come to (0.4 to 1.2 N, and what the turn adds)."""
    kind, bulge = conditions.face(site.contact)
    surface = build_surface(site, side, lift) if kind is None else soft_surface(kind, side, lift)
    turn_deg = float(rng.uniform(0.0, _TURNS_DEG))
    force_n = float(rng.uniform(0.4, 1.2)) * conditions.pressed_more(turn_deg)
    centre_mm = (float(rng.normal(0.0, 1.0)), float(rng.normal(0.0, 1.5)))
    tilt = (float(rng.normal(0.0, 0.02)), float(rng.normal(0.0, 0.02)))
    depth_mm = depth_for_force(surface, force_n, tilt, side * turn_deg, centre_mm, bulge)
    return Imprint(
        surface,
        side * turn_deg,
        centre_mm,
        depth_mm,
        tilt,
        bulge=bulge,
        bulge_mm=centre_mm if bulge else (0.0, 0.0),
    )
