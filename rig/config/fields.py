"""Types of the values in a bench file: lengths in m, angles, rates, names, addresses."""

import math
import re
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from drivers.formats import without_passwords
from drivers.named_classes import is_class_name

Coordinate = Annotated[float, Field(ge=-5, le=5)]
"""m in the base frame. No bench is larger, so a value given in mm is caught."""
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
    """Return a validator that refuses text that does not match a pattern."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(f"is not {what}")
        return text

    return AfterValidator(check)


Host = Annotated[str, _written_as(r"\w([\w.-]*\w)?", "an IPv4 address or a host's name")]
HostPort = Annotated[str, _written_as(r"[^:\s]+:\d+", "host:port")]


def _inside(text: str) -> str:
    """Hold a path to files below the folder that it is of."""
    if any(not _FILE_NAME.fullmatch(part) or part in (".", "..") for part in text.split("/")):
        raise ValueError("is no name of a file inside its folder")
    return text


_FILE_NAME = re.compile(r"[^/\\\x00-\x1f\x7f]{1,150}")
InnerPath = Annotated[str, Field(min_length=1), AfterValidator(_inside)]
"""A file in a session, its parts apart by `/`."""
FileName = Annotated[InnerPath, _written_as(r"[^/]*", "a name that a file can have")]
"""What becomes part of a file's name: serials, objects, benches."""


def driver_names(*ours: str) -> AfterValidator:
    """Return a validator of `driver`: one of the rig's own, or `package.module:Class`."""

    def check(text: str) -> str:
        if text not in ours and not is_class_name(text):
            named = " or ".join(f"'{name}'" for name in ours)
            raise ValueError(f"Input should be {named}, or a class of your own as 'package.module:Class'")
        return text

    return AfterValidator(check)


Options = dict[str, Any]
"""Keys of a device's own class, in its subtable `options`."""


def without_secrets(options: Options) -> Options:
    """Return options without what addresses in them say of passwords."""
    return {
        key: without_passwords(value) if isinstance(value, str) else value for key, value in options.items()
    }


class Strict(BaseModel):
    """Refuses unknown keys, NaN and infinities."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class BenchSection(Strict):
    """A table (section) of a bench file."""

    later: ClassVar[frozenset[str]] = frozenset()
    """Keys that the first sessions did not have: a stored copy holds those that are not at their default."""

    @model_serializer(mode="wrap")
    def _stored(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        at_default = {key for key in self.later if getattr(self, key) == type(self).model_fields[key].default}
        return {key: value for key, value in serialize(self).items() if key not in at_default}
