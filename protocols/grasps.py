"""Where each object is grasped: the readable files of `protocols/objects`, and those of a lab."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from drivers.errors import InputError, unknown_name
from drivers.formats import read_toml

OBJECTS_FOLDER = Path(__file__).parent / "objects"
TRIAL_OBJECTS = ("1", "7", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
"""The paper's set D_a: two objects of the data set and seven unseen ones."""
MOST_COUNTS = 100
"""Of a grip beyond first contact: some 60 mm of closing, more than any fingertip is thick."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Position(_Strict):
    """One place to grasp: `offset_m` from the centre of mass along the object, and how wide it is.

    `lift_height_m`: how far a slip trial lifts here at most (0: not used for trials). `surface`: what
    the fingers hold there, where it was looked at; reports compare errors by it, and an object without a
    simulated twin is drawn by it. `height_m`: of the grasp over the mark; `turn_deg`: of the hand there,
    to which the object's orientations, and what a trial draws, are added. `rig teach` measures both.
    """

    name: str = Field(min_length=1, max_length=60)
    offset_m: float = Field(ge=-0.3, le=0.3)
    width_m: float = Field(gt=0.0, lt=0.15)
    height_m: float = Field(default=0.0, ge=-0.1, le=0.3)
    turn_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    lift_height_m: float = Field(default=0.0, ge=0.0, le=0.3)
    surface: Literal["edge", "flat", "cylinder", "ball"] | None = None


class PlainBody(_Strict):
    """What the simulated bench has to know of an object that it has no twin of.

    length_m: of the object, its centre of mass in the middle. height_m: of a flat face that is held.
    friction: Coulomb, against the gel.
    """

    mass_kg: float = Field(default=0.08, gt=0.0, le=2.0)
    friction: float = Field(default=0.8, gt=0.0, le=2.0)
    length_m: float = Field(default=0.2, gt=0.0, le=1.0)
    height_m: float = Field(default=0.006, ge=0.003, le=0.3)


def _at_different_places(positions: "tuple[Position, ...]") -> "tuple[Position, ...]":
    counted = Counter(position.name for position in positions)
    if twice := [name for name, count in counted.items() if count > 1]:
        raise ValueError(f"has two positions called '{twice[0]}'")
    return positions


def _rising(counts: tuple[int, int]) -> tuple[int, int]:
    low, high = counts
    if not 1 <= low <= high <= MOST_COUNTS:
        raise ValueError(f"is no range of 1 to {MOST_COUNTS} counts, the lightest grip first")
    return counts


class GraspFile(_Strict):
    """One object: where it is grasped, how the hand is turned there, and light grips.

    The paper's objects have three positions and five orientations (section IV-A); a lab's may have fewer.
    grip_counts: beyond first contact, least and most. largest_grip_counts: beyond first contact too, the
    most that a reaction to slip may close to; None where nobody has said what the object takes, and then
    nothing tightens on it. simulated: see `PlainBody`.
    """

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")
    name: str = Field(pattern=r"^[^/\\\x00-\x1f\x7f.][^/\\\x00-\x1f\x7f]{0,59}$")
    orientations_deg: tuple[Annotated[float, Field(ge=-90.0, le=90.0)], ...] = Field(
        min_length=1, max_length=36
    )
    grip_counts: Annotated[tuple[int, int], AfterValidator(_rising)]
    largest_grip_counts: int | None = Field(default=None, ge=1, le=255)
    position: Annotated[tuple[Position, ...], AfterValidator(_at_different_places)] = Field(
        min_length=1, max_length=20
    )
    simulated: PlainBody = PlainBody()

    @property
    def names(self) -> tuple[str, str]:
        """What it is found by: its id and its name, in lower case."""
        return self.id.lower(), " ".join(self.name.lower().split())

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
    """One of an object's poses, numbered from 1: position by position, as in the file."""

    number: int
    position: Position
    orientation_deg: float


@cache
def load_grasp_files() -> dict[str, GraspFile]:
    """Read the package's object files, by id. Raises `InputError` naming the file and the key at fault."""
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


def find_grasp_file(text: str, own: Sequence[GraspFile] = ()) -> GraspFile:
    """Find an object by id ("7", "t1") or name ("wrench"), of a lab's `own` or the package's.

    Raises `InputError` with what exists.
    """
    files = [*own, *load_grasp_files().values()]
    name = " ".join(text.lower().split())
    for grasp_file in files:
        if name in grasp_file.names:
            return grasp_file
    raise unknown_name("object", text, [each for f in files for each in f.names], listed=_listed(files))


def grasp_poses(grasp_file: GraspFile) -> list[GraspPose]:
    """Return the poses of an object: each orientation at each position."""
    pairs = [(p, o) for p in grasp_file.position for o in grasp_file.orientations_deg]
    return [GraspPose(n, position, orientation) for n, (position, orientation) in enumerate(pairs, 1)]


def _listed(files: Iterable[GraspFile]) -> str:
    return ", ".join(f"{f.id} {f.name}" for f in sorted(files, key=_order))


def _order(grasp_file: GraspFile) -> tuple[bool, bool, int, str]:
    """The package's by number, those for recording first; a lab's after them."""
    number = grasp_file.id.removeprefix("t")
    return not number.isdecimal(), number != grasp_file.id, int(number) if number.isdecimal() else 0, number
