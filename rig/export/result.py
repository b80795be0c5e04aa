"""What an export is told, and what it says it did."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import SessionError
from rig.sessions.files import read_lines
from rig.sessions.layout import RESULTS
from rig.sessions.session import read_manifest


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """A session and where its export goes: a folder that exists and is empty.

    every: of a trial's frames, each so-many-th becomes a labelled image.
    """

    session: Path
    out: Path
    manifest: Mapping[str, Any]
    rows: tuple[dict[str, Any], ...]
    every: int = 10

    @property
    def kind(self) -> str:
        """Return "trial" or "record"."""
        return str(self.manifest["kind"])

    @property
    def accepted(self) -> list[dict[str, Any]]:
        """Rows of the lifts or poses that count."""
        return [row for row in self.rows if row["accepted"]]


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: how many of what, and what a user of it should know."""

    counts: dict[str, int]
    notes: tuple[str, ...] = ()


Exporter = Callable[[ExportRequest], Exported]


def export_request(session: Path, out: Path, every: int) -> ExportRequest:
    """Read what an export starts from. Raises `SessionError` for what is no trial or recording."""
    manifest = read_manifest(session)
    kind = manifest.get("kind")
    if kind not in ("trial", "record"):
        raise SessionError(f"{session}: is a '{kind}' session; trials and recordings can be exported")
    rows = tuple(read_lines(session / RESULTS[kind]))
    if not any(row["accepted"] for row in rows):
        raise SessionError(f"{session}: nothing is finished yet; continue it with --resume first")
    return ExportRequest(session, out, manifest, rows, every)


def simulated_mark(manifest: Mapping[str, Any]) -> str:
    """Return "SIMULATED " for a simulated session, else nothing."""
    return "SIMULATED " if manifest.get("simulated") else ""
