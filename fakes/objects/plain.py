"""Objects without a model of their own: plain shapes of a width and a surface, named by a text."""

import json
from typing import Any

from drivers.errors import InputError
from fakes.objects.shapes import Ball, ContactShape, Cylinder, Edge, Pad, Shape

PREFIX = "plain:"
_LONG_MM = 60.0
"""Of an edge, a face or a rod: it goes on beyond the gel on both sides."""
_FLAT_LONG_MM = 30.0


def parse_plain(text: str) -> dict[str, Any] | None:
    """Return what "plain:{...}" says as the fields of an `ObjectModel`; None for any other text.

    The JSON object has id, name, mass_kg, friction, length_m, height_m, and for each of its `sites`
    offset_m, width_m and surface: edge, flat, cylinder or ball. Raises `InputError`.
    """
    if not text.startswith(PREFIX):
        return None
    try:
        said = json.loads(text.removeprefix(PREFIX))
        sites = [
            (float(site["offset_m"]), float(site["width_m"]), _contact(site, float(said["height_m"])))
            for site in said["sites"]
        ]
        return {
            "name": str(said["name"]),
            "mass_kg": float(said["mass_kg"]),
            "friction": float(said["friction"]),
            "length_m": float(said["length_m"]),
            "com_from_left_m": float(said["length_m"]) / 2.0,
            "sites": sites,
        }
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"'{text[:60]}': is no plain object: {type(error).__name__} {error}") from error


def short_id(text: str) -> str:
    """Return what people call an object of this id: of a plain one the id it was given."""
    return str(json.loads(text.removeprefix(PREFIX)).get("id")) if text.startswith(PREFIX) else text


def _contact(site: dict[str, Any], height_m: float) -> ContactShape:
    half_mm = 500.0 * float(site["width_m"])
    shapes: dict[str, Shape] = {
        "edge": Edge(nose_mm=1.0, length_mm=_LONG_MM),
        "flat": Pad(length_mm=_FLAT_LONG_MM, width_mm=1e3 * height_m),
        "cylinder": Cylinder(radius_mm=half_mm, length_mm=_LONG_MM),
        "ball": Ball(radius_mm=half_mm),
    }
    return ContactShape((shapes[site["surface"]],), smooth_round=site["surface"] == "ball")
