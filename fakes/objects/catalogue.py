"""The objects of the simulated bench, read from `catalogue.toml`.

The file says where the figures come from. The estimators and the rig never see this module.
"""

import tomllib
from dataclasses import MISSING, dataclass, fields
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

from drivers.errors import InputError, unknown_name
from fakes.objects.plain import parse_plain
from fakes.objects.shapes import SHAPES, Ball, ContactShape, Pad, Shape
from fakes.objects.texture import TEXTURES

_PARTS_KEY = "parts"
_SITES_KEY = "sites"
_SITE_KEYS = ("offset_m", "width_m")


@dataclass(frozen=True, slots=True)
class GraspSite:
    """Where an object is grasped and what the fingertips meet there.

    offset_m: from the centre of mass along the object's x. width_m: between the fingers.
    contact: as seen from the camera's side; the far side shows its mirror image in x.
    """

    offset_m: float
    width_m: float
    contact: ContactShape


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """One object: mass, friction against the gel, where its centre of mass lies, where it is grasped.

    id: the paper's number ("1" to "16"), "t1" to "t7", or the text that describes it. friction: Coulomb,
    dimensionless.
    com_from_left_m: centre of mass from the object's left end along x. marked_above_n: a soft object
    keeps a mark of a finger that pushes harder, None where it takes all that the fingers can do.
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
    """Return all objects by id, in the order of the file. Raises `InputError` on a bad file."""
    text = files("fakes.objects").joinpath("catalogue.toml").read_text(encoding="utf-8")
    return parse_catalogue(text)


def parse_catalogue(text: str) -> dict[str, ObjectModel]:
    """Return the objects of a catalogue's text by id.

    Raises `InputError` naming the object and the key for anything unknown, missing or malformed.
    """
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"object catalogue is not valid TOML: {error}") from error
    return {key: _object(key, table) for key, table in tables.items()}


def find_object(text: str) -> ObjectModel:
    """Return the object of an id or name, upper and lower case alike, or of a text that describes it.

    Raises `InputError` that lists what exists and offers the closest match.
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
    """What is measured with, by its size in mm: "gauge:30" a block 30 mm wide, "ball:6.31" a ball on a post.

    Both are made to size and held at their middle. None for any other text. Raises `InputError`
    for a size that no fingers take.
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
    """The plain object that a text describes (`fakes.objects.plain`); None for any other text.

    Its id is the whole text, by which another process makes the same one. Raises `InputError`.
    """
    said = parse_plain(text)
    if said is None:
        return None
    return ObjectModel(id=text, **{**said, "sites": tuple(GraspSite(*site) for site in said["sites"])})


def _object(key: str, table: Any) -> ObjectModel:
    where = f"object catalogue, [{key}]"
    if not isinstance(table, dict) or not isinstance(table.get(_SITES_KEY), list):
        raise InputError(f"{where}: expected a table with {_SITES_KEY}")
    values = dict(table)
    sites = values.pop(_SITES_KEY)
    values["sites"] = tuple(_site(f"{where}, site {i + 1}", site) for i, site in enumerate(sites))
    return _build(ObjectModel, where, {"id": key, **values})


def _site(where: str, table: Any) -> GraspSite:
    if not isinstance(table, dict) or not isinstance(table.get(_PARTS_KEY), list):
        raise InputError(f"{where}: expected a table with {_PARTS_KEY}")
    values = dict(table)
    parts = tuple(_part(where, part) for part in values.pop(_PARTS_KEY))
    own = {key: values.pop(key) for key in _SITE_KEYS if key in values}
    contact = _build(ContactShape, where, {"parts": parts, **values})
    if contact.texture != "none" and contact.texture not in TEXTURES:
        raise InputError(f"{where}: unknown texture '{contact.texture}': use one of {', '.join(TEXTURES)}")
    return _build(GraspSite, where, {"contact": contact, **own})


def _part(where: str, table: Any) -> Shape:
    name = table.get("shape") if isinstance(table, dict) else None
    if name not in SHAPES:
        raise InputError(f"{where}: unknown shape '{name}': use one of {', '.join(SHAPES)}")
    return _build(SHAPES[name], where, {key: value for key, value in table.items() if key != "shape"})


def _build(kind: type, where: str, values: dict[str, Any]) -> Any:
    """Make a dataclass of exactly its fields, each of the kind its annotation says."""
    known = {item.name: item for item in fields(kind)}
    unknown = [key for key in values if key not in known]
    missing = [
        name
        for name, item in known.items()
        if name not in values and item.default is MISSING and item.default_factory is MISSING
    ]
    if unknown or missing:
        raise InputError(f"{where}: unknown keys {unknown}, missing keys {missing}; known are {list(known)}")
    for name, value in values.items():
        if known[name].type in (float, "float", float | None) and (
            isinstance(value, bool) or not isinstance(value, int | float)
        ):
            raise InputError(f"{where}: {name} must be a number, not {value!r}")
    return kind(**values)
