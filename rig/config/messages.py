"""Messages about the faults of a file: a line for each, with place, key, reason and what to write."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from drivers.errors import FileFaultsError, FormatError, nearest, plural
from drivers.formats import parse_toml, quote
from drivers.named_classes import file_hint
from rig.config.devices import (
    OWN,
    ArmConfig,
    CameraConfig,
    GripperConfig,
    GripperLimitsConfig,
    StrokeLimits,
    TactileConfig,
)
from rig.config.fields import KeyFault, KeyPath

DEVICES = {"arm": ArmConfig, "gripper": GripperConfig, "tactile": TactileConfig, "camera": CameraConfig}
"""Unions of sections by key."""
_UNIONS = (*DEVICES.values(), GripperLimitsConfig | StrokeLimits)
MEMBERS: dict[str | int, type[BaseModel]] = {
    member.__name__: member for union in _UNIONS for member in get_args(union)
}
"""Members of unions of sections; pydantic puts their names into the path of a key."""
MOST_LINES = 500
"""Most lines of a file that are searched for a key: the time grows with the square of the lines."""
MOST_FAULTS = 20
"""Most faults listed in one message."""
_REASONS = {
    "missing": "is missing",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "none_required": "must be null",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotation marks",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must have the form {pattern}",
    "string_too_long": "must have at most {max_length} characters",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "too_long": "has more than {max_length} entries",
    "too_short": "has too few entries",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "dataclass_type": "must be a table",
}
"""What pydantic's types of errors mean to a person who writes a file."""


def faults_of(error: ValidationError, model: type[BaseModel]) -> list[KeyFault]:
    """Return the invalid keys of a file and the reasons. model: of the whole file."""
    known, every = _keys_of(model), error.errors(include_url=False)
    # a list whose entries are invalid also counts as too short
    lists = {each["loc"][:n] for each in every for n in range(len(each["loc"]))}
    wrong = (each for each in every if each["type"] != "too_short" or each["loc"] not in lists)
    return [_fault(details, model, known) for details in wrong]


def fault_of(details: Any) -> KeyFault:
    """Return a key and why its value is invalid. details: an entry of `ValidationError.errors`."""
    path, kind, given = path_of(details), details["type"], details["input"]
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        if isinstance(given, Mapping):
            return _driver(path, given.get("driver"))
        why = "must be a table"
    elif kind == "json_invalid":
        return path, f"is not valid JSON: {details['ctx']['error']}"
    elif kind == "value_error":
        why = details["msg"].removeprefix("Value error, ")
    else:
        why = _REASONS.get(kind, "is not valid").format(**details.get("ctx", {}))
    return path, f"{why}, found {_name_value(given)}"


def _name_value(given: object) -> str:
    """Return an invalid value as its file has it, or "a table" and "a list of tables"."""
    if isinstance(given, Mapping):
        return "a table"
    if isinstance(given, list) and any(isinstance(each, Mapping) for each in given):
        return "a list of tables"
    return json.dumps(given) if given is None or isinstance(given, bool) else quote(given)


def path_of(details: Any) -> list[str | int]:
    """Return the path of a key as in the file, without the names of classes."""
    return [part for part in details["loc"] if part not in MEMBERS]


def _fault(details: Any, model: type[BaseModel], known: set[str]) -> KeyFault:
    loc, kind, path = details["loc"], details["type"], path_of(details)
    if kind == "extra_forbidden":
        return path, _unknown(loc, known)
    if kind != "missing":
        return fault_of(details)
    if isinstance(path[-1], int):
        return path[:-1], f"has only {path[-1]} of its entries"
    return path, f"is missing{_what_to_write(_model_of(loc, model), path)}"


def _driver(path: KeyPath, given: object) -> KeyFault:
    """Return the fault of a section without a driver, or with an unknown one."""
    section = next(part for part in reversed(path) if part in DEVICES)
    kinds = (member.model_fields["driver"].annotation for member in get_args(DEVICES[str(section)]))
    ours = " or ".join(f"'{name}'" for name in sorted({name for kind in kinds for name in get_args(kind)}))
    text = f"{'is missing: write' if given is None else 'must be'} {ours}, or {OWN} as 'package.module:Class'"
    if given is not None:
        text += f", found {_name_value(given)}{file_hint(given) if isinstance(given, str) else ''}"
    return [*path, "driver"], text


def _unknown(loc: KeyPath, known: set[str]) -> str:
    """Return the reason for an unknown key, which may be a key of another driver."""
    key = str(loc[-1])
    chosen = [getattr(MEMBERS[part], "chosen", "") for part in loc if part in MEMBERS]
    if key in known and any(chosen):
        return f"has no effect with {chosen[0]}; remove it"
    return f"unknown key{nearest(key, known - {key})}"


def _what_to_write(model: type[BaseModel], path: KeyPath) -> str:
    """Return what to write for a missing key, "" if its name is enough."""
    key = str(path[-1])
    field = model.model_fields.get(key)
    if field is None:
        return ""
    if field.description:
        return f": write {field.description}"
    inner = next(_models_in(field.annotation), None)
    required = [name for name, each in inner.model_fields.items() if each.is_required()] if inner else []
    return f": write [{'.'.join(map(str, path))}] with {', '.join(required)}" if required else ""


def _model_of(loc: KeyPath, model: type[BaseModel]) -> type[BaseModel]:
    """Return the model that lacks the last key of a path."""
    for part in loc[:-1]:
        if part in MEMBERS:
            model = MEMBERS[part]
        elif part in model.model_fields:
            model = next(_models_in(model.model_fields[str(part)].annotation), model)
    return model


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in the type of a field, those of unions and lists included."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _keys_of(model: type[BaseModel]) -> set[str]:
    """Return all keys of a file."""
    inner = (_keys_of(each) for field in model.model_fields.values() for each in _models_in(field.annotation))
    return set(model.model_fields).union(*inner)


def refusal(
    name: str, faults: Sequence[KeyFault], source: str | None = None, head: str = ""
) -> FileFaultsError:
    """Return the error for a file with faults. name: of the file. source: its text, None if it has no lines.

    head: first line; by default the number of faults, if there are several.
    """
    lines = []
    for path, why in faults[:MOST_FAULTS]:
        place = name if source is None else place_of(name, source, path)
        lines.append(f"{place}: {'.'.join(map(str, path)) or 'file'}: {why}")
    if len(faults) > MOST_FAULTS:
        lines.append(f"{name}: and {plural(len(faults) - MOST_FAULTS, 'more fault')}")
    if head or len(faults) > 1:
        lines.insert(0, head or f"{name}: {plural(len(faults), 'fault')}")
    return FileFaultsError(lines)


def place_of(name: str, text: str, path: KeyPath) -> str:
    """Return where a key of valid TOML is, as "bench.toml:3", with the column unless it begins the line.

    name: of the file. See `line_of`.
    """
    number = line_of(text, path)
    line = (text.split("\n") or [""])[number - 1]
    key = next((step for step in reversed(path) if isinstance(step, str)), "")
    found = re.search(rf"\b{re.escape(key)}\b", line) if key else None
    before = line[: found.start()] if found else ""
    return f"{name}:{number}" + (f":{len(before) + 1}" if before.strip("[ \t") else "")


def line_of(text: str, path: KeyPath) -> int:
    """Return the 1-based line on which a key, table or element of valid TOML begins.

    A missing key counts as being on the line where its nearest table begins. An empty path is line 1, and so
    are keys beyond `MOST_LINES`.

    The file is parsed repeatedly with one more line until the key exists: this needs no second TOML grammar,
    and bench files are short.
    """
    wanted = _present_part(parse_toml(text, ""), path)
    for begin, document in _parse_growing(text) if wanted else ():
        if _present_part(document, wanted) == wanted:
            rest = enumerate(text.split("\n")[begin:], begin + 1)
            return next(number for number, line in rest if _has_content(line))
    return 1


@lru_cache(maxsize=1)
def _parse_growing(text: str) -> list[tuple[int, Any]]:
    """Return the document up to each line, with the number of lines before its last statement."""
    lines, readable = text.split("\n"), 0
    grown: list[tuple[int, Any]] = []
    for count in range(1, min(len(lines), MOST_LINES) + 1):
        if not _has_content(lines[count - 1]):
            continue
        with suppress(FormatError):  # in the middle of a multi-line value
            grown.append((readable, parse_toml("\n".join(lines[:count]), "")))
            readable = count
    return grown


def _present_part(document: Any, path: KeyPath) -> list[str | int]:
    """Return the longest existing prefix of a path."""
    found: list[str | int] = []
    for step in path:
        if isinstance(document, dict) and step in document:
            document = document[step]
        elif isinstance(document, list) and isinstance(step, int) and step < len(document):
            document = document[step]
        else:
            break
        found.append(step)
    return found


def _has_content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")
