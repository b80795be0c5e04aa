"""Types of the values in a bench file: lengths in m, angles, rates, names, addresses."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
)
from pydantic_core import CoreSchema, core_schema

from drivers.errors import InputError
from drivers.named_classes import file_hint, is_class_name
from drivers.types import GripperSpec, Vector6

Coordinate = Annotated[float, Field(ge=-5, le=5)]
"""m in the base frame. No bench is larger, so that values in mm are rejected."""
Point = tuple[Coordinate, Coordinate, Coordinate]
OnTool = Annotated[float, Field(ge=-1, le=1)]
"""m from the flange."""
Offset = tuple[OnTool, OnTool, OnTool]
HalfTurn = Annotated[float, Field(ge=-math.pi, le=math.pi)]
RotationVector = tuple[HalfTurn, HalfTurn, HalfTurn]
Angle = Annotated[float, Field(ge=-360, le=360)]
"""Degrees; +-360 is the working range of a UR5e's joints (data sheet)."""
JointAngles = tuple[Angle, Angle, Angle, Angle, Angle, Angle]
Finger = Literal["A", "B", "C"]
Rate = Annotated[float, Field(gt=0, le=240)]
Pixels = Annotated[int, Field(gt=0, le=8192)]
MarkerId = Annotated[int, Field(ge=0)]


def _written_as(pattern: str, what: str) -> AfterValidator:
    """Return a validator that rejects text that does not match a pattern."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(f"is not {what}")
        return text

    return AfterValidator(check)


Host = Annotated[str, _written_as(r"\w([\w.-]*\w)?", "an IPv4 address or a host's name")]
HostPort = Annotated[str, _written_as(r"[^:\s]+:\d+", "host:port")]


def _inside(text: str) -> str:
    """Reject paths that leave their folder."""
    if any(not _FILE_NAME.fullmatch(part) or part in (".", "..") for part in text.split("/")):
        raise ValueError("is not a name of a file inside its folder")
    return text


_FILE_NAME = re.compile(r"[^/\\\x00-\x1f\x7f]{1,150}")
InnerPath = Annotated[str, Field(min_length=1), AfterValidator(_inside)]
"""A file in a session, its parts separated by `/`."""
FileName = Annotated[InnerPath, _written_as(r"[^/]*", "a valid file name")]
"""Part of a file name: serials, objects, benches."""


def driver_names(*ours: str) -> AfterValidator:
    """Return a validator of `driver`: one of the rig's own, or `package.module:Class`."""

    def check(text: str) -> str:
        if text not in ours and not is_class_name(text):
            named = " or ".join(f"'{name}'" for name in ours)
            own = f"or a class of your own as 'package.module:Class'{file_hint(text)}"
            raise ValueError(f"Input should be {named}, {own}")
        return text

    return AfterValidator(check)


KeyPath = Sequence[str | int]
"""Keys and list indices from the top of a bench file, such as ("tactile", 1, "rate_hz")."""
KeyFault = tuple[KeyPath, str]
"""A key and its problem."""
Options = dict[str, Any]
"""Keys of a user-defined device class, in its subtable `options`."""


class Strict(BaseModel):
    """Rejects unknown keys, NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BenchSection(Strict):
    """A table (section) of a bench file."""

    later: ClassVar[frozenset[str]] = frozenset()
    """Keys that the first sessions lacked: a stored copy contains them only if not at the default."""

    @model_serializer(mode="wrap")
    def _stored(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values, has = self.__dict__, type(self).model_fields
        at_default = {key for key in self.later if values[key] == has[key].default}
        return {key: value for key, value in serialize(self).items() if key not in at_default}


SECTIONS = ("arm", "gripper", "camera", "table")
"""Tables of a bench file that may be missing."""


MISSING: Any = None
"""Value of a section that a bench file lacks."""


class MayBeMissing:
    """Marks a section that a bench file may lack; reading it then raises `InputError` (`BenchParts`)."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.nullable_schema(handler(source))


class BenchParts(BenchSection):
    """A bench whose missing sections raise `InputError` when read; `has` returns which are present."""

    def __getattribute__(self, name: str) -> Any:
        """Return an attribute. Raises `InputError` for a section that the bench file lacks."""
        value = super().__getattribute__(name)
        if value is None and name in SECTIONS:
            raise InputError(f"bench '{self.name}' has no [{name}]: add it to the bench file")
        return value

    def has(self, *sections: str) -> bool:
        """Return whether the bench file has all of these sections, as "arm"."""
        return all(self.__dict__[section] is not None for section in sections)


class ArmLimitsConfig(BenchSection):
    """Limits of the arm, checked before a command is sent. The defaults are the simulated cell's."""

    later = frozenset({"max_contact_force_n"})
    workspace_min_m: Point = (0.15, -0.35, 0.01)
    workspace_max_m: Point = (0.75, 0.35, 0.60)
    max_speed_m_s: float = Field(default=0.5, gt=0, le=1.0)
    max_acceleration_m_s2: float = Field(default=1.5, gt=0, le=2.5)
    max_payload_kg: float = Field(default=5.0, gt=0, le=5.0)
    max_contact_force_n: float = Field(default=20.0, ge=5, le=100)
    joint_min_deg: JointAngles = (-360.0, -360.0, -360.0, -360.0, -360.0, -360.0)
    joint_max_deg: JointAngles = (360.0, 360.0, 360.0, 360.0, 360.0, 360.0)

    def joint_limits_rad(self) -> tuple[Vector6, Vector6]:
        """Return lowest and highest joint angles, rad."""
        return _radians(self.joint_min_deg), _radians(self.joint_max_deg)


Range = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]


class GripperLimitsConfig(BenchSection):
    """Range of the fingers, and permitted speeds and forces.

    For a Robotiq, stroke and resolution follow from its counts: min_counts open, max_counts closed,
    opening_per_count_m. For any other gripper, give stroke_m and resolution_m instead.
    """

    later = frozenset({"stroke_m", "resolution_m", "speed_m_s", "force_n"})
    min_counts: int = Field(default=6, ge=0, le=255)
    max_counts: int = Field(default=255, ge=0, le=255)
    max_opening_m: float = Field(default=0.120, gt=0, le=0.155)
    opening_per_count_m: float = Field(default=0.155 / 249.0, gt=0, le=0.005)

    stroke_m: float | None = Field(default=None, gt=0, le=0.3)
    resolution_m: float | None = Field(default=None, ge=0.00005, le=0.005)
    speed_m_s: Range = (0.022, 0.110)
    force_n: Range = (15.0, 60.0)

    def spec(self, opening: tuple[tuple[float, float], ...] = ()) -> GripperSpec:
        """Return range and resolution of the gripper. opening: measured pairs of counts and m."""
        step_m = self.resolution_m or self.opening_per_count_m
        return GripperSpec(
            self.max_opening_m,
            self.stroke_m or (self.max_counts - self.min_counts) * step_m,
            step_m,
            self.speed_m_s,
            self.force_n,
            tuple((counts - self.min_counts, opening_m) for counts, opening_m in opening),
        )


def _radians(angles_deg: JointAngles) -> Vector6:
    a, b, c, d, e, f = (math.radians(angle) for angle in angles_deg)
    return a, b, c, d, e, f
