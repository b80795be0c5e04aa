"""The two sides of a comparison: two sessions, or one session with two estimators."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.errors import InputError, SessionError, counted
from drivers.named_classes import is_class_name
from rig.experiments.lift_plan import trial_of
from rig.report.kept_replays import replayed
from rig.report.session import UNREADABLE, read_timing, read_usable
from rig.sessions.files import RESULTS
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.manifest import TrialManifest, is_session, read_manifest_of
from rig.sessions.reading import read_curves
from rig.sessions.records import LIFTS, Lift, finished
from rig.tactile.angles import Angles
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
        hint = (
            " (an estimator's name needs --on SESSION)"
            if str(folder) in ESTIMATORS or is_class_name(str(folder))
            else ""
        )
        raise InputError(f"{folder}: no session folder{hint}")
    return _stored_side(folder, name, read_manifest_of(folder, TrialManifest, ONLY_TRIALS))


def _stored_side(folder: Path, name: str | None, manifest: TrialManifest) -> Side:
    rows, problems = read_usable(folder / RESULTS["trial"], LIFTS)
    timed = [timing for timing in read_timing(folder) if "total" in timing.stages]
    took = {(timing.number, timing.attempt): timing.stages["total"].p50_ms for timing in timed}
    lifts = [
        replace(_with_curves(folder, lift, manifest), frame_ms=took.get((lift.number, lift.attempt)))
        for lift in finished(rows)
    ]
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
    rows = [row for row, _ in found]
    if not rows:
        raise SessionError(problems[0])
    kept = (f"{counted(before, 'lift')} replayed with {estimator} before",) if before else ()
    amiss = (f"{row.object}/{row.lift}: {row.estimator_faults}" for row in rows if row.estimator_faults)
    notes = (*stored.notes, *problems, *kept, *amiss)
    asked = f"{wanted.name}, window {wanted.window}"
    curves = {(lift.number, lift.attempt): lift.curves for lift in stored.lifts}
    lifts = [
        replace(row, curves=_again(curves.get((row.number, row.attempt)), angles)) for row, angles in found
    ]
    return Side(estimator, lifts, stored.simulated, asked, notes)


def _with_curves(folder: Path, lift: Lift, manifest: TrialManifest) -> Lift:
    try:
        return replace(lift, curves=read_curves(folder, lift, manifest.signs))
    except UNREADABLE:
        return lift


def _again(stored: LiftCurves | None, angles: Angles) -> LiftCurves | None:
    """Return a lift's stored curves with the fused angles of a replay as the estimate."""
    return None if stored is None else replace(stored, estimate=angles, tips={})
