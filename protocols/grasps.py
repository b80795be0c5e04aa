"""Object files: where each object is grasped. The package's files are in `protocols/objects`."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
)

from drivers.errors import InputError, unknown_name
from drivers.formats import read_toml

OBJECTS_FOLDER = Path(__file__).parent / "objects"
TRIAL_OBJECTS = ("1", "7", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
"""The paper's set D_a: two objects of the data set and seven unseen ones."""
MOST_GRIP_MM = 62.5
"""Largest light grip, closing beyond first contact, mm; more than the thickness of any fingertip."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Position(_Strict):
    """One grasp position: `offset_m` from the centre of mass along the object, and the object's width there.

    `lift_height_m`: largest lift height of a slip trial here (0: not used for trials). `surface`: shape of
    the grasped surface, if it was recorded; reports compare errors by it, and an object without a simulated
    twin is drawn with it. `height_m`: height of the grasp above the mark. `turn_deg`: angle of the hand here,
    to which the object's orientations and a trial's random angle are added. `rig teach` measures both.
    """

    name: str = Field(min_length=1, max_length=60)
    offset_m: float = Field(ge=-0.3, le=0.3)
    width_m: float = Field(gt=0.0, lt=0.15)
    height_m: float = Field(default=0.0, ge=-0.1, le=0.3)
    turn_deg: float = Field(default=0.0, ge=-90.0, le=90.0)
    lift_height_m: float = Field(default=0.0, ge=0.0, le=0.3)
    surface: Literal["edge", "flat", "cylinder", "ball"] | None = None


class PlainBody(_Strict):
    """Simulation parameters of an object that has no twin in the simulated bench.

    length_m: of the object, with its centre of mass in the middle. height_m: of a flat face that is grasped.
    friction: Coulomb coefficient against the gel.
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


def _rising_mm(grip_mm: tuple[float, float]) -> tuple[float, float]:
    low, high = grip_mm
    if not 0.0 < low <= high <= MOST_GRIP_MM:
        raise ValueError(f"is not a range from above 0 to {MOST_GRIP_MM:g} mm, the lightest grip first")
    return grip_mm


class GraspFile(_Strict):
    """One object: its grasp positions, the orientations of the hand, and its range of light grips.

    The paper's objects have three positions and five orientations (section IV-A); a lab's may have fewer.
    grip_mm: least and largest closing beyond first contact, mm. largest_grip_mm: largest closing beyond first
    contact in a reaction to slip; None if it is unknown how firmly the object may be gripped, so that no
    reaction tightens on it. simulated: see `PlainBody`.
    """

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$")
    name: str = Field(pattern=r"^[^/\\\x00-\x1f\x7f.][^/\\\x00-\x1f\x7f]{0,59}$")
    orientations_deg: tuple[Annotated[float, Field(ge=-90.0, le=90.0)], ...] = Field(
        min_length=1, max_length=36
    )
    grip_mm: Annotated[tuple[float, float], AfterValidator(_rising_mm)]
    largest_grip_mm: float | None = Field(default=None, gt=0.0, le=160.0)
    position: Annotated[tuple[Position, ...], AfterValidator(_at_different_places)] = Field(
        min_length=1, max_length=20
    )
    simulated: PlainBody = PlainBody()

    @property
    def names(self) -> tuple[str, str]:
        """The keys under which the object is found: its id and its name, in lower case."""
        return self.id.lower(), " ".join(self.name.lower().split())

    @field_validator("largest_grip_mm")
    @classmethod
    def _not_below_the_light_grips(cls, largest: float | None, info: ValidationInfo) -> float | None:
        light = info.data.get("grip_mm")
        if largest is not None and light is not None and largest < max(light):
            raise ValueError(f"{largest:g} is below grip_mm, {max(light):g}")
        return largest

    @property
    def grip_m(self) -> tuple[float, float]:
        """Least and largest closing beyond first contact, m."""
        least, most = self.grip_mm
        return least / 1e3, most / 1e3

    @property
    def largest_grip_m(self) -> float | None:
        """Largest closing beyond first contact in a reaction to slip, m; None if unknown."""
        return None if self.largest_grip_mm is None else self.largest_grip_mm / 1e3

    def require_largest_grip(self) -> float:
        """Return `largest_grip_m`. Raises `InputError` if the file does not contain it."""
        if self.largest_grip_m is None:
            raise InputError(
                f"object {self.id} {self.name}: its file has no largest_grip_mm, so no reaction may tighten "
                f"on it: measure how firmly it may be gripped and add the key in {OBJECTS_FOLDER.name}/, "
                "or use --react stop"
            )
        return self.largest_grip_m


@dataclass(frozen=True, slots=True)
class GraspPose:
    """A grasp pose of an object, numbered from 1 in the file's order, position by position."""

    number: int
    position: Position
    orientation_deg: float


@cache
def load_grasp_files() -> dict[str, GraspFile]:
    """Read the package's object files, by id."""
    files = {}
    for path in sorted(OBJECTS_FOLDER.glob("*.toml")):
        grasp_file = GraspFile.model_validate(read_toml(path))
        files[grasp_file.id] = grasp_file
    return files


def find_grasp_file(text: str, own: Sequence[GraspFile] = ()) -> GraspFile:
    """Find an object by id ("7", "t1") or name ("wrench"), among a lab's `own` files and the package's.

    Raises `InputError` with a list of the known objects.
    """
    files = [*own, *load_grasp_files().values()]
    name = " ".join(text.lower().split())
    for grasp_file in files:
        if name in grasp_file.names:
            return grasp_file
    listed = ", ".join(f"{f.id} {f.name}" for f in sorted(files, key=_order))
    raise unknown_name("object", text, [each for f in files for each in f.names], listed=listed)


def grasp_poses(grasp_file: GraspFile) -> list[GraspPose]:
    """Return the grasp poses of an object: each orientation at each position."""
    pairs = [(p, o) for p in grasp_file.position for o in grasp_file.orientations_deg]
    return [GraspPose(n, position, orientation) for n, (position, orientation) in enumerate(pairs, 1)]


def _order(grasp_file: GraspFile) -> tuple[bool, bool, int, str]:
    """Sort key: the package's files by number, those for recording first; a lab's files after them."""
    number = grasp_file.id.removeprefix("t")
    return not number.isdecimal(), number != grasp_file.id, int(number) if number.isdecimal() else 0, number
