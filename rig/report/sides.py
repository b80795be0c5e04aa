"""The two sides of a comparison: two sessions, or one session with two estimators.

Replays are cached outside the sessions. A replay depends on the recordings, the estimator and the code. Each
lift is stored when it is finished, so that an interrupted comparison can continue. Replays of a lab's own
estimator are not stored, because its code may change. If the cache cannot be written, the comparison
continues without it.
"""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from io import BytesIO
from pathlib import Path

import numpy as np

from drivers.errors import InputError, RecordingError, SessionError, counted
from drivers.formats import write_whole
from drivers.named_classes import is_class_name
from rig.experiments.lift_plan import TrialSettings, trial_of
from rig.experiments.process_pool import run_tasks
from rig.experiments.replay import replay_lift
from rig.report.session import UNREADABLE, read_usable
from rig.sessions.codec import json_line
from rig.sessions.files import MANIFEST, RESULTS, append_line, drop_torn_line, state_folder
from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of
from rig.sessions.reading import read_angles
from rig.sessions.records import FIGURES, LIFTS, Lift, finished
from rig.sessions.rows import read_timing, read_usable_lifts, readable_rows
from rig.tactile.angles import FUSED, MARKERS, Angles
from rig.tactile.estimators import ESTIMATORS

Progress = Callable[[int, int, Lift], None]
ONLY_TRIALS = "only trials have lifts to compare"


@dataclass(frozen=True, slots=True)
class Side:
    """One side: its name, its lifts, and whether they are simulated. notes: omitted lifts, with the reason.

    estimator: name and window of the estimator.
    """

    name: str
    lifts: list[Lift]
    simulated: bool
    estimator: str
    notes: tuple[str, ...] = ()


def session_side(folder: Path, name: str | None = None) -> Side:
    """Return a session with its stored results as a side. Raises `SessionError`, `InputError`."""
    if not is_session(folder):
        named = str(folder) in ESTIMATORS or is_class_name(str(folder))
        hint = " (an estimator's name needs --on SESSION)" if named else ""
        raise InputError(f"{folder}: no session folder{hint}")
    return _stored_side(folder, name, read_manifest_of(folder, TrialManifest, ONLY_TRIALS))


def _stored_side(folder: Path, name: str | None, manifest: TrialManifest) -> Side:
    rows, problems = read_usable(folder / RESULTS["trial"], LIFTS)
    timed = [timing for timing in read_timing(folder) if "total" in timing.stages]
    took = {(timing.number, timing.attempt): timing.stages["total"].p50_ms for timing in timed}
    lifts = []
    for lift in finished(rows):
        with suppress(*UNREADABLE):
            lift = read_angles(folder, lift, manifest.signs)
        lifts.append(replace(lift, frame_ms=took.get((lift.number, lift.attempt))))
    if not lifts:
        raise SessionError(f"{folder}: no finished lift to compare; run the trial with --resume first")
    notes = tuple(notice.what for notice in problems)
    estimator = f"{manifest.estimator}, window {manifest.window}"
    return Side(name or folder.name, lifts, manifest.simulated, estimator, notes)


def estimator_side(folder: Path, estimator: str, jobs: int, progress: Progress) -> Side:
    """Return a session's lifts with an estimator; the stored results if the session used this estimator.

    Raises `InputError` for an unknown estimator, `SessionError` for a damaged session.
    """
    manifest = read_manifest_of(folder, TrialManifest, ONLY_TRIALS)
    trial, stored = trial_of(folder, manifest, estimator), _stored_side(folder, estimator, manifest)
    if trial.own_estimator:
        return stored
    wanted = trial.settings.estimator
    found, problems, before = replayed(folder, trial.settings, jobs, progress)
    if not found:
        raise SessionError(problems[0])
    kept = (f"{counted(before, 'lift')} replayed with {estimator} before",) if before else ()
    truths = {(lift.number, lift.attempt): lift.truth for lift in stored.lifts if lift.angles}
    lifts = []
    for row in found:
        truth = truths.get((row.number, row.attempt))
        angles = None if truth is None else {FUSED: row.estimate, MARKERS: truth}
        lifts.append(replace(row, angles=angles))
    amiss = (f"{row.object}/{row.lift}: {row.estimator_faults}" for row in lifts if row.estimator_faults)
    notes = (*stored.notes, *problems, *kept, *amiss)
    return Side(estimator, lifts, stored.simulated, f"{wanted.name}, window {wanted.window}", notes)


SOURCES = ("rig/tactile", "rig/lift", "rig/models", "rig/sessions", "calibration", "drivers")
"""Folders and files of the code that a replay's results depend on."""


def replayed(
    folder: Path, settings: TrialSettings, jobs: int, progress: Progress
) -> tuple[list[Lift], tuple[str, ...], int]:
    """Replay the lifts of a session.

    Returns them with their fused angles, messages about unreadable ones, and the number found in the cache.
    Raises `SessionError` for a damaged session.
    """
    usable = read_usable_lifts(folder)
    file = None if settings.estimator.foreign else _file(folder, settings)
    kept = _kept(file) if file else {}
    found: dict[int, Lift] = {}
    for row in usable.lifts:
        before = kept.get((row.number, row.attempt))
        if file and before and (angles := _kept_angles(file, row)) is not None:
            figures = {name: getattr(before, name) for name in FIGURES}
            found[row.number] = replace(row, **figures, angles={FUSED: angles})
    count, problems = len(found), list(usable.problems)
    left = [row for row in usable.lifts if row.number not in found]
    work = partial(replay_lift, folder, settings, around_gaps=False)
    for _, (again, problem) in run_tasks(work, left, jobs):
        if again is None:
            problems.append(problem or "")
            continue
        found[again.number] = again
        if file is not None:
            _keep(file, again)
        progress(len(found), len(usable.lifts), again)
    return [found[number] for number in sorted(found)], tuple(problems), count


def _keep(file: Path, row: Lift) -> None:
    data, angles = BytesIO(), row.estimate
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


def _kept(file: Path) -> dict[tuple[int, int], Lift]:
    """Return the replayed lifts in the cache by number and attempt."""
    try:
        return {(row.number, row.attempt): row for row in finished(readable_rows(file, LIFTS)[0])}
    except OSError:
        return {}


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
