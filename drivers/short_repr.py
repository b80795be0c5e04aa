"""One-line `repr` of dataclasses that hold arrays."""

from dataclasses import fields
from typing import Any

MOST_SHOWN = 4
"""Longer tuples and dicts are shown by their number of values."""


def short_repr(self: Any) -> str:
    """Return a dataclass as one line: arrays by shape and type, numbers with 6 digits.

    Use it as a method: `__repr__ = short_repr` in the body of the class.
    """
    shown = ", ".join(f"{field.name}={_short(getattr(self, field.name))}" for field in fields(self))
    return f"{type(self).__name__}({shown})"


def _short(value: Any) -> str:
    if hasattr(value, "dtype"):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list | dict) and len(value) > MOST_SHOWN:
        return f"{len(value)} values"
    return repr(value)
