"""The two sides of a comparison: sessions as stored, or one session seen by two estimators."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import InputError, SessionError
from rig.experiments.replay import run_replay, session_settings
from rig.report.session import read_rows, read_timing, usable_lift
from rig.sessions.layout import MANIFEST
from rig.sessions.session import read_manifest
from rig.tactile.estimators import ESTIMATORS

Progress = Callable[[int, int, dict[str, Any]], None]


@dataclass(frozen=True, slots=True)
class Side:
    """One side: its name, its lifts' rows, and whether they are simulated. notes: what was left out."""

    name: str
    rows: list[dict[str, Any]]
    simulated: bool
    notes: tuple[str, ...] = ()


def session_side(folder: Path, name: str | None = None) -> Side:
    """A session with the results it has. Raises `SessionError`, `InputError`."""
    if not (folder / MANIFEST).exists():
        hint = " (an estimator's name needs --on SESSION)" if str(folder) in ESTIMATORS else ""
        raise InputError(f"{folder}: no session folder{hint}")
    manifest = read_manifest(folder)
    if manifest.get("kind") != "trial":
        raise SessionError(
            f"{folder}: is a '{manifest.get('kind')}' session; only trials have lifts to compare"
        )
    rows, problems = read_rows(folder / "lifts.jsonl", usable_lift)
    took = {
        (t.get("number"), t.get("attempt")): t["stages"].get("total", {}).get("p50_ms")
        for t in read_timing(folder)
    }
    rows = [{**row, "frame_ms": took.get((row["number"], row["attempt"]))} for row in rows if row["accepted"]]
    if not rows:
        raise SessionError(f"{folder}: no finished lift to compare; run the trial with --resume first")
    notes = tuple(notice.what for notice in problems)
    return Side(name or folder.name, rows, bool(manifest.get("simulated")), notes)


def estimator_side(folder: Path, estimator: str, jobs: int, progress: Progress) -> Side:
    """A session's lifts with an estimator: the stored results where it is the session's own.

    Raises `InputError` for an unknown estimator, `SessionError` for a damaged session.
    """
    own = session_settings(folder, None, None)
    stored = session_side(folder, estimator)
    wanted = session_settings(folder, estimator, None).estimator
    if wanted == own.estimator:
        return stored
    replay = run_replay(folder, estimator, None, jobs, progress)
    return Side(estimator, replay.rows, stored.simulated, stored.notes)
