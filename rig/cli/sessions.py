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
    json: JsonOption = False,
) -> None:
    """List sessions: date, kind, objects, lifts, MARE, size; broken ones with what is wrong.

    Examples:
      rig sessions

      rig sessions /data/2026 --json

    """
    from rig.cli.printing import table_console
    from rig.results.listing import find_sessions, list_session

    entries = [list_session(path) for path in find_sessions(folder)]
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
    from rich.table import Table

    from rig.cli.printing import mare_text

    table = Table(title=f"sessions in {folder}; MARE over phases B and C, degrees")
    for heading in ("date (UTC)", "session", "kind", "bench", "objects", "done", "MARE", "MB", "state"):
        table.add_column(heading, justify="right" if heading in ("done", "MB") else "left")
    for entry in entries:
        table.add_row(
            str(entry.manifest.get("started", ""))[:16].replace("T", " "),
            entry.folder.name,
            entry.kind,
            _bench(entry),
            _shortened(entry.objects),
            f"{entry.done}/{entry.wanted}" if entry.wanted else str(entry.done),
            mare_text(entry.mare) if entry.mare else "",
            f"{entry.size_bytes / MB:.1f}",
            entry.state.value,
        )
    return table


def _bench(entry: "SessionEntry") -> str:
    return "SIMULATED" if entry.manifest.get("simulated") else str(entry.manifest.get("bench", ""))


def _shortened(objects: list[str]) -> str:
    return (
        ", ".join(objects) if len(objects) <= 3 else f"{', '.join(objects[:2])} and {len(objects) - 2} more"
    )


def _as_json(entry: "SessionEntry") -> dict[str, Any]:
    manifest = entry.manifest
    return {
        "session": str(entry.folder),
        "date": manifest.get("started"),
        "kind": entry.kind or None,
        "bench": manifest.get("bench"),
        "simulated": manifest.get("simulated"),
        "estimator": manifest.get("estimator"),
        "objects": entry.objects,
        "done": entry.done,
        "wanted": entry.wanted,
        "mare_deg": entry.mare.mean_deg if entry.mare else None,
        "size_bytes": entry.size_bytes,
        "state": entry.state.value,
        "problem": entry.problem,
    }
