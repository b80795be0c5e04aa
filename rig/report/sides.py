"""The two sides of a comparison: two sessions, or one session with two estimators."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from drivers.errors import InputError, SessionError
from drivers.named_classes import is_class_name
from rig.experiments.lift_plan import TrialSettings, trial_of
from rig.experiments.process_pool import run_tasks
from rig.experiments.replay import replay_lift
from rig.report.session import UNREADABLE, read_usable
from rig.results.notes import lift_note
from rig.sessions.files import RESULTS
from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of
from rig.sessions.reading import read_angles
from rig.sessions.records import LIFTS, Lift, accepted_lifts
from rig.sessions.rows import read_timing, read_usable_lifts
from rig.tactile.angles import FUSED, MARKERS
from rig.tactile.estimators import ESTIMATORS

Progress = Callable[[int, int, Lift], None]
ShowNote = Callable[[int, int, str], None]
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
    for lift in accepted_lifts(rows):
        with suppress(*UNREADABLE):
            lift = read_angles(folder, lift, manifest.signs)
        lifts.append(replace(lift, frame_ms=took.get((lift.number, lift.attempt))))
    if not lifts:
        raise SessionError(f"{folder}: no finished lift to compare; run the trial with --resume first")
    notes = tuple(notice.what for notice in problems)
    estimator = f"{manifest.estimator}, window {manifest.window}"
    return Side(name or folder.name, lifts, manifest.simulated, estimator, notes)


def estimator_sides(folder: Path, first: str, second: str, jobs: int, show: ShowNote) -> tuple[Side, Side]:
    """Return a session's lifts, estimated again with two estimators, so that both are timed alike.

    show: shows a line per lift with the name of its estimator, counted over both. Raises
    `InputError` for an unknown estimator, `SessionError` for a damaged session.
    """
    manifest = read_manifest_of(folder, TrialManifest, ONLY_TRIALS)
    settings = [trial_of(folder, manifest, name).settings for name in (first, second)]
    left, right = (
        _estimator_side(folder, manifest, of, jobs, partial(_show_over_both, show, name, before))
        for name, of, before in zip((first, second), settings, (0, 1), strict=True)
    )
    return replace(left, name=first), replace(right, name=second)


def _show_over_both(show: ShowNote, name: str, before: int, done: int, total: int, lift: Lift) -> None:
    """Show a lift of one of two estimators. before: 1 if the other one has done all its lifts, else 0."""
    show(before * total + done, 2 * total, f"{name}: {lift_note(lift)}")


def _estimator_side(
    folder: Path, manifest: TrialManifest, settings: TrialSettings, jobs: int, progress: Progress
) -> Side:
    stored, wanted = _stored_side(folder, None, manifest), settings.estimator
    found, problems = replay_lifts(folder, settings, jobs, progress)
    if not found:
        raise SessionError(problems[0])
    truths = {(lift.number, lift.attempt): lift.truth for lift in stored.lifts if lift.angles}
    lifts = []
    for row in found:
        truth = truths.get((row.number, row.attempt))
        angles = None if truth is None else {FUSED: row.estimate, MARKERS: truth}
        lifts.append(replace(row, angles=angles))
    amiss = (f"{row.object}/{row.lift}: {row.estimator_faults}" for row in lifts if row.estimator_faults)
    notes = (*stored.notes, *problems, *amiss)
    return Side(wanted.name, lifts, stored.simulated, f"{wanted.name}, window {wanted.window}", notes)


def replay_lifts(
    folder: Path, settings: TrialSettings, jobs: int, progress: Progress
) -> tuple[list[Lift], tuple[str, ...]]:
    """Replay the lifts of a session; return them with their fused angles, and why others are unreadable.

    Raises `SessionError` for a damaged session.
    """
    usable = read_usable_lifts(folder)
    found, problems = dict[int, Lift](), list(usable.problems)
    work = partial(replay_lift, folder, settings, around_gaps=False)
    for _, (again, problem) in run_tasks(work, usable.lifts, jobs):
        if again is None:
            problems.append(problem or "")
            continue
        found[again.number] = again
        progress(len(found), len(usable.lifts), again)
    return [found[number] for number in sorted(found)], tuple(problems)
