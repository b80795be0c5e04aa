"""`rig sessions`: list the sessions in a folder."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from drivers.errors import SessionError, plural
from drivers.progress import steps
from rig.cli.common import emit_json, say
from rig.cli.options import JsonOption
from rig.declared import argument, file_place, option
from rig.terminal.screen import begin_phase, end_phase

if TYPE_CHECKING:
    from rig.results.listing import SessionEntry

MB = 1e6
SIDE_BY_SIDE = 200
"""Smallest number of sessions that several processes read; below it the start of processes costs more."""
AT_ONCE = 20
"""Sessions per task of a process."""
MOST_CHECKED = 20
"""Largest number of sessions whose checksums are checked by default; it takes a second per 45 lifts."""


Sort = Literal["folder", "date", "name", "mare", "done", "size"]
"""The columns that sessions can be sorted by."""


@dataclass(frozen=True, slots=True)
class ListOptions:
    folder: Path = argument(Path("sessions"), "Session folder, or folder with sessions at any depth.")
    tags: list[str] | None = option(
        None, "Only sessions with this tag; if repeated, with all of these tags.", "--tag"
    )
    objects: list[str] | None = option(
        None, "Only sessions of this object (id or name); if repeated, of any of these.", "--object"
    )
    sort: Sort = option("folder", "Column to sort by.")
    reverse: bool = option(False, "Sort in descending order.")
    check: bool | None = option(
        None,
        "Read all files and compare their checksums (1 s for 45 lifts). Default: for up to 20 sessions.",
        "--check/--quick",
    )
    page: Path | None = option(
        None, "Also write a page of them: search, filters, MARE over time, links to reports.",
        callback=file_place,
    )  # fmt: skip
    json: JsonOption = False


def sessions(options: ListOptions) -> None:
    """List sessions with date, objects, estimator, MARE, limits, contact area and size; report broken ones.

    A session is broken if a recording or image is missing, or if its checksum differs. With more than 20
    sessions, checksums are compared only with --check. With --check the exit code is 2 if a session is
    broken.

    Examples:
      rig sessions
      rig sessions /data/2026 --tag gel-7 --object t1 --sort date --json
      rig sessions --check
      rig sessions /data/2026 --page sessions.html
    """
    from rig.sessions.files import RECORDINGS
    from rig.terminal.tables import console_table, table_console

    entries, folder = _select(options), options.folder
    console, columns = table_console(to_stderr=options.json), _columns(entries)
    if entries:
        left = [i for i, name in enumerate(columns) if name not in ("done", "refused", "MB")]
        about = "MARE over phases B and C, degrees; contact: median area by fingertip, px"
        rows = list(zip(*columns.values(), strict=True))
        console.print(console_table(list(columns), rows, left, f"sessions in {folder}; {about}"))
        size_mb = sum(entry.size_bytes for entry in entries) / MB
        console.print(
            f"{plural(len(entries), 'session')}, {size_mb:,.0f} MB. To free the disk, delete the folder "
            f"{RECORDINGS} of a complete session: its results and report stay, but rig replay needs it."
        )
    else:
        such = "such " if options.tags or options.objects else ""
        console.print(f"{folder}: no {such}session here")
    for entry in entries:
        if entry.problem:
            console.print(f"broken: {entry.problem}", highlight=False, soft_wrap=True)
    if options.page:
        begin_phase("writing the page")
        from rig.report.sessions_page import write_sessions

        write_sessions(options.page, folder, entries, columns)
        say(f"page: {options.page}")
    if options.json:
        listed = {"folder": str(folder), "sessions": [entry.as_json() for entry in entries]}
        emit_json({**listed, **({"page": str(options.page)} if options.page else {})})
    broken = sum(entry.state == "broken" for entry in entries)
    if options.check and broken:
        raise SessionError(
            f"{folder}: {broken} of {plural(len(entries), 'session')} broken; see the messages above"
        )


def _select(options: ListOptions) -> "list[SessionEntry]":
    """Return the sessions with all of the tags and at least one of the objects, sorted.

    Sessions without a value in the sort column come last.
    """
    tags, names = set(options.tags or ()), {name.lower() for name in options.objects or ()}
    entries = [
        entry
        for entry in _list(options.folder, options.check)
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


def _list(folder: Path, check: bool | None) -> "list[SessionEntry]":
    from rig.experiments.process_pool import run_tasks
    from rig.results.listing import find_sessions, list_sessions

    found = find_sessions(folder)
    if check is None and len(found) > MOST_CHECKED:
        say(f"note: the checksums of {len(found)} sessions are not compared; --check compares them")
    quick = len(found) > MOST_CHECKED if check is None else not check
    jobs = (os.cpu_count() or 1) if len(found) >= SIDE_BY_SIDE else 1
    portions = [found[i : i + AT_ONCE] for i in range(0, len(found), AT_ONCE)]
    end_phase(wait=True)
    begin_phase("reading the sessions", ticking=False)  # workers are forks, which must not copy a thread
    count = len(portions)
    listed = steps(run_tasks(partial(list_sessions, quick=quick), portions, jobs, fork=True), count)
    return sorted((entry for _, entries in listed for entry in entries), key=lambda entry: entry.folder)


_IF_ANY = ("name", "tags", "operator", "estimator", "reaction", "refused", "limits", "contact")
"""Columns that are left out if no session has a value."""


def _columns(entries: "list[SessionEntry]") -> dict[str, list[str]]:
    """Return the texts of the listing by heading; without those of `_IF_ANY` that are empty."""
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
        "estimator": lambda entry: entry.estimator_text,
        "reaction": lambda entry: entry.react,
        "done": lambda entry: f"{entry.done}/{entry.wanted}" if entry.wanted else str(entry.done),
        "MARE": lambda entry: mare_text(entry.mare) if entry.mare else "",
        "refused": lambda entry: str(entry.mare.refused) if entry.mare and entry.mare.refused else "",
        "limits": lambda entry: entry.limits_text,
        "contact": lambda entry: ", ".join(f"{area_px:.0f}" for area_px in entry.contact_area_px.values()),
        "MB": lambda entry: f"{entry.size_bytes / MB:.1f}",
        "state": lambda entry: entry.state.value,
    }
    found = {name: [text(entry) for entry in entries] for name, text in columns.items()}
    return {name: texts for name, texts in found.items() if any(texts) or name not in _IF_ANY}
