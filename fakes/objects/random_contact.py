"""Contacts of random shape: what a training set needs beside the objects of the catalogue."""

import numpy as np

from fakes.objects.shapes import Ball, ContactShape, Cylinder, Edge, Pad, Rim, Shape
from fakes.objects.texture import TEXTURES

_KINDS = ("ball", "cylinder", "cylinder", "pad", "edge", "rim")
_PARTS = (1, 1, 1, 2, 3)
_PLAIN_SHARE = 0.35


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
    place = {
        "x_mm": _between(rng, -4.0, 4.0),
        "z_mm": _between(rng, -4.0, 4.0),
        "axis_deg": _between(rng, -90.0, 90.0),
        "drop_mm": abs(float(rng.normal(0.0, 0.12))),
    }
    bent = {**place, "bend_per_mm": _between(rng, -0.02, 0.02)}
    match str(rng.choice(_KINDS)):
        case "ball":
            return Ball(radius_mm=_any_scale(rng, 3.0, 60.0), **place)
        case "cylinder":
            return _cylinder(rng, bent)
        case "pad":
            return _pad(rng, bent)
        case "edge":
            slopes = {"slope": _between(rng, 0.2, 1.2), "slope_below": _between(rng, 0.2, 1.2)}
            return Edge(nose_mm=_between(rng, 0.3, 5.0), length_mm=_between(rng, 5.0, 40.0), **slopes, **bent)
        case _:
            return Rim(radius_mm=_between(rng, 1.5, 15.0), wire_mm=_between(rng, 0.4, 2.5), **place)


def _cylinder(rng: np.random.Generator, place: dict[str, float]) -> Cylinder:
    return Cylinder(
        radius_mm=_any_scale(rng, 2.0, 50.0),
        length_mm=_between(rng, 4.0, 30.0),
        end_radius_mm=_between(rng, 0.5, 6.0),
        waist_radius_mm=_or_none(rng, 40.0, 200.0),
        taper_per_mm=_between(rng, -0.03, 0.03),
        **place,
    )


def _pad(rng: np.random.Generator, place: dict[str, float]) -> Pad:
    return Pad(
        length_mm=_between(rng, 4.0, 18.0),
        width_mm=_between(rng, 3.0, 10.0),
        corner_mm=_between(rng, 0.3, 1.2),
        edge_mm=_between(rng, 0.2, 0.3),
        crown_radius_mm=_or_none(rng, 15.0, 100.0),
        taper_per_mm=_between(rng, -0.03, 0.03),
        **place,
    )


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _any_scale(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _or_none(rng: np.random.Generator, low: float, high: float) -> float:
    """A radius, or 0 (straight, flat) in half of the cases."""
    return 0.0 if rng.random() < 0.5 else _between(rng, low, high)
