"""Which frames of which recordings hold something, and where their background is from."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

from drivers.errors import InputError
from drivers.formats import read_csv_rows, shown

COLUMNS = ("clip", "first", "last", "contact", "background", "background_first", "background_last")
OURS = "marker_slip_contacts.csv"


@dataclass(frozen=True, slots=True)
class FrameSpan:
    """Frames of a recording, numbered from 0, the last one included."""

    clip: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class ContactClip:
    """A recording. background: frames without contact. empty, held: frames without and with one."""

    clip: str
    background: FrameSpan
    empty: tuple[FrameSpan, ...]
    held: tuple[FrameSpan, ...]


def read_spans(table: Path | None = None) -> list[ContactClip]:
    """Read a table of spans, by default that of the public clips. Raises `InputError` naming the line."""
    if table is None:
        with as_file(files("rig.benchmark.contact").joinpath(OURS)) as own:
            return read_spans(own)
    rows = read_csv_rows(table, COLUMNS)
    if not rows:
        raise InputError(f"{table}: line 2 is missing: give a row per span of frames")
    spans: dict[str, list[tuple[bool, FrameSpan]]] = {}
    backgrounds: dict[str, FrameSpan] = {}
    for line, row in rows:
        span = _span(table, line, row, "")
        background = _span(table, line, row, "background_")
        if backgrounds.setdefault(span.clip, background) != background:
            raise InputError(
                f"{table}: line {line}: {shown(span.clip)} has another background above: keep one"
            )
        spans.setdefault(span.clip, []).append((_contact(table, line, row), span))
    return [
        ContactClip(clip, backgrounds[clip], _those(of, contact=False), _those(of, contact=True))
        for clip, of in spans.items()
    ]


def _those(spans: list[tuple[bool, FrameSpan]], contact: bool) -> tuple[FrameSpan, ...]:
    return tuple(span for held, span in spans if held is contact)


def _contact(table: Path, line: int, row: Mapping[str, str]) -> bool:
    text = row["contact"].strip()
    if text not in ("yes", "no"):
        raise InputError(f"{table}: line {line}: contact {shown(text)}: give yes or no")
    return text == "yes"


def _span(table: Path, line: int, row: Mapping[str, str], prefix: str) -> FrameSpan:
    clip = row["background" if prefix else "clip"].strip()
    first, last = (row[prefix + name].strip() for name in ("first", "last"))
    if not (first.isdecimal() and last.isdecimal() and len(last) < 9 and int(first) <= int(last)):
        raise InputError(
            f"{table}: line {line}: frames {shown(first)} to {shown(last)}: give numbers from 0 on, in order"
        )
    return FrameSpan(clip, int(first), int(last))
