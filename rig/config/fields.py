"""Types of the values in a bench file: lengths in m, angles, rates, names, addresses."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from drivers.named_classes import CLASS_NAME

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
Range = tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]]
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


ClassName = Annotated[str, _written_as(CLASS_NAME, "a class of your own, as 'package.module:Class'")]
_FILE_NAME = re.compile(r"[^/\\\x00-\x1f\x7f]{1,150}")
InnerPath = Annotated[str, Field(min_length=1), AfterValidator(_inside)]
"""A file in a session, its parts separated by `/`."""
FileName = Annotated[InnerPath, _written_as(r"[^/]*", "a valid file name")]
"""Part of a file name: serials, objects, benches."""


KeyPath = Sequence[str | int]
"""Keys and list indices from the top of a bench file, such as ("tactile", 1, "rate_hz")."""
KeyFault = tuple[KeyPath, str]
"""A key and its problem."""
Options = dict[str, Any]
"""Keys of a user-defined device class, in its subtable `options`."""


class Strict(BaseModel):
    """Rejects unknown keys, NaN and infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Section(Strict):
    """A table (section) of a bench file."""
