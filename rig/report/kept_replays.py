"""Replays that comparisons have made, kept outside the sessions: the same one again takes no time.

A replay follows from the recordings, the estimator and the code; each line is kept as soon as its lift is
done, so that what was stopped goes on. Nothing is kept where nothing can be written, nor of an estimator that
is not the rig's own, whose code may have changed since.
"""

import hashlib
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.process_pool import run_tasks
from rig.experiments.replay import replay_or_problem
from rig.sessions.codec import json_line
from rig.sessions.files import append_line, drop_torn_line, state_folder
from rig.sessions.layout import MANIFEST
from rig.sessions.records import LIFTS, FinishedLift, LiftFigures
from rig.sessions.rows import read_usable_lifts, readable_rows

SOURCES = ("rig/tactile", "rig/lift", "rig/models", "rig/sessions", "calibration", "drivers")
"""What a replay's numbers depend on, below the folder of the packages."""
Progress = Callable[[int, int, FinishedLift], None]


def replayed(
    folder: Path, settings: TrialSettings, jobs: int, progress: Progress
) -> tuple[list[FinishedLift], tuple[str, ...], int]:
    """Return a session's lifts seen by an estimator, what could not be read, and how many were kept before.

    Raises `SessionError` for a damaged session.
    """
    usable = read_usable_lifts(folder)
    file = None if settings.estimator.foreign else _file(folder, settings)
    kept = {(row.number, row.attempt): _measured(row) for row in _kept(file)} if file else {}
    known = [row for row in usable.lifts if (row.number, row.attempt) in kept]
    rows = {row.number: replace(row, **kept[row.number, row.attempt]) for row in known}
    before, problems = len(rows), list(usable.problems)
    left = [row for row in usable.lifts if row.number not in rows]
    for _, row in run_tasks(partial(replay_or_problem, folder, settings), left, jobs):
        if isinstance(row, str):
            problems.append(row)
            continue
        rows[row.number] = row
        if file is not None:
            _keep(file, row)
        progress(len(rows), len(usable.lifts), row)
    return [rows[number] for number in sorted(rows)], tuple(problems), before


def _measured(row: FinishedLift) -> dict[str, Any]:
    """The part of a row that a replay makes anew."""
    return {field.name: getattr(row, field.name) for field in fields(LiftFigures)}


def _kept(file: Path) -> list[FinishedLift]:
    try:
        rows, _ = readable_rows(file, LIFTS)
    except OSError:
        return []
    return [row for row in rows if isinstance(row, FinishedLift)]


def _keep(file: Path, row: FinishedLift) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        drop_torn_line(file)
        append_line(file, json_line(row))
    except (OSError, RecordingError):
        return  # it is in this comparison all the same


def _file(folder: Path, settings: TrialSettings) -> Path:
    choice = settings.estimator
    asked = f"{choice.name} {choice.window} {choice.skip} {_code()}"
    key = hashlib.sha256((folder / MANIFEST).read_bytes() + asked.encode())
    for path in sorted(folder.glob("lifts/*.mcap")):
        about = path.stat()
        key.update(f"{path.name} {about.st_size} {about.st_mtime_ns}".encode())
    return state_folder() / "replays" / f"{key.hexdigest()[:32]}.jsonl"


@cache
def _code() -> str:
    """A hash of all that a replay's numbers depend on."""
    root = Path(__file__).parents[2]
    key = hashlib.sha256()
    for source in SOURCES:
        for path in sorted((root / source).rglob("*")):
            if path.suffix in (".py", ".onnx", ".json"):
                key.update(path.read_bytes())
    return key.hexdigest()
