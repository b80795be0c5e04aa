"""Numbers in text tables: one grammar for every table that the rig reads.

A number consists of a sign, digits with a decimal point, and a decimal exponent; sign, point and exponent may
be missing: `20`, `-.5`, `2.000e+01`. Python, NumPy, pandas, MATLAB and spreadsheets write this form. Blanks
around it are ignored. Decimal commas are rejected with the cure, because `1,234` has two meanings. Infinity,
NaN, control characters, hexadecimal numbers and digits of other scripts are rejected.
"""

import math
import re
from collections.abc import Callable, Mapping
from decimal import Decimal
from typing import TypeVar

from drivers.errors import FormatError
from drivers.formats.text import shown

MAX_TIME_S = 9e9
"""Largest time, s. Larger times do not fit the 64-bit integer nanoseconds of files."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?[0-9.]*(?:,[0-9]+)+\.?[0-9]*(?:[eE][+-]?[0-9]+)?")
_BLANKS = " \t\r\n\f\v\u00a0"
_NS = 10**9
_MAX_WHOLE = 2**63
Value = TypeVar("Value", int, float)


def parse_number(text: str) -> float:
    """Parse a finite number, to the same value as Python's `float`.

    Raises `FormatError` that begins with the text; callers prefix its place.
    """
    value = float(_checked(text))
    if not math.isfinite(value):
        raise FormatError(f"{shown(text)} is too large")
    return value


def parse_whole(text: str) -> int:
    """Parse an integer of 64 bits, also if it is written with a point or an exponent, as `2.0e+01`.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    exact = _exact(text, value) if abs(value) <= _MAX_WHOLE else None
    if exact is None or not -_MAX_WHOLE <= exact < _MAX_WHOLE:
        raise FormatError(f"{shown(text)} does not fit 64 bits")
    if exact != exact.to_integral_value():
        raise FormatError(f"{shown(text)} is not a whole number")
    return int(exact)


def parse_time_ns(text: str) -> int:
    """Parse a time in s, of at most `MAX_TIME_S`, and return it in ns without the rounding of a float.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    if abs(value) > MAX_TIME_S:
        raise FormatError(f"{shown(text)} is beyond {MAX_TIME_S:g} s: give times in s")
    return round(_exact(text, value) * _NS)


def number_in(row: Mapping[str, str], column: str, where: str) -> float:
    """Return the number in a column of a row. Raises `FormatError` naming place and column."""
    return _in(parse_number, row, column, where)


def whole_in(row: Mapping[str, str], column: str, where: str) -> int:
    """Return the integer in a column of a row. Raises `FormatError` naming place and column."""
    return _in(parse_whole, row, column, where)


def time_ns_in(row: Mapping[str, str], column: str, where: str) -> int:
    """Return the time in a column of a row: s in the table, ns here. Raises `FormatError` as the others."""
    return _in(parse_time_ns, row, column, where)


def _in(parse: Callable[[str], Value], row: Mapping[str, str], column: str, where: str) -> Value:
    try:
        return parse(row.get(column, ""))
    except FormatError as error:
        raise FormatError(f"{where}: column {column}: {error}") from error


def _checked(text: str) -> str:
    text = text.strip(_BLANKS)
    if _NUMBER.fullmatch(text):
        return text
    if _COMMA.fullmatch(text):
        raise FormatError(
            f"{shown(text)} has a comma: write numbers with a decimal point, without thousands separators"
        )
    raise FormatError(f"{shown(text)} is not a number")


def _exact(text: str, value: float) -> Decimal:
    """Return the exact value; 0 if it is below every float, since the exponents of decimals are limited."""
    return Decimal(text) if value else Decimal(0)
