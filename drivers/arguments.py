"""Validation of the arguments of `import rig`: each function returns a value in its plain type.

Every entry of the Python interface calls these functions once, before it computes anything. name: function
and parameter, as "estimate: fps". An invalid value raises `InputError` as "NAME is VALUE: give EXPECTED".
Text is never read as a number, and a bool is no number.
"""

import math
import os
from collections.abc import Collection
from numbers import Integral, Real
from pathlib import Path, PurePath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError

T = TypeVar("T")
SHOWN = 60
"""Characters of an invalid value in a message."""
_NO_NUMBERS = bool, np.bool_, np.timedelta64
"""Types that Python or numpy count among the integers."""
_LONGEST_NAME = 255
"""Bytes of the name of a file or folder (ext4, APFS and NTFS)."""


def number(name: str, value: object, low: float, high: float) -> float:
    """Return a number from `low` to `high` of any numeric type as a float."""
    expected = f"a number from {low:g} to {high:g}"
    if not isinstance(value, Real) or isinstance(value, _NO_NUMBERS):
        raise refusal(name, value, expected)
    try:
        plain = float(value)
    except OverflowError:  # an int with hundreds of digits
        plain = math.inf
    if not low <= plain <= high:
        raise refusal(name, value, expected)
    return plain


def whole(name: str, value: object, low: int, high: int) -> int:
    """Return a whole number from `low` to `high` of any integer type as an int."""
    if not isinstance(value, Integral) or isinstance(value, _NO_NUMBERS) or not low <= int(value) <= high:
        raise refusal(name, value, f"a whole number from {low:.9g} to {high:.9g}")
    return int(value)


def flag(name: str, value: object) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise refusal(name, value, "True or False")
    return bool(value)


def choice(name: str, value: object, choices: Collection[str]) -> str:
    if not isinstance(value, str) or value not in choices:
        raise refusal(name, value, f"one of {', '.join(choices)}")
    return str(value)


def path(name: str, value: object) -> Path:
    """Return a path; it need not exist."""
    if not isinstance(value, str | PurePath) or not str(value) or not _is_path(str(value)):
        raise refusal(name, value, "the path of a file or folder")
    return Path(value)


def instance(name: str, value: object, kind: type[T], expected: str) -> T:
    if not isinstance(value, kind):
        raise refusal(name, value, expected)
    return value


def mask(name: str, values: object, size: int) -> NDArray[np.bool_]:
    """Return `size` truth values as a bool array."""
    try:
        given = np.asarray(values)
    except (TypeError, ValueError, OverflowError):
        given = np.empty(0)
    if given.dtype != np.bool_ or given.shape != (size,) or np.ma.isMaskedArray(values):
        raise refusal(name, values, f"{size} values True or False")
    return given.astype(np.bool_, copy=False)


def array(
    name: str, values: object, shape: tuple[int | None, ...] | None, limit: float, unknown: bool = False
) -> NDArray[np.float64]:
    """Return numbers between -`limit` and `limit` as a float64 array; a masked value is NaN.

    shape: sizes, None for any size; None for any shape. unknown: whether NaN is accepted.
    """
    expected = f"numbers of shape {shape}".replace("None", "N") if shape is not None else "numbers"
    try:
        given = np.asarray(values)
        if np.ma.isMaskedArray(values):
            given = np.ma.filled(values.astype(np.float64), np.nan)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError):  # rows of different lengths, or no numbers
        raise refusal(name, values, expected) from None
    if given.dtype.kind not in "iuf":
        raise InputError(f"{name} contains {given.dtype.name} values, not numbers: give {expected}")
    if shape is not None and (
        len(given.shape) != len(shape)
        or any(n not in (None, m) for n, m in zip(shape, given.shape, strict=True))
    ):
        raise InputError(f"{name} has shape {given.shape}: give {expected}")
    with np.errstate(over="ignore"):
        plain = given.astype(np.float64, copy=False)
    wrong = ~(np.abs(plain) <= limit) & ~(unknown & np.isnan(plain))
    if wrong.any():
        raise InputError(f"{name} contains {plain[wrong][0]:g}: give numbers from {-limit:g} to {limit:g}")
    return plain


def refusal(name: str, value: object, expected: str) -> InputError:
    plain = value is None or isinstance(value, str | bytes | float | complex | np.generic)
    if plain or (isinstance(value, int) and abs(value) < 10**SHOWN):
        shown = repr(value)[:SHOWN]
    else:  # the text of other objects may be long, or fail
        shown = f"a value of type {type(value).__name__}"
    return InputError(f"{name} is {shown}: give {expected}")


def _is_path(text: str) -> bool:
    try:
        return b"\0" not in os.fsencode(text) and all(
            len(os.fsencode(part)) <= _LONGEST_NAME for part in PurePath(text).parts
        )
    except UnicodeEncodeError:  # half of a surrogate pair
        return False
