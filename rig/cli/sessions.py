"""`rig sessions`: what a folder of sessions holds."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drivers.errors import SessionError, counted
from rig.cli.common import emit_json, say
from rig.cli.declared import argument, option
from rig.cli.options import JsonOption
from rig.cli.places import file_place

if TYPE_CHECKING:
    from rich.table import Table

    from rig.results.listing import SessionEntry

MB = 1e6
SIDE_BY_SIDE = 200
"""Sessions from which on it pays to look at them in several processes."""
AT_ONCE = 20
MOST_CHECKED = 20
"""Of more sessions the bytes are only read when asked for: a second for each 45 lifts."""


Sort = Literal["folder", "date", "name", "mare", "done", "size"]
"""The values that sessions are sorted by."""


@dataclass(frozen=True, slots=True)
class ListOptions:
    """The sessions that are listed, and in which order."""

    folder: Path = argument(Path("sessions"), "Folder that holds sessions, at any depth, or is one.")
    tags: list[str] | None = option(None, "Those with this tag; repeat: with all of them.", "--tag")
    objects: list[str] | None = option(
        None, "Those of this object, id or name; repeat: of any of them.", "--object"
    )
    sort: Sort = option("folder", "In this order.")
    reverse: bool = option(False, "The other way round.")
    check: bool | None = option(
        None,
        "Read every byte and hold it to its checksum: 1 s for 45 lifts. Default: of up to 20 sessions.",
        "--check/--quick",
    )
    wear: Path | None = option(
        None, "Also write a page of noise, contact and error over time.", callback=file_place
    )
    page: Path | None = option(
        None, "Also write a page of them: search, filters, MARE over time, links to reports.",
        callback=file_place,
    )  # fmt: skip
    json: JsonOption = False


def sessions(options: ListOptions) -> None:
    """List sessions: date, kind, objects, lifts, MARE, size; broken ones with what is wrong.

    A recording or image that is missing, or whose bytes are not as they were written, makes a session
    broken. Of more than 20 sessions the bytes are only read with --check, which ends with exit code 2 if a
    session is broken.

    Examples:
      rig sessions

      rig sessions /data/2026 --tag gel-7 --object t1 --sort date --json

      rig sessions --check

      rig sessions --tag gel-7 --wear gel-7.html

      rig sessions /data/2026 --page sessions.html

    """
    from rig.live.tables import table_console

    entries, folder = _selected(options), options.folder
    console = table_console(to_stderr=options.json)
    if entries:
        console.print(_table(folder, entries))
    else:
        console.print(f"{folder}: no {'such ' if options.tags or options.objects else ''}session here")
    for entry in entries:
        if entry.problem:
            console.print(f"broken: {entry.problem}", highlight=False, soft_wrap=True)
    page = None if options.wear is None else _wear_page(entries, options.wear)
    if options.page is not None:
        from rig.report.sessions_page import write_sessions

        write_sessions(options.page, folder, entries, _columns(entries))
        say(f"page: {options.page}")
    if options.json:
        listed = {"folder": str(folder), "sessions": [entry.as_json() for entry in entries]}
        pages = {"wear": page, "page": options.page and str(options.page)}
        emit_json({**listed, **{name: path for name, path in pages.items() if path}})
    broken = sum(entry.state == "broken" for entry in entries)
    if options.check and broken:
        raise SessionError(
            f"{folder}: {broken} of {counted(len(entries), 'session')} broken: each is named above"
        )


def _selected(options: ListOptions) -> "list[SessionEntry]":
    """Return the sessions with all of the tags and one of the objects, sorted.

    Those without the value that they are sorted by come last.
    """
    tags, names = set(options.tags or ()), {name.lower() for name in options.objects or ()}
    entries = [
        entry
        for entry in _listed(options.folder, options.check)
        if tags <= set(entry.remarks.tags) and (not names or names & entry.object_names)
    ]
    keys: dict[Sort, Callable[[SessionEntry], Any]] = {
        "folder": lambda entry: str(entry.folder),
        "date": lambda entry: entry.started or None,
        "name": lambda entry: entry.remarks.name.lower() or None,
        "mare": lambda entry: entry.mare.mean_deg if entry.mare else None,
        "done": lambda entry: entry.done,
        "size": lambda entry: entry.size_bytes,
    }
    key = keys[options.sort]
    known = [entry for entry in entries if key(entry) is not None]
    without = [entry for entry in entries if key(entry) is None]
    return sorted(known, key=key, reverse=options.reverse) + without


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


def _wear_page(entries: "list[SessionEntry]", page: Path) -> str:
    from rig.report.wear_page import write_wear

    written = write_wear([entry.folder for entry in entries], page)
    for problem in written.problems:
        say(f"note: {problem}")
    say(f"wear: {written.path}")
    return str(written.path)


def _columns(entries: "list[SessionEntry]") -> dict[str, list[str]]:
    """Return the texts of the listing by heading; without remarks that no session has."""
    from rig.results.metrics import mare_text

    columns: dict[str, Callable[[SessionEntry], str]] = {
        "session": lambda entry: entry.folder.name,
        "name": lambda entry: entry.remarks.name,
        "tags": lambda entry: ", ".join(entry.remarks.tags),
        "operator": lambda entry: entry.remarks.operator,
        "date (UTC)": lambda entry: entry.started[:16].replace("T", " "),
        "kind": lambda entry: entry.manifest.kind if entry.manifest else "",
        "bench": lambda entry: entry.bench_text,
        "objects": lambda entry: entry.objects_text,
        "done": lambda entry: f"{entry.done}/{entry.wanted}" if entry.wanted else str(entry.done),
        "MARE": lambda entry: mare_text(entry.mare) if entry.mare else "",
        "MB": lambda entry: f"{entry.size_bytes / MB:.1f}",
        "state": lambda entry: entry.state.value,
    }
    found = {name: [text(entry) for entry in entries] for name, text in columns.items()}
    return {n: texts for n, texts in found.items() if any(texts) or n not in ("name", "tags", "operator")}


def _table(folder: Path, entries: "list[SessionEntry]") -> "Table":
    from rig.live.tables import console_table

    columns = _columns(entries)
    left = [i for i, name in enumerate(columns) if name not in ("done", "MB")]
    title = f"sessions in {folder}; MARE over phases B and C, degrees"
    return console_table(list(columns), list(map(list, zip(*columns.values(), strict=True))), left, title)
