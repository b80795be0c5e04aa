"""Putting taught values into an object file's text, its comments kept."""

import re
from collections.abc import Mapping

from drivers.errors import InputError
from protocols.grasps import GraspFile
from rig.config.objects import parse_object

_POSITION = re.compile(r"\s*\[\[\s*position\s*\]\]")
_TABLE = re.compile(r"\s*\[")
_VALUE = re.compile(r"(?P<key>\s*[\w-]+\s*=\s*)(?P<value>\"[^\"]*\"|'[^']*'|[^#\s]+)(?P<rest>\s*(?:#.*)?)$")


def with_position(text: str, name: str, values: Mapping[str, float], where: str) -> tuple[str, GraspFile]:
    """Return an object file's text with other values at a position, and what it says then.

    values: by their keys, as {"offset_m": -0.05}. A position that is not there is added. where: what messages
    call the file. Raises `InputError` where the file is written in a way that this does not change.
    """
    lines = text.splitlines()
    block = next((b for b in _blocks(lines) if _name_in(lines, b) == name), None)
    if block is None:
        lines = _added(lines, name, values)
    else:
        lines[block.start : block.stop] = _changed(lines[block.start : block.stop], values)
    changed = "\n".join(lines) + "\n"
    read = parse_object(changed, where)
    place = next((position for position in read.position if position.name == name), None)
    if place is None or any(getattr(place, key) != value for key, value in values.items()):
        said = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        raise InputError(f"{where}: is written in a way that is not changed here; put in at '{name}': {said}")
    return changed, read


def _blocks(lines: list[str]) -> list[range]:
    """Return the lines of each [[position]], its heading among them."""
    found = []
    for start in (i for i, line in enumerate(lines) if _POSITION.match(line)):
        ends = (i for i in range(start + 1, len(lines)) if _TABLE.match(lines[i]))
        found.append(range(start, next(ends, len(lines))))
    return found


def _name_in(lines: list[str], block: range) -> str | None:
    for i in block:
        line = _VALUE.match(lines[i])
        if line and line["key"].split("=")[0].strip() == "name":
            return line["value"][1:-1]
    return None


def _changed(block: list[str], values: Mapping[str, float]) -> list[str]:
    """Change the lines that are there, and put the others behind the last of them."""
    left, lines, last = dict(values), [], 0
    for line in block:
        found = _VALUE.match(line)
        key = found["key"].split("=")[0].strip() if found else None
        if found and key in left:
            line = _with_value(found, left.pop(key))
        if found:
            last = len(lines)
        lines.append(line)
    return [*lines[: last + 1], *(f"{key} = {value:g}" for key, value in left.items()), *lines[last + 1 :]]


def _with_value(line: re.Match[str], value: float) -> str:
    """Write another value, the comment behind it where it stood, if there is room."""
    written = line["key"] + f"{value:g}"
    comment = line["rest"].strip()
    return (
        f"{written:<{line.start('rest') + len(line['rest']) - len(comment) - 1}} {comment}"
        if comment
        else written
    )


def _added(lines: list[str], name: str, values: Mapping[str, float]) -> list[str]:
    """Add a position behind the others."""
    new = ["[[position]]", f'name = "{name}"', *(f"{key} = {value:g}" for key, value in values.items()), ""]
    blocks = _blocks(lines)
    end = blocks[-1].stop if blocks else len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    return [*lines[:end], "", *new, *lines[end:]]
