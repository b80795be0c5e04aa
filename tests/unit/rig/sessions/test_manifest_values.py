"""A manifest with any JSON value in any of its fields is read, or rejected with a typed error."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

from rig.results.listing import list_session
from rig.sessions.about import Remarks
from rig.sessions.manifest import (
    AnyManifest,
    BenchManifest,
    RecordManifest,
    ReplayManifest,
    TrialManifest,
    begin_manifest,
    read_manifest,
)

STORED = Path(__file__).parents[3] / "data"
VALUES: tuple[Any, ...] = (
    [], ["trial"], [None], [[[]]], {}, {"trial": {}}, None, True, 7, -1.5, 1e300, 10**18,
    "", "x" * 100_000, "\x1b[31m",
)  # fmt: skip
SOME = ([[[]]], {}, None, 1e300, "x" * 100_000)
"""Values that the plain test run tries: one of each kind."""
LONGEST_PROBLEM = 1000
Place = tuple[str | int, ...]


def whole(manifest: AnyManifest) -> dict[str, Any]:
    """Every field of a manifest's schema, including optional ones."""
    if isinstance(manifest, BenchManifest):
        manifest = replace(manifest, remarks=Remarks("name", "note", ("gel-7",), "operator"))
    return TypeAdapter(type(manifest)).dump_python(manifest, mode="json")


def places(value: Any, place: Place = ()) -> Iterator[Place]:
    """The paths of a JSON value and of all values in it."""
    yield place
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in inner:
        yield from places(each, (*place, key))


def with_value(manifest: Any, place: Place, value: Any) -> Any:
    """A copy of a manifest with another value at one path."""
    if not place:
        return value
    copy = dict(manifest) if isinstance(manifest, dict) else list(manifest)
    copy[place[0]] = with_value(manifest[place[0]], place[1:], value)  # type: ignore[index]
    return copy


def replayed() -> ReplayManifest:
    return ReplayManifest(
        **{**vars(begin_manifest("replay")), "kind": "replay"},
        sessions=("first",),
        estimator="slip",
        window=2,
    )


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "tried"),
    [
        (TrialManifest, SOME),
        *(
            pytest.param(kind, VALUES, marks=pytest.mark.heavy)
            for kind in (TrialManifest, RecordManifest, ReplayManifest)
        ),
    ],
)
def test_session_with_any_value_in_any_field_is_listed(
    tmp_path: Path, kind: type[AnyManifest], tried: tuple[Any, ...]
) -> None:
    manifest = (
        replayed()
        if kind is ReplayManifest
        else read_manifest(STORED / f"stored_{kind.__name__[:-8].lower()}")
    )
    values = whole(manifest)
    file = tmp_path / "session.json"
    file.write_text(json.dumps(values))
    assert read_manifest(tmp_path)
    for place in places(values):
        for value in tried:
            file.write_text(json.dumps(with_value(values, place, value)))
            entry = list_session(tmp_path)
            assert len(entry.problem or "") < LONGEST_PROBLEM, (place, value)
            assert isinstance(entry.object_names, set)
