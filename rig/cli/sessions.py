"""`rig sessions`: what a folder of sessions holds."""

import os
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.errors import SessionError, counted
from rig.cli.common import JsonOption, emit_json, say
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rig.results.listing import SessionEntry

MB = 1e6
SIDE_BY_SIDE = 200
"""Sessions from which on it pays to look at them in several processes."""
AT_ONCE = 20
MOST_CHECKED = 20
"""Of more sessions the bytes are only read when asked for: a second for each 45 lifts."""


class Sort(StrEnum):
    """What sessions are listed by."""

    FOLDER = "folder"
    DATE = "date"
    NAME = "name"
    MARE = "mare"
    DONE = "done"
    SIZE = "size"


def sessions(
    folder: Annotated[
        Path, typer.Argument(help="Folder that holds sessions, at any depth, or is one.")
    ] = Path("sessions"),
    tags: Annotated[
        list[str] | None, typer.Option("--tag", help="Those with this tag; repeat: with all of them.")
    ] = None,
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", help="Those of this object, id or name; repeat: of any of them."),
    ] = None,
    sort: Annotated[Sort, typer.Option("--sort", help="In this order.")] = Sort.FOLDER,
    reverse: Annotated[bool, typer.Option("--reverse", help="The other way round.")] = False,
    check: Annotated[
        bool | None,
        typer.Option(
            "--check/--quick",
            help="Read every byte and hold it to its checksum: 1 s for 45 lifts. Default: of up to 20 "
            "sessions.",
        ),
    ] = None,
    wear: Annotated[
        Path | None,
        typer.Option(
            "--wear", help="Also write a page of noise, contact and error over time.", callback=file_place
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List sessions: date, kind, objects, lifts, MARE, size; broken ones with what is wrong.

    A recording or image that is missing, or whose bytes are not as they were written, makes a session
    broken. Of more than 20 sessions the bytes are only read with --check, which ends with exit code 2 if a
    session is broken.

    Examples:
      rig sessions

      rig sessions /data/2026 --tag gel-7 --object t1 --sort date --json

      rig sessions --check

      rig sessions --tag gel-7 --wear gel-7.html

    """
    from rig.cli.fitting import table_console

    entries = _in_order(_wanted(_listed(folder, check), tags or [], objects or []), sort, reverse)
    console = table_console(to_stderr=json)
    if entries:
        console.print(_table(folder, entries))
    else:
        console.print(f"{folder}: no {'such ' if tags or objects else ''}session here")
    for entry in entries:
        if entry.problem:
            console.print(f"broken: {entry.problem}", highlight=False, soft_wrap=True)
    page = None if wear is None else _wear_page(entries, wear)
    if json:
        listed = {"folder": str(folder), "sessions": [_as_json(entry) for entry in entries]}
        emit_json({**listed, "wear": page} if page else listed)
    broken = sum(entry.state == "broken" for entry in entries)
    if check and broken:
        raise SessionError(
            f"{folder}: {broken} of {counted(len(entries), 'session')} broken: each is named above"
        )


def _listed(folder: Path, check: bool | None) -> "list[SessionEntry]":
    from rig.experiments.process_pool import run_tasks
    from rig.live.screen import end_phase
    from rig.results.listing import find_sessions, list_sessions

    found = find_sessions(folder)
    if check is None and len(found) > MOST_CHECKED:
        say(f"note: {len(found)} sessions, whose bytes are not read; --check holds them to their checksums")
    quick = len(found) > MOST_CHECKED if check is None else not check
    jobs = (os.cpu_count() or 1) if len(found) >= SIDE_BY_SIDE else 1
    portions = [found[i : i + AT_ONCE] for i in range(0, len(found), AT_ONCE)]
    end_phase(wait=True)  # workers are forks, and a fork must not copy a running thread
    listed = run_tasks(partial(list_sessions, quick=quick), portions, jobs, fork=True)
    return sorted((entry for _, entries in listed for entry in entries), key=lambda entry: entry.folder)


def _wanted(entries: "list[SessionEntry]", tags: list[str], objects: list[str]) -> "list[SessionEntry]":
    """Those that have all the tags, and one of the objects; broken ones of which neither is known are not."""
    names = {name.lower() for name in objects}
    return [
        entry
        for entry in entries
        if set(tags) <= set(entry.remarks.tags) and (not names or names & entry.object_names)
    ]


def _in_order(entries: "list[SessionEntry]", sort: Sort, reverse: bool) -> "list[SessionEntry]":
    """In the order asked for; what has no such value stands at the end."""
    keys = {
        Sort.FOLDER: lambda entry: str(entry.folder),
        Sort.DATE: lambda entry: entry.started or None,
        Sort.NAME: lambda entry: entry.remarks.name.lower() or None,
        Sort.MARE: lambda entry: entry.mare.mean_deg if entry.mare else None,
        Sort.DONE: lambda entry: entry.done,
        Sort.SIZE: lambda entry: entry.size_bytes,
    }
    known = [entry for entry in entries if keys[sort](entry) is not None]
    without = [entry for entry in entries if keys[sort](entry) is None]
    return sorted(known, key=keys[sort], reverse=reverse) + without


def _wear_page(entries: "list[SessionEntry]", page: Path) -> str:
    from rig.report.wear_page import write_wear

    written = write_wear([entry.folder for entry in entries], page)
    for problem in written.problems:
        say(f"note: {problem}")
    say(f"wear: {written.path}")
    return str(written.path)


def _table(folder: Path, entries: "list[SessionEntry]") -> Any:
    from rich.table import Table

    from rig.results.metrics import mare_text

    table = Table(title=f"sessions in {folder}; MARE over phases B and C, degrees")
    said = {
        "name": lambda entry: entry.remarks.name,
        "tags": lambda entry: ", ".join(entry.remarks.tags),
        "operator": lambda entry: entry.remarks.operator,
    }
    extra = {what: of for what, of in said.items() if any(of(entry) for entry in entries)}
    for heading in (
        "session",
        *extra,
        "date (UTC)",
        "kind",
        "bench",
        "objects",
        "done",
        "MARE",
        "MB",
        "state",
    ):
        table.add_column(heading, justify="right" if heading in ("done", "MB") else "left")
    for entry in entries:
        cells = (
            entry.folder.name,
            *(of(entry) for of in extra.values()),
            entry.started[:16].replace("T", " "),
            entry.manifest.kind if entry.manifest else "",
            _bench(entry),
            _shortened(entry.objects),
            f"{entry.done}/{entry.wanted}" if entry.wanted else str(entry.done),
            mare_text(entry.mare) if entry.mare else "",
            f"{entry.size_bytes / MB:.1f}",
            entry.state.value,
        )
        table.add_row(*cells)
    return table


def _bench(entry: "SessionEntry") -> str:
    on = entry.bench_manifest
    return "" if on is None else "SIMULATED" if on.simulated else on.bench


def _shortened(objects: tuple[str, ...]) -> str:
    return (
        ", ".join(objects) if len(objects) <= 3 else f"{', '.join(objects[:2])} and {len(objects) - 2} more"
    )


def _as_json(entry: "SessionEntry") -> dict[str, object]:
    manifest, on = entry.manifest, entry.bench_manifest
    return {
        "session": str(entry.folder),
        "date": manifest.started if manifest else None,
        "kind": manifest.kind if manifest else None,
        "bench": on.bench if on else None,
        "simulated": on.simulated if on else None,
        "estimator": getattr(manifest, "estimator", None),
        "objects": entry.objects,
        "name": entry.remarks.name,
        "note": entry.remarks.note,
        "tags": entry.remarks.tags,
        "operator": entry.remarks.operator,
        "done": entry.done,
        "wanted": entry.wanted,
        "mare_deg": entry.mare and entry.mare.mean_deg,
        "mare_interval_deg": entry.mare and entry.mare.ends_deg,
        "lifts_refused": entry.mare and entry.mare.refused,
        "size_bytes": entry.size_bytes,
        "state": entry.state.value,
        "problem": entry.problem,
    }
