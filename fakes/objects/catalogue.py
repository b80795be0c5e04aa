"""The objects of the simulated bench: the catalogue, gauges, and plain shapes described by a text.

`catalogue.toml` names the sources of its figures. The estimators and the rig never import this module.
"""

import json
import tomllib
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

from drivers.errors import InputError, unknown_name
from fakes.objects.shapes import SHAPES, Ball, ContactShape, Cylinder, Edge, Pad, Shape

PREFIX = "plain:"
_LONG_MM = 60.0
"""Length of an edge or a rod: it extends beyond the gel on both sides."""
_FLAT_LONG_MM = 30.0


@dataclass(frozen=True, slots=True)
class GraspSite:
    """A grasp position on an object, and the shape of its contact.

    offset_m: from the centre of mass along the object's x axis. width_m: between the fingers. contact: shape
    on the camera's side; the opposite finger touches its mirror image in x.
    """

    offset_m: float
    width_m: float
    contact: ContactShape


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """One object: mass, friction against the gel, centre of mass, and grasp sites.

    id: the paper's number ("1" to "16"), "t1" to "t7", or the text that describes it. friction: Coulomb
    coefficient.
    com_from_left_m: centre of mass from the object's left end along x. marked_above_n: force above which a
    finger leaves a mark on a soft object, None if the fingers cannot mark it.
    """

    id: str
    name: str
    mass_kg: float
    friction: float
    length_m: float
    com_from_left_m: float
    sites: tuple[GraspSite, ...]
    marked_above_n: float | None = None


@cache
def load_catalogue() -> dict[str, ObjectModel]:
    """Return all objects by id, in the order of the file."""
    text = files("fakes.objects").joinpath("catalogue.toml").read_text(encoding="utf-8")
    models = {}
    for key, table in tomllib.loads(text).items():
        sites = []
        for site in table.pop("sites"):
            parts = tuple(SHAPES[part.pop("shape")](**part) for part in site.pop("parts"))
            offset_m, width_m = site.pop("offset_m"), site.pop("width_m")
            sites.append(GraspSite(offset_m, width_m, ContactShape(parts, **site)))
        models[key] = ObjectModel(key, **table, sites=tuple(sites))
    return models


def find_object(text: str) -> ObjectModel:
    """Return the object with an id or name (ignoring case), or the object that a text describes.

    Raises `InputError` with a list of the objects and the closest match.
    """
    made = find_gauge(text) or find_plain(text)
    if made is not None:
        return made
    catalogue = load_catalogue()
    name = " ".join(text.lower().split())
    by_any_name = {key: model for model in catalogue.values() for key in (model.id, model.name)}
    if name in by_any_name:
        return by_any_name[name]
    known = ", ".join(f"{model.id} {model.name}" for model in catalogue.values())
    raise unknown_name("object", text, by_any_name, listed=known)


@cache
def find_gauge(text: str) -> ObjectModel | None:
    """Return a gauge by its size in mm: "gauge:30" is a block 30 mm wide, "ball:6.31" a ball on a post.

    Both have exact sizes and are held at their middle. None for any other text. Raises `InputError` for a
    size that the fingers cannot hold.
    """
    kind, _, size = text.partition(":")
    if kind not in ("gauge", "ball") or not size:
        return None
    try:
        size_mm = float(size)
    except ValueError:
        size_mm = float("nan")
    if not 1.0 <= size_mm <= 150.0:
        raise InputError(f"'{text}': give its size in mm, 1 to 150, as {kind}:30")
    part = Pad(length_mm=24.0, width_mm=18.0) if kind == "gauge" else Ball(radius_mm=size_mm / 2.0)
    site = GraspSite(0.0, size_mm / 1e3, ContactShape((part,), exact=True))
    return ObjectModel(text, f"{kind} of {size_mm:g} mm", 0.05, 0.9, 0.04, 0.02, (site,))


@lru_cache(maxsize=64)
def find_plain(text: str) -> ObjectModel | None:
    """Return the plain object that "plain:{...}" describes, None for any other text.

    The JSON object has id, name, mass_kg, friction, length_m, height_m, and for each of its `sites` offset_m,
    width_m and surface: edge, flat, cylinder or ball. The id of the object is the whole text, so that another
    process can make the same object from it. Raises `InputError`.
    """
    if not text.startswith(PREFIX):
        return None
    try:
        values = json.loads(text.removeprefix(PREFIX))
        length_m, height_m = float(values["length_m"]), float(values["height_m"])
        return ObjectModel(
            id=text,
            name=str(values["name"]),
            mass_kg=float(values["mass_kg"]),
            friction=float(values["friction"]),
            length_m=length_m,
            com_from_left_m=length_m / 2.0,
            sites=tuple(_plain_site(site, height_m) for site in values["sites"]),
        )
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"'{text[:60]}': is not a plain object: {type(error).__name__} {error}") from error


def short_id(text: str) -> str:
    """Return a short id of an object for display: for a plain object, the id in its text."""
    return str(json.loads(text.removeprefix(PREFIX)).get("id")) if text.startswith(PREFIX) else text


def _plain_site(site: dict[str, Any], height_m: float) -> GraspSite:
    half_mm, surface = 500.0 * float(site["width_m"]), site["surface"]
    shapes: dict[str, Shape] = {
        "edge": Edge(nose_mm=1.0, length_mm=_LONG_MM),
        "flat": Pad(length_mm=_FLAT_LONG_MM, width_mm=1e3 * height_m),
        "cylinder": Cylinder(radius_mm=half_mm, length_mm=_LONG_MM),
        "ball": Ball(radius_mm=half_mm),
    }
    contact = ContactShape((shapes[surface],), smooth_round=surface == "ball")
    return GraspSite(float(site["offset_m"]), float(site["width_m"]), contact)
