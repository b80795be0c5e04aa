"""YAML 1.1 as calibrations are written, OpenCV's dialect included: plain values, no references.

An alias stands for what may itself be made of aliases, so that a few hundred bytes can mean more than
a computer holds; no calibration needs one.
"""

from pathlib import Path
from typing import Any

import yaml

from drivers.errors import FormatError
from drivers.formats.text import read_text, reason

MOST_BYTES = 300_000
DEEPEST = 24
LONGEST_WHOLE = 20
_OPENCV_MATRIX = "tag:yaml.org,2002:opencv-matrix"
_KINDS = ("str", "int", "float", "bool", "null", "seq", "map", "opencv-matrix")
_TAGS = {None, "!", *(f"tag:yaml.org,2002:{kind}" for kind in _KINDS)}


def read_yaml(path: Path) -> Any:
    """Read a YAML file of one document; dates stay text. Raises `FormatError` naming it."""
    # OpenCV writes "%YAML:1.0", which is not YAML, and tags its matrices
    text = read_text(path, MOST_BYTES).removeprefix("%YAML:1.0")
    try:
        _check(text)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader
    except (yaml.YAMLError, ValueError, ArithmeticError, TypeError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path}: is not YAML that is read ({reason(error)})") from error


def _check(text: str) -> None:
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


def _whole(loader: _Loader, node: yaml.ScalarNode) -> int:
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
_Loader.add_constructor("tag:yaml.org,2002:int", _whole)
_Loader.add_constructor(_OPENCV_MATRIX, _opencv_matrix)
