"""Readers of files from people and other tools: one per format, with size limits checked before decoding.

Imports only errors. Input that a reader rejects raises `FormatError`, whatever the bytes are. This file reads
text: JSON, TOML, YAML, CSV. `picture.py` checks image files, `unpacking.py` compressed data and networks.
"""

import codecs
import csv
import io
import json
import math
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import yaml

from drivers.errors import FormatError, without_passwords
from drivers.formats.picture import (
    MOST_PIXELS,
    holds_floats,
    jpeg_header,
    jpeg_orientation,
    may_hold_several,
    picture_count,
    picture_flaw,
)
from drivers.formats.unpacking import MOST_NETWORK, check_onnx, check_pieces, check_unpacked, check_zip

_LONGEST_REASON, _LONGEST_VALUE = 160, 60
"""Most characters of a reason and of a value in an error message."""


def read_beginning(path: Path, most_bytes: int) -> bytes:
    """Read the first bytes of a file, at most `most_bytes`. Raises `FormatError` if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(most_bytes)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise FormatError(f"{path}: cannot be read ({reason(error)})") from error


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most `most_bytes`. Raises `FormatError`, also if it cannot be read."""
    data = read_beginning(path, most_bytes + 1)
    if len(data) > most_bytes:
        raise FormatError(f"{path}: is larger than the size limit of {most_bytes / 1e6:g} MB")
    return data


def read_text(path: Path, most_bytes: int) -> str:
    """Read UTF-8, with or without a byte order mark, or UTF-16 with one. Raises `FormatError`."""
    data = read_bounded(path, most_bytes)
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: cannot be read as text ({reason(error)})") from error


def quote(value: object) -> str:
    """Return an untrusted value for an error message, shortened and without passwords."""
    text = without_passwords(repr(value))
    return text if len(text) <= _LONGEST_VALUE else text[:_LONGEST_VALUE] + "..."


def reason(error: BaseException) -> str:
    """Return why an operation failed: one printable line, without passwords."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    text = text.partition("; use sys.")[0]  # Python's advice to programmers on very long numbers
    line = without_passwords(" ".join(text.encode("utf-8", "backslashreplace").decode().split()))
    return line if len(line) <= _LONGEST_REASON else line[:_LONGEST_REASON] + " ..."


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically: to a temporary file, synced, then renamed. Raises `OSError`.

    If writing fails, the temporary file is deleted.
    """
    aside = path.with_name(path.name + ".part")
    try:
        with aside.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        aside.replace(path)
    except OSError:
        with suppress(OSError):
            aside.unlink()
        raise


_POINT = r"(?<![0-9])(?<![0-9]\.)[0-9]+\.{}(?:e[+-][0-9]{{1,2}})?(?!\.?[0-9])"
"""A decimal number that is no part of a longer chain, such as a date, 2026.11.26."""
_FRACTION = re.compile(_POINT.format("([0-9]+)"))
_DECIMAL = re.compile(f"((?:^-)?(?:{_POINT.format('[0-9]+')}|[0-9]+(?:e[+-][0-9]{{1,2}})?))")
_WHOLE = re.compile("((?:^-)?[0-9]+)")


def in_number_order(files: Iterable[Path]) -> list[Path]:
    """Return files sorted by name: 2.png before 10.png, 0.1337035.png before 0.867143.png.

    Digits with one point are a decimal number, as in names that are times, if all have equally many digits
    after the point, none ends with a 0, which programs leave out, or one that begins with a 0 has more digits
    than another, which a counter has not. Otherwise they are two integers, as in 1.9.png and 1.10.png, frames
    of lift 1.
    """
    files = list(files)
    fractions = [fraction for file in files for fraction in _FRACTION.findall(file.stem)]
    one_width = len({len(fraction) for fraction in fractions}) < 2
    no_end_zero = not any(fraction.endswith("0") and len(fraction) > 1 for fraction in fractions)
    shortest = min(map(len, fractions), default=0)
    no_counter = any(fraction.startswith("0") and len(fraction) > shortest for fraction in fractions)
    number = _DECIMAL if one_width or no_end_zero or no_counter else _WHOLE

    def key(file: Path) -> tuple[list[str | Decimal], str]:
        parts = number.split(file.stem)  # text and numbers take turns
        return [Decimal(part) if place % 2 else part for place, part in enumerate(parts)], file.name

    return sorted(files, key=key)


# JSON (RFC 8259): NaN, numbers beyond 64 bits and nesting that would exhaust the stack are rejected.
# TOML 1.0, as bench and object files use it: files are short, keys have few parts.
# YAML 1.1, as calibrations use it, including OpenCV's dialect: aliases are rejected. An alias stands for text
# that may contain further aliases, so a few hundred bytes can expand to more than the memory of a computer.

MOST_JSON_BYTES, MOST_TOML_BYTES, MOST_YAML_BYTES = 20_000_000, 200_000, 300_000
"""Size limits of files. A JSON value takes up to 24 times the memory of its text: an empty list, as `[],`."""
LONGEST_WHOLE = 20
"""Most characters of an integer: 64 bits have 19 digits, or 20."""
DEEPEST = 24
"""Most levels of nesting in a YAML file."""
_ONE_DIGIT = bytes.maketrans(b"123456789", b"0" * 9)
_LONG = b"0" * LONGEST_WHOLE
_MANY_PARTS = re.compile(r"(?:\.[^.,\n\[\]{}=]*){17}")
"""A TOML key of more than 16 parts: the parsing time of a key grows with the square of its parts."""
_OPENCV_MATRIX = "tag:yaml.org,2002:opencv-matrix"
_KINDS = ("str", "int", "float", "bool", "null", "seq", "map", "opencv-matrix")
_TAGS = {None, "!", *(f"tag:yaml.org,2002:{kind}" for kind in _KINDS)}


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises `FormatError` with the path."""
    return parse_json(read_bounded(path, MOST_JSON_BYTES), str(path))


def parse_json(data: bytes, where: str) -> Any:
    """Parse a JSON text in UTF-8. where: its name in errors. Raises `FormatError`."""
    try:
        text = data.decode("utf-8-sig")
        value = json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
        if "\\ud" in text.lower():  # half of a surrogate pair: it can be neither written nor printed
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError as error:
        raise FormatError(f"{where}: is rejected as JSON: it is nested too deeply") from error
    except (ValueError, UnicodeError) as error:
        raise FormatError(f"{where}: is not complete JSON ({reason(error)})") from error
    return value


def check_numbers(data: bytes, where: str) -> None:
    """Raise `FormatError` for a number beyond 64 bits. For JSON parsers that accept any length."""
    if _LONG in data.translate(_ONE_DIGIT):  # a quick check; the digits may be part of a text, such as a hash
        parse_json(data, where)


def _whole(text: str) -> int:
    if len(text) > LONGEST_WHOLE:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        is_number = text[-1].isdigit()  # otherwise NaN or Infinity
        raise ValueError(
            f"the number {text[:LONGEST_WHOLE]} is too large" if is_number else f"{text} is not a number"
        )
    return value


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises `FormatError` with the path and the line."""
    return parse_toml(read_text(path, MOST_TOML_BYTES), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Parse a TOML text. where: its name in errors. Raises `FormatError`."""
    for line in text.split("\n"):
        if not line.lstrip().startswith("#") and _MANY_PARTS.search(line):
            raise FormatError(f"{where}: is rejected as TOML: a key of more than 16 parts: {line[:40]}")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise FormatError(f"{where}: is rejected as TOML: it is nested too deeply") from error
    except ValueError as error:  # also covers tomllib's own error, and invalid numbers and dates
        raise FormatError(f"{where}: not valid TOML: {reason(error)}") from error


_KEY = re.compile(r""""([^"\\\n]{1,60})"[ \t]*:|^[ \t-]*([A-Za-z_][\w-]{0,60})[ \t]*:""", re.MULTILINE)
"""A key of a JSON or YAML text."""
MOST_SEARCHED = 50_000
"""Most characters of a text that are searched for a similar key: that takes less than 1 s."""


def key_place(text: str, key: str) -> str:
    """Return where a key of a JSON or YAML text is first, as "line 3, column 5"; "" if it is not found.

    In a text of one line it is "column 5".
    """
    found = next((match for match in _KEY.finditer(text) if key in match.groups()), None)
    if found is None:
        return ""
    start = found.start(found.lastindex or 0)
    line, column = text.count("\n", 0, start) + 1, start - text.rfind("\n", 0, start)
    return f"line {line}, column {column}" if "\n" in text.strip() else f"column {column}"


def similar_key(text: str, missing: str) -> str:
    """Return " (line 3, column 5 has 'shape')" if a key resembles a missing one, else "".

    text: JSON or YAML, of which the beginning is searched.
    """
    keys = {found[found.lastindex or 0] for found in _KEY.finditer(text[:MOST_SEARCHED])}
    near = get_close_matches(missing, keys - {missing}, n=1, cutoff=0.8)
    return f" ({key_place(text, near[0])} has '{near[0]}')" if near else ""


def read_yaml(path: Path) -> Any:
    """Read a YAML file of one document; dates stay text. Raises `FormatError` with the path."""
    # OpenCV writes "%YAML:1.0", which is not YAML, and tags its matrices
    text = read_text(path, MOST_YAML_BYTES).removeprefix("%YAML:1.0")
    try:
        _check_yaml(text)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader
    except (yaml.YAMLError, ValueError, ArithmeticError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: is not valid YAML ({reason(error)})") from error


def _check_yaml(text: str) -> None:
    """Reject aliases, unknown tags and deep nesting before any value is constructed."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"line {event.start_mark.line + 1}: an alias, *{event.anchor}: write it out")
        if getattr(event, "tag", None) not in _TAGS:
            raise ValueError(f"line {event.start_mark.line + 1}: an unknown kind of value, {event.tag}")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST:
            raise ValueError(f"line {event.start_mark.line + 1}: nested too deeply")


_Safe: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The C implementation if the library was built with it: ten times as fast."""


class _Loader(_Safe):
    """A safe loader that supports OpenCV's matrices and leaves dates as text."""


def _yaml_whole(loader: _Loader, node: yaml.ScalarNode) -> int:
    """Convert a decimal, hexadecimal or octal integer; the sexagesimal numbers of YAML 1.1 are rejected."""
    text = node.value.replace("_", "").lower()
    if len(text) > LONGEST_WHOLE:
        raise ValueError(f"line {node.start_mark.line + 1}: a number of {len(text)} digits")
    return int(text, 8 if text.lstrip("+-").startswith("0") and text.lstrip("+-").isdigit() else 0)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in kinds if not tag.endswith(":timestamp")]
    for first, kinds in _Loader.yaml_implicit_resolvers.items()
}
_Loader.add_constructor("tag:yaml.org,2002:int", _yaml_whole)
_Loader.add_constructor(_OPENCV_MATRIX, lambda loader, node: loader.construct_mapping(node, deep=True))


# CSV (RFC 4180) with a header: columns by name, rows with their line number, fields as text or numbers.
# Fields are separated by commas, semicolons or tabs, the most frequent one in the header. Empty lines and
# lines that begin with # are skipped. The last of the comments before a table without a header is its header
# if it has as many fields, because `numpy.savetxt` writes it so.
#
# One grammar of numbers holds for every table that the rig reads: a sign, digits with a decimal point, and a
# decimal exponent; sign, point and exponent may be missing: `20`, `-.5`, `2.000e+01`. Python, NumPy, pandas,
# MATLAB and spreadsheets write this form. Decimal commas are rejected with the cure, because `1,234` has two
# meanings. Infinity, NaN, control characters, hexadecimal numbers and digits of other scripts are rejected.

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
    text = text.strip(_BLANKS)
    if _COMMA.fullmatch(text):
        raise FormatError(
            f"{quote(text)} has a comma: write numbers with a decimal point, without thousands separators"
        )
    if not _NUMBER.fullmatch(text):
        raise FormatError(f"{quote(text)} is not a number")
    value = float(text)
    if not math.isfinite(value):
        raise FormatError(f"{quote(text)} is too large")
    return value


def parse_whole(text: str) -> int:
    """Parse an integer of 64 bits, also if it is written with a point or an exponent, as `2.0e+01`.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    exact = _exact(text, value) if abs(value) <= _MAX_WHOLE else None
    if exact is None or not -_MAX_WHOLE <= exact < _MAX_WHOLE:
        raise FormatError(f"{quote(text)} does not fit 64 bits")
    if exact != exact.to_integral_value():
        raise FormatError(f"{quote(text)} is not a whole number")
    return int(exact)


def parse_time_ns(text: str) -> int:
    """Parse a time in s, of at most `MAX_TIME_S`, and return it in ns without the rounding of a float.

    Raises `FormatError` as `parse_number` does.
    """
    value = parse_number(text)
    if abs(value) > MAX_TIME_S:
        raise FormatError(f"{quote(text)} is beyond {MAX_TIME_S:g} s: give times in s")
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


def _exact(text: str, value: float) -> Decimal:
    """Return the exact value; 0 if it is below every float, since the exponents of decimals are limited."""
    return Decimal(text) if value else Decimal(0)


MOST_CSV_BYTES = 64_000_000
"""Size limit of a CSV file."""
MOST_ROWS, MOST_FIELDS = 500_000, 3_000_000
"""Limits of a CSV file; 500,000 rows are two hours of frames at 60 Hz."""
DELIMITERS = ",;\t"
Lines = list[tuple[int, tuple[str, ...]]]


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A table. columns: names in the header. lines: (last line number in the file, fields) of each row."""

    where: str
    columns: tuple[str, ...]
    lines: tuple[tuple[int, tuple[str, ...]], ...]

    def require(self, *needed: str) -> None:
        """Raise `FormatError` naming the columns that are missing."""
        missing = [name for name in needed if name not in self.columns]
        if missing:
            have = ", ".join(self.columns)[:80] or "nothing"
            raise FormatError(
                f"{self.where}: line 1 has no column {', '.join(missing)}: it needs {', '.join(needed)} and "
                f"has {have}"
            )

    def rows(self) -> Iterator[tuple[int, dict[str, str]]]:
        """Yield (line, fields by column); a missing field is ""."""
        blank = dict.fromkeys(self.columns, "")
        for line, fields in self.lines:
            yield line, {**blank, **dict(zip(self.columns, fields, strict=False))}


def read_csv(path: Path, needed: Sequence[str] = ()) -> CsvTable:
    """Read a table from a file, see `parse_csv`. Raises `FormatError` naming it."""
    table = parse_csv(read_text(path, MOST_CSV_BYTES), str(path))
    table.require(*needed)
    return table


def read_csv_rows(path: Path, needed: Sequence[str] = ()) -> list[tuple[int, dict[str, str]]]:
    """Return (line, fields by column) of each row. Raises `FormatError`, also for a missing column."""
    return list(read_csv(path, needed).rows())


def parse_csv(text: str, where: str) -> CsvTable:
    """Parse a CSV text. where: its name in errors.

    Raises `FormatError` for a field or table that is too long, for a name that two columns have, and for a
    row with more fields than the header: decimal commas and unquoted commas in a text look so. A table
    without rows is accepted.
    """
    header, lines = _with_header(*_lines(text, where))
    if twice := next((name for i, name in enumerate(header) if name and name in header[:i]), ""):
        raise FormatError(f"{where}: has two columns {quote(twice)}: remove or rename one")
    for number, fields in lines:
        if any(fields[len(header) :]):
            raise FormatError(
                f"{where}: line {number} has {len(fields)} fields, the header {len(header)}: write numbers "
                "with a decimal point, and put a text that contains the separator in quotes"
            )
    return CsvTable(where, header, tuple(lines))


def _lines(text: str, where: str) -> tuple[tuple[str, ...], Lines]:
    """Return the last comment before the rows, and the rows, each with its last line number."""
    comment: tuple[str, ...] = ()
    lines: Lines = []
    fields = 0
    try:
        stream = io.StringIO(text, newline="")
        head = next((line for line in text.split("\n", 50) if line.strip() and line[0] != "#"), "")
        reader = csv.reader(stream, delimiter=max(DELIMITERS, key=head.count), skipinitialspace=True)
        for raw in reader:
            fields += len(raw)
            if len(lines) > MOST_ROWS or fields > MOST_FIELDS:
                raise csv.Error(f"more than {MOST_ROWS} rows, or {MOST_FIELDS} fields")
            row = tuple(field.strip() for field in raw)
            if row and row[0].startswith("#"):
                comment = comment if lines else (row[0].lstrip("# "), *row[1:])
            elif any(row):
                lines.append((reader.line_num, row))
    except csv.Error as error:
        raise FormatError(f"{where}: is not valid CSV ({reason(error)})") from error
    return comment, lines


def _with_header(comment: tuple[str, ...], lines: Lines) -> tuple[tuple[str, ...], Lines]:
    """Return the header and the rows below it: the first row, or the comment before a table of numbers."""
    if not lines:
        return (), []
    first = lines[0][1]
    if len(comment) == len(first):
        with suppress(FormatError):
            for field in first:
                parse_number(field)
            return comment, lines
    return first, lines[1:]
