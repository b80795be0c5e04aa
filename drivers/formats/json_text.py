"""JSON (RFC 8259): no NaN, no number beyond 64 bits, no nesting that would end the program."""

import json
import math
from pathlib import Path
from typing import Any

from drivers.errors import FormatError
from drivers.formats.text import read_bounded, reason

MOST_BYTES = 20_000_000
"""A value takes up to 24 times its text: an empty list, as `[],`."""
LONGEST_WHOLE = 20
"""Characters of a whole number: 64 bits have 19 digits, or 20."""
_ONE_DIGIT = bytes.maketrans(b"123456789", b"0" * 9)
_LONG = b"0" * LONGEST_WHOLE


def read_json(path: Path, most_bytes: int = MOST_BYTES) -> Any:
    """Read a JSON file. Raises `FormatError` naming it."""
    return parse_json(read_bounded(path, most_bytes), str(path))


def parse_json(data: bytes, where: str) -> Any:
    """Return the value of a JSON text in UTF-8. where: its name in errors. Raises `FormatError`."""
    try:
        text = data.decode("utf-8-sig")
        value = json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_no_number)
        if "\\ud" in text.lower():  # half a character of two: it could be neither written nor printed
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError as error:
        raise FormatError(f"{where}: is no JSON that is read: it is nested too deeply") from error
    except (ValueError, UnicodeError) as error:
        raise FormatError(f"{where}: is no complete JSON ({reason(error)})") from error
    return value


def check_numbers(data: bytes, where: str) -> None:
    """Raise `FormatError` for a number beyond 64 bits: for readers that take numbers of any length."""
    if _LONG in data.translate(_ONE_DIGIT):  # at first sight; it may be a text, as a hash is
        parse_json(data, where)


def _whole(text: str) -> int:
    if len(text) > LONGEST_WHOLE:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:LONGEST_WHOLE]} is too large")
    return value


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number")
