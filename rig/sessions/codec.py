"""Convert records to JSON and back, with type checks.

A record is a frozen dataclass; its keys on disk are its fields. Reading is as strict as writing: an unknown
key, a missing key or a value of another type is an error that names the key.
"""

import json
from collections.abc import Mapping
from dataclasses import Field, fields, is_dataclass
from functools import cache, cached_property
from typing import Any, Generic, TypeVar, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from drivers.errors import FormatError, nearest
from drivers.formats import check_numbers, key_place
from rig.config.messages import fault_of, path_of

Record = TypeVar("Record")
MEMBERS = ("trial", "record", "replay")
"""Tags of union members: parts of an error's location that are not keys."""
_REASONS = {
    "missing": "is missing",
    "unexpected_keyword_argument": "is a key that this version does not know",
    "extra_forbidden": "is a key that this version does not know",
}
_UNKNOWN = ("unexpected_keyword_argument", "extra_forbidden")
"""Types of errors for a key that the record does not have."""


def strict(kind: type[Record]) -> type[Record]:
    """Class decorator of records: when one is read, reject unknown keys, NaN, and true in place of 1."""
    kind.__pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)  # type: ignore[attr-defined]
    return kind


class Codec(Generic[Record]):
    """Reads one kind of record. kind: a dataclass, or an annotated union of dataclasses."""

    def __init__(self, kind: Any) -> None:
        self._kind = kind

    def parse(self, text: bytes) -> Record:
        """Return the record of a JSON text. Raises `ValueError` naming the invalid key."""
        try:
            check_numbers(text, "it")
            return self._adapter.validate_json(text)
        except ValidationError as error:
            raise ValueError(_problem(error, text, _keys_of(self._kind))) from error
        except FormatError as error:
            raise ValueError(str(error).removeprefix("it: ")) from error

    def parse_values(self, values: dict[str, object]) -> Record:
        """Return the record of values from a table. Raises `ValueError` as `parse` does."""
        return self.parse(json.dumps(values, default=str).encode())

    @cached_property
    def _adapter(self) -> TypeAdapter[Record]:
        # created only when needed, because that takes longer than most commands take to start
        return TypeAdapter(self._kind)


def json_line(record: Any) -> bytes:
    """Return a record, or a row of a table, as a line of JSON, keys sorted."""
    return (json.dumps(json_value(record), sort_keys=True) + "\n").encode()


def json_value(record: Any) -> dict[str, Any]:
    """Return a record as JSON values, without fields that equal their default.

    A field with a function `stored` in its metadata is left out if `stored(record)` is False.
    """
    if isinstance(record, Mapping):
        return {key: value for key, value in record.items() if value is not None}
    values = _adapter_of(type(record)).dump_python(record, mode="json")
    return {field.name: values[field.name] for field in fields(record) if _is_stored(record, field)}


def _is_stored(record: Any, field: Field[Any]) -> bool:
    stored = field.metadata.get("stored")
    return stored(record) if stored else getattr(record, field.name) != field.default


@cache
def _adapter_of(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _problem(error: ValidationError, text: bytes, known: set[str]) -> str:
    """Return one line that names the first unknown key, else the first invalid one, and the reason.

    known: keys of the record; missing ones are added, also those of inner records.
    """
    every = error.errors(include_url=False)
    first, *more = sorted(every, key=lambda of: of["type"] not in _UNKNOWN)
    path, why = path_of(first), _REASONS.get(first["type"])
    if why is None:
        path, why = fault_of(first)
    elif first["type"] in _UNKNOWN:
        key = str(first["loc"][-1])
        missing = {str(of["loc"][-1]) for of in every if of["type"] == "missing"}
        where = key_place(text.decode(errors="replace"), key)
        why += nearest(key, known | missing) + (f", {where}" if where else "")
    place = ".".join(str(part) for part in path if part not in MEMBERS)
    others = f" (and {len(more)} more)" if more else ""
    return f"'{place}' {why}{others}" if place else f"{why}{others}"


def _keys_of(kind: Any) -> set[str]:
    """Return the keys of a record, or of all members of an annotated union of records."""
    if is_dataclass(kind):
        return {field.name for field in fields(kind)}
    return {key for member in get_args(kind) for key in _keys_of(member)}
