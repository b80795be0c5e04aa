"""JSON, TOML and YAML of unknown origin, as plain values: bounded in size, nesting and length of numbers.

JSON (RFC 8259): no NaN, no number beyond 64 bits, no nesting that would end the program. TOML 1.0, as bench
and object files are written: short, with keys of a few parts. YAML 1.1 as calibrations are written, OpenCV's
dialect included: no references. An alias stands for text that may contain further aliases, so that a few
hundred bytes can expand to more than a computer holds; no calibration needs one.
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
"""Sizes of files that are read. A JSON value takes up to 24 times its text: an empty list, as `[],`."""
LONGEST_WHOLE = 20
"""Characters of a whole number: 64 bits have 19 digits, or 20."""
DEEPEST = 24
"""Levels of nesting of a YAML file."""
_ONE_DIGIT = bytes.maketrans(b"123456789", b"0" * 9)
_LONG = b"0" * LONGEST_WHOLE
_MANY_PARTS = re.compile(r"(?:\.[^.,\n\[\]{}=]*){17}")
"""A TOML key of more than 16 parts: the time that a key takes grows with the square of its parts."""
_OPENCV_MATRIX = "tag:yaml.org,2002:opencv-matrix"
_KINDS = ("str", "int", "float", "bool", "null", "seq", "map", "opencv-matrix")
_TAGS = {None, "!", *(f"tag:yaml.org,2002:{kind}" for kind in _KINDS)}


def read_json(path: Path, most_bytes: int = MOST_JSON_BYTES) -> Any:
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


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises `FormatError` naming it, and the line."""
    return parse_toml(read_text(path, MOST_TOML_BYTES), str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the tables of a TOML text. where: its name in errors. Raises `FormatError`."""
    for line in text.split("\n"):
        if not line.lstrip().startswith("#") and _MANY_PARTS.search(line):
            raise FormatError(f"{where}: is no TOML that is read: a key of more than 16 parts: {line[:40]}")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise FormatError(f"{where}: is no TOML that is read: it is nested too deeply") from error
    except ValueError as error:  # tomllib's own, and those of numbers and dates
        raise FormatError(f"{where}: not valid TOML: {reason(error)}") from error


def read_yaml(path: Path) -> Any:
    """Read a YAML file of one document; dates stay text. Raises `FormatError` naming it."""
    # OpenCV writes "%YAML:1.0", which is not YAML, and tags its matrices
    text = read_text(path, MOST_YAML_BYTES).removeprefix("%YAML:1.0")
    try:
        _check_yaml(text)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader
    except (yaml.YAMLError, ValueError, ArithmeticError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: is not YAML that is read ({reason(error)})") from error


def _check_yaml(text: str) -> None:
    """Refuse what would cost more than its length before anything is made of it."""
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
"""Written in C, where the library was built with it: ten times as fast."""


class _Loader(_Safe):
    """A safe loader that knows OpenCV's matrices, and leaves dates as they are written."""


def _yaml_whole(loader: _Loader, node: yaml.ScalarNode) -> int:
    """Decimal, hexadecimal or octal; the sexagesimal numbers of YAML 1.1 are none in YAML 1.2."""
    text = node.value.replace("_", "").lower()
    if len(text) > LONGEST_WHOLE:
        raise ValueError(f"line {node.start_mark.line + 1}: a number of {len(text)} digits")
    return int(text, 8 if text.lstrip("+-").startswith("0") and text.lstrip("+-").isdigit() else 0)


def _opencv_matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in kinds if not tag.endswith(":timestamp")]
    for first, kinds in _Loader.yaml_implicit_resolvers.items()
}
_Loader.add_constructor("tag:yaml.org,2002:int", _yaml_whole)
_Loader.add_constructor(_OPENCV_MATRIX, _opencv_matrix)
