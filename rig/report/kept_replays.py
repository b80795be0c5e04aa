"""A cache of the replays of comparisons, outside the sessions.

A replay depends on the recordings, the estimator and the code. Each lift is stored when it is finished, so
that an interrupted comparison can continue. Replays of a lab's own estimator are not stored, because its code
may change. If the cache cannot be written, the comparison continues without it.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from io import BytesIO
from pathlib import Path

import numpy as np

from drivers.errors import InputError, RecordingError
from drivers.formats import write_whole
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.process_pool import run_tasks
from rig.experiments.replay import replay_or_problem
from rig.sessions.codec import json_line
from rig.sessions.files import MANIFEST, append_line, drop_torn_line, state_folder
from rig.sessions.records import FIGURES, LIFTS, Lift, finished
from rig.sessions.rows import read_usable_lifts, readable_rows
from rig.tactile.angles import FUSED, Angles

SOURCES = ("rig/tactile", "rig/lift", "rig/models", "rig/sessions", "calibration", "drivers")
"""Folders and files of the code that a replay's results depend on."""
Progress = Callable[[int, int, Lift], None]
Replayed = tuple[Lift, Angles]
"""A lift's row, and its fused angles."""


def replayed(
    folder: Path, settings: TrialSettings, jobs: int, progress: Progress
) -> tuple[list[Replayed], tuple[str, ...], int]:
    """Replay the lifts of a session.

    Returns them, messages about unreadable ones, and the number found in the cache. Raises `SessionError` for
    a damaged session.
    """
    usable = read_usable_lifts(folder)
    file = None if settings.estimator.foreign else _file(folder, settings)
    kept = {(row.number, row.attempt): row for row in _kept(file)} if file else {}
    found: dict[int, Replayed] = {}
    for row in usable.lifts:
        before = kept.get((row.number, row.attempt))
        angles = None if file is None or before is None else _kept_angles(file, row)
        if before is not None and angles is not None:
            found[row.number] = replace(row, **{name: getattr(before, name) for name in FIGURES}), angles
    count, problems = len(found), list(usable.problems)
    left = [row for row in usable.lifts if row.number not in found]
    for _, again in run_tasks(partial(replay_or_problem, folder, settings), left, jobs):
        if isinstance(again, str):
            problems.append(again)
            continue
        row = again[0]
        found[row.number] = again
        if file is not None:
            _keep(file, *again)
        progress(len(found), len(usable.lifts), row)
    return [found[number] for number in sorted(found)], tuple(problems), count


def _kept(file: Path) -> list[Lift]:
    try:
        rows, _ = readable_rows(file, LIFTS)
    except OSError:
        return []
    return finished(rows)


def _keep(file: Path, row: Lift, angles: Angles) -> None:
    data = BytesIO()
    np.save(data, np.column_stack([angles.time_s, angles.angle_deg, angles.sigma_deg]))
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(_angles_file(file, row), data.getvalue())
        drop_torn_line(file)
        append_line(file, json_line(row))
    except (OSError, RecordingError):
        return  # the comparison does not need the cache


def _angles_file(file: Path, row: Lift) -> Path:
    return file.with_name(f"{file.stem}_{row.number}_{row.attempt}.npy")


def _kept_angles(file: Path, row: Lift) -> Angles | None:
    try:
        time_s, angle_deg, sigma_deg = np.load(_angles_file(file, row), allow_pickle=False).T
        return Angles(time_s, angle_deg, sigma_deg, source=FUSED, zero_ns=row.zero_ns)
    except (OSError, ValueError, EOFError, InputError):
        return None


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
    """Return a hash of the code that a replay's results depend on."""
    root = Path(__file__).parents[2]
    key = hashlib.sha256()
    for source in SOURCES:
        for path in sorted((root / source).rglob("*")):
            if path.suffix in (".py", ".onnx", ".json"):
                key.update(path.read_bytes())
    return key.hexdigest()
