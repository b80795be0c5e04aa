"""Where each object is grasped: the readable files of `protocols/objects`."""

from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from drivers.errors import InputError
from drivers.formats import read_toml

OBJECTS_FOLDER = Path(__file__).parent / "objects"
TRIAL_OBJECTS = ("1", "7", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
"""The paper's set D_a: two objects of the data set and seven unseen ones."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Position(_Strict):
    """One place to grasp: `offset_m` from the centre of mass along the object, and how wide it is.

    `lift_height_m`: how far a slip trial lifts here at most (0: not used for trials). `surface`: what
    the fingers hold there, where it was looked at; reports compare errors by it.
    """

    name: str
    offset_m: float = Field(ge=-0.3, le=0.3)
    width_m: float = Field(gt=0.0, lt=0.15)
    lift_height_m: float = Field(default=0.0, ge=0.0, le=0.3)
    surface: Literal["edge", "flat", "cylinder", "ball"] | None = None


class GraspFile(_Strict):
    """One object: three positions, five orientations (paper, section IV-A), and light grips.

    largest_grip_counts: beyond first contact, the most that a reaction to slip may close to; None where
    nobody has said what the object takes, and then nothing tightens on it.
    """

    id: str
    name: str
    orientations_deg: tuple[float, float, float, float, float]
    grip_counts: tuple[int, int]
    largest_grip_counts: int | None = Field(default=None, ge=1, le=255)
    position: tuple[Position, Position, Position]

    @field_validator("largest_grip_counts")
    @classmethod
    def _not_below_the_first_grip(cls, largest: int | None, info: ValidationInfo) -> int | None:
        light = max(info.data.get("grip_counts", (0,)))
        if largest is not None and largest < light:
            raise ValueError(f"{largest} is below grip_counts, {light}")
        return largest

    def require_largest_grip(self) -> int:
        """Return `largest_grip_counts`. Raises `InputError` where the file does not say it."""
        if self.largest_grip_counts is None:
            raise InputError(
                f"object {self.id} {self.name}: its file has no largest_grip_counts, so nothing may tighten "
                f"on it: measure what it takes and add the key in {OBJECTS_FOLDER.name}/, or use --react stop"
            )
        return self.largest_grip_counts


@dataclass(frozen=True, slots=True)
class GraspPose:
    """One of an object's fifteen poses, numbered from 1: position by position, as in the file."""

    number: int
    position: Position
    orientation_deg: float


@cache
def load_grasp_files() -> dict[str, GraspFile]:
    """Read all object files, by id. Raises `InputError` naming the file and the key at fault."""
    files = {}
    for path in sorted(OBJECTS_FOLDER.glob("*.toml")):
        try:
            grasp_file = GraspFile.model_validate(read_toml(path))
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise InputError(f"{path}: {where}: {first['msg']}") from error
        files[grasp_file.id] = grasp_file
    return files


def find_grasp_file(text: str) -> GraspFile:
    """Find an object by id ("7", "t1") or name ("wrench"). Raises `InputError` with what exists."""
    files = load_grasp_files()
    name = text.strip().lower()
    for grasp_file in files.values():
        if name in (grasp_file.id, grasp_file.name.lower()):
            return grasp_file
    names = [f.name for f in files.values()]
    near = get_close_matches(name, [*names, *files], n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    listed = ", ".join(f"{f.id} {f.name}" for f in sorted(files.values(), key=_order))
    raise InputError(f"unknown object '{text}': {hint}known are {listed}")


def grasp_poses(grasp_file: GraspFile) -> list[GraspPose]:
    """Return the fifteen poses of an object."""
    pairs = [(p, o) for p in grasp_file.position for o in grasp_file.orientations_deg]
    return [GraspPose(n, position, orientation) for n, (position, orientation) in enumerate(pairs, 1)]


def _order(grasp_file: GraspFile) -> tuple[bool, int]:
    return grasp_file.id.startswith("t"), int(grasp_file.id.lstrip("t"))
