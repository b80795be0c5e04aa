"""`rig sessions`: what a folder of sessions holds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rig.cli.common import JsonOption, emit_json

if TYPE_CHECKING:
    from rig.results.listing import SessionEntry

MB = 1e6


def sessions(
    folder: Annotated[
        Path, typer.Argument(help="Folder that holds sessions, at any depth, or is one.")
    ] = Path("sessions"),
    quick: Annotated[
        bool, typer.Option("--quick", help="See that recordings are there; leave their checksums out.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """List sessions: date, kind, objects, lifts, MARE, size; broken ones with what is wrong.

    Every byte of the recordings is read and held to their checksums: a second or two for 45 lifts.

    Examples:
      rig sessions

      rig sessions /data/2026 --json

    """
    from rig.cli.fitting import table_console
    from rig.results.listing import find_sessions, list_session

    entries = [list_session(path, quick) for path in find_sessions(folder)]
    console = table_console(to_stderr=json)
    if entries:
        console.print(_table(folder, entries))
    else:
        console.print(f"{folder}: no session here")
    for entry in entries:
        if entry.problem:
            console.print(f"broken: {entry.problem}", highlight=False, soft_wrap=True, markup=False)
    if json:
        emit_json({"folder": str(folder), "sessions": [_as_json(entry) for entry in entries]})


def _table(folder: Path, entries: "list[SessionEntry]") -> Any:
    from rich.markup import escape
    from rich.table import Table

    from rig.cli.printing import mare_text

    table = Table(title=escape(f"sessions in {folder}; MARE over phases B and C, degrees"))
    for heading in ("session", "date (UTC)", "kind", "bench", "objects", "done", "MARE", "MB", "state"):
        table.add_column(heading, justify="right" if heading in ("done", "MB") else "left")
    for entry in entries:
        table.add_row(
            escape(entry.folder.name),
            _started(entry)[:16].replace("T", " "),
            entry.manifest.kind if entry.manifest else "",
            _bench(entry),
            _shortened(entry.objects),
            f"{entry.done}/{entry.wanted}" if entry.wanted else str(entry.done),
            mare_text(entry.mare) if entry.mare else "",
            f"{entry.size_bytes / MB:.1f}",
            entry.state.value,
        )
    return table


def _bench(entry: "SessionEntry") -> str:
    on = entry.bench_manifest
    return "" if on is None else "SIMULATED" if on.simulated else on.bench


def _started(entry: "SessionEntry") -> str:
    return entry.manifest.started if entry.manifest else ""


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
        "done": entry.done,
        "wanted": entry.wanted,
        "mare_deg": entry.mare.mean_deg if entry.mare else None,
        "size_bytes": entry.size_bytes,
        "state": entry.state.value,
        "problem": entry.problem,
    }
