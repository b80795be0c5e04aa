"""Read untrusted JSON, TOML and YAML as plain values, with limits on size, nesting and length of numbers.

JSON (RFC 8259): NaN, numbers beyond 64 bits and nesting that would exhaust the stack are rejected. TOML 1.0,
as bench and object files use it: files are short, keys have few parts. YAML 1.1, as calibrations use it,
including OpenCV's dialect: aliases are rejected. An alias stands for text that may contain further aliases,
so a few hundred bytes can expand to more than the memory of a computer; no calibration needs one.
"""

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

from drivers.errors import FormatError
from drivers.formats.text import read_bounded, read_text, reason

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
