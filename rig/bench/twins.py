"""Appearance of a simulated bench: objects (twins from the catalogue, plain shapes), looks of real gels."""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from calibration.gel.look import GelLook, load_look
from drivers.errors import CalibrationError, InputError
from fakes.objects.catalogue import PREFIX
from protocols.grasps import GraspFile, Position
from rig.config import BenchConfig
from rig.config.devices import DrawnTactileSection


def look_of(tactile: DrawnTactileSection) -> GelLook | None:
    """Return the look that a bench file names for a sensor; None if it names none.

    Raises `CalibrationError` for a file that cannot be read, or is of another image size.
    """
    if tactile.look is None:
        return None
    look = _look(tactile.look, tactile.look_seed)
    if look.shape[::-1] != tactile.size_px:
        raise CalibrationError(
            f"{tactile.look}: was made of pictures of {look.shape[::-1]} px, the bench file has size_px = "
            f"{list(tactile.size_px)}; correct it"
        )
    return look


@cache
def _look(path: str, seed: int | None) -> GelLook:
    look = load_look(Path(path))
    return look if seed is None else look.varied(seed)


def laid_as(own: Sequence[GraspFile], object_id: str) -> str:
    """Return the text with which a simulated world creates an object.

    own: a lab's objects, which have no twin and become plain shapes. Raises `InputError`.
    """
    grasps = next((each for each in own if each.id == object_id), None)
    if grasps is None:
        return object_id
    sites = [_site(grasps, position) for position in grasps.position]
    body = {"id": grasps.id, "name": grasps.name, **grasps.simulated.model_dump(), "sites": sites}
    return PREFIX + json.dumps(body, sort_keys=True)


def refuse_undrawn(config: BenchConfig, grasps: GraspFile) -> None:
    """Raise `InputError` if a bench is simulated and cannot draw an object."""
    if config.simulated:
        laid_as(config.objects, grasps.id)


def plain_notes(config: BenchConfig, objects: Sequence[GraspFile]) -> list[str]:
    """Return a note for each object that a simulated bench draws as a plain shape, with its assumed body."""
    own = {each.id for each in config.objects} if config.simulated else set()
    notes = []
    for each in (each for each in objects if each.id in own):
        body = each.simulated
        shapes = ", ".join(f"{p.name} {p.surface} {1e3 * p.width_m:g} mm" for p in each.position)
        notes.append(
            f"SIMULATED: object {each.id} has no simulated twin and is drawn as a plain shape: {shapes}; "
            f"{body.mass_kg:g} kg, friction {body.friction:g}, {1e3 * body.length_m:g} mm long."
        )
    return notes


def _site(grasps: GraspFile, position: Position) -> dict[str, object]:
    if position.surface is None:
        raise InputError(
            f"object {grasps.id} {grasps.name} has no simulated twin, and its file has no surface at "
            f"'{position.name}', so the simulated bench cannot draw it: write surface = \"flat\" (or edge, "
            "cylinder, ball) there, or use a real bench"
        )
    return {"offset_m": position.offset_m, "width_m": position.width_m, "surface": position.surface}
