"""Plain values: vectors, validation of the values in a device's state, one-line `repr` of dataclasses.

The constructors of the state types validate, because a comparison with NaN is always false: a single NaN
would switch off every check that reads it. Cost: 7 us for a state of the arm, 2 us for one of the gripper
(`timeit` on a 2-core host); both are read every 8 ms during a motion. Imports no numpy: the arm's processes
start without it.
"""

import sys
from dataclasses import fields
from typing import Any

from drivers.errors import InvalidStateError

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
_LARGEST = sys.float_info.max
_ROUNDING = 1e-6
"""Rounding error by which a fraction may exceed 1."""
_SHOWN = 100
"""Characters of an invalid value in a message."""
_MOST_SHOWN = 4
"""`short_repr` prints longer tuples and dicts as their number of values."""


def require_numbers(what: str, values: object, count: int) -> None:
    """Raise `InvalidStateError` unless `values` is a tuple of `count` finite numbers.

    A list or an array is rejected as well: a driver that refills it would change a state read earlier.
    what: name of the value in the message, as "the arm's wrench".
    """
    if not (isinstance(values, tuple) and len(values) == count and all(map(_is_number, values))):
        raise invalid(what, values, f"a tuple of {count} finite numbers")


def require_number(what: str, value: object, low: float = -_LARGEST, high: float = _LARGEST) -> None:
    """Raise `InvalidStateError` unless a value is a finite number from `low` to `high`."""
    if not (_is_number(value) and low <= value <= high):  # type: ignore[operator]
        raise invalid(what, value, f"a number from {low:g} to {high:g}")


def require_fraction(what: str, value: object) -> None:
    """Raise `InvalidStateError` unless a value is a number from 0 to 1, rounding error allowed."""
    require_number(what, value, 0.0, 1.0 + _ROUNDING)


def require_integer(what: str, value: object) -> None:
    """Raise `InvalidStateError` unless a value is an int; a bool is rejected."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise invalid(what, value, "an int")


def require_type(what: str, value: object, kind: type[object]) -> None:
    """Raise `InvalidStateError` unless a value is an instance of a class."""
    if not isinstance(value, kind):
        raise invalid(what, value, f"a {kind.__name__}")


def invalid(what: str, value: object, expected: str) -> InvalidStateError:
    """Return the error for an invalid value of a device state."""
    shown = " ".join(repr(value).split())[:_SHOWN]  # an array's has line breaks
    return InvalidStateError(
        f"{what} is {shown}, expected {expected}: the state of the device is unknown; "
        "inspect the device, then check its driver"
    )


def _is_number(value: object) -> bool:
    # False for NaN and infinity; correct also for an int that is too large for a float
    return isinstance(value, float | int) and not isinstance(value, bool) and -_LARGEST <= value <= _LARGEST


def short_repr(self: Any) -> str:
    """Return a dataclass as one line: arrays by shape and type, numbers with 6 digits.

    Fields that are None by default are left out while they are None. Use it as a method:
    `__repr__ = short_repr` in the body of the class.
    """
    values = [(field, getattr(self, field.name)) for field in fields(self)]
    kept = [(f, value) for f, value in values if value is not None or f.default is not None]
    shown = ", ".join(f"{f.name}={_short(value)}" for f, value in kept)
    return f"{type(self).__name__}({shown})"


def _short(value: Any) -> str:
    if hasattr(value, "dtype"):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list | dict) and len(value) > _MOST_SHOWN:
        return f"{len(value)} values"
    return repr(value)
