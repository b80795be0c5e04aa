"""Numbers in texts of pages; `numbers.js` does the same in a browser."""

import re
from typing import TypeVar

Value = TypeVar("Value")

_HYPHEN = re.compile(r"(?<![\w.,/)\]%+-])-(?=\.?\d)")
_ZERO = re.compile(r"\u2212(0(?:\.0*)?)(?![\d.]|e[+-]?\d)")


def with_minus(value: Value) -> Value:
    """Return a text with minus signs in place of the hyphens of numbers, and without the sign of -0.0.

    Command lines, HTML and other values are returned unchanged.
    """
    if type(value) is not str or "-" not in value or " --" in value or value.startswith("rig "):
        return value
    return _ZERO.sub(r"\1", _HYPHEN.sub("\u2212", value))  # type: ignore[return-value]
