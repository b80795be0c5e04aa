"""Numbers as they come down the side channel, checked before anything is begun with them."""

from typing import Any

from drivers.clock import to_ns
from drivers.errors import InputError

LONGEST_S = 86_400.0


def duration_ns(value: Any, whose: str) -> int | None:
    """A duration in s as ns; None stays None. Raises `InputError` naming `whose` it is."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= LONGEST_S:
        raise InputError(f"{whose}: a duration of {value!r}: give 0 to {LONGEST_S:g} s")
    return to_ns(value)


def whole_number(value: Any, whose: str, most: int) -> int | None:
    """A whole number from 0 on; None stays None. Raises `InputError` naming `whose` it is."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise InputError(f"{whose}: {value!r}: give a whole number from 0 to {most}")
    return value
