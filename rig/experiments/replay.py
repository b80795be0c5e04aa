"""The lifts of a session again, from their stored frames, with any estimator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import RigError, SessionError
from drivers.realtime import compute_in_one_thread
from rig.experiments.interrupted import InterruptedLift, interrupted_lifts
from rig.experiments.lift_attempt import TrialSettings, new_measurement
from rig.experiments.process_pool import run_tasks
from rig.lift.marker_truth import TRUTH
from rig.lift.result import lift_result
from rig.lift.slip_watch import SlipSettings
from rig.results.metrics import Floats
from rig.results.summary import TrialSummary, summarize_trial
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.reading import show_again
from rig.sessions.recording_file import Gaps, gaps_text
from rig.sessions.records import FinishedLift
from rig.sessions.rows import UsableLifts, read_usable_lifts
from rig.tactile.estimators import EstimatorChoice, choose_estimator, stored_choice


@dataclass(frozen=True, slots=True)
class Replay:
    """What a replay gave: its summary, rows, and how many lifts equal the stored ones bit for bit.

    identical: None where they are not expected to: another estimator, or another way to measure the truth.
    problems: what could not be read; a lift with a gap in its recording counts with what is left of it.
    interrupted: what unfinished recordings hold, which is in none of the others.
    """

    summary: TrialSummary
    rows: list[FinishedLift]
    identical: int | None
    problems: tuple[str, ...] = ()
    interrupted: tuple[InterruptedLift, ...] = ()


def run_replay(
    folder: Path,
    estimator: str | None,
    window: int | None,
    jobs: int,
    progress: Callable[[int, int, FinishedLift], None] = lambda done, total, row: None,
) -> Replay:
    """Replay all accepted lifts of a session; nothing in the session changes.

    estimator, window: those of the session when None. Raises `SessionError` for a folder that
    is none, or where no finished lift can be read, `EstimatorError` for a session whose estimator is not
    the rig's own and was not named.
    """
    settings = session_settings(folder, estimator, window)
    settings.estimator.require_named()
    interrupted, unread = interrupted_lifts(folder, settings)
    usable = _usable(folder, interrupted)
    stored, problems = {row.number: row for row in usable.lifts}, [*usable.problems, *unread]
    rows: dict[int, FinishedLift] = {}
    work = partial(replay_around_gaps, folder, settings)
    for _, (row, problem) in run_tasks(work, list(stored.values()), jobs):
        if problem is not None:
            problems.append(problem)
        if row is not None:
            rows[row.number] = row
            progress(len(rows), len(stored), row)
    if not rows and not interrupted:
        raise SessionError(problems[0])
    in_order = [rows[number] for number in sorted(rows)]
    identical = None
    if repeats(folder, settings):
        identical = sum(row == stored[row.number] for row in in_order)
    return Replay(summarize_trial(in_order), in_order, identical, tuple(problems), tuple(interrupted))


def _usable(folder: Path, interrupted: Sequence[InterruptedLift]) -> UsableLifts:
    """Read the finished lifts; that there is none is an error only if there is no interrupted one either."""
    try:
        return read_usable_lifts(folder)
    except SessionError as error:
        if not interrupted:
            raise
        return UsableLifts((), (str(error),))


def replay_around_gaps(
    folder: Path, settings: TrialSettings, row: FinishedLift
) -> tuple[FinishedLift | None, str | None]:
    """Watch one recorded lift again; return its row, and what of its recording cannot be read."""
    gaps, path = Gaps(), folder / row.recording
    try:
        again = replay_lift(folder, settings, row, gaps)
    except RigError as error:
        return None, gaps_text(path, gaps, error) if gaps else str(error)
    return again, gaps_text(path, gaps) if gaps else None


def replay_or_problem(
    folder: Path, settings: TrialSettings, row: FinishedLift
) -> tuple[FinishedLift, Floats] | str:
    """Replay one lift as `replay_with_angles`; return why, if its recording cannot be read as a whole."""
    try:
        return replay_with_angles(folder, settings, row)
    except RigError as error:
        return str(error)


def replay_lift(
    folder: Path, settings: TrialSettings, row: FinishedLift, gaps: Gaps | None = None
) -> FinishedLift:
    """Return the row alone of `replay_with_angles`."""
    return replay_with_angles(folder, settings, row, gaps)[0]


def replay_with_angles(
    folder: Path, settings: TrialSettings, row: FinishedLift, gaps: Gaps | None = None
) -> tuple[FinishedLift, Floats]:
    """Replay one recorded lift; return its row with the measured part computed again, and its angles.

    The angles are (N, 3): time by the recording's clock in s, fused angle and sigma in degrees, NaN where
    refused. gaps: list to which damage of the recording is added, and then passed over. Raises
    `SessionError`.
    """
    compute_in_one_thread()
    measurement = new_measurement(settings)
    known_ns = {name: round(time_s * NS_PER_S) for name, time_s in row.phases_s.items()}
    phases_ns = show_again(folder / row.recording, measurement, measurement, known_ns, gaps)
    figures, _ = lift_result(measurement)
    phases_s = {name: time_ns / NS_PER_S for name, time_ns in phases_ns.items()}
    again = replace(row, **{**vars(figures), "phases_s": phases_s})
    angles = [(s.time_ns / NS_PER_S, s.angle_deg, s.sigma_deg) for s in measurement.fused]
    return again, np.array(angles, float).reshape(-1, 3)


def repeats(folder: Path, settings: TrialSettings) -> bool:
    """Whether these settings are to give a session's stored results again. Raises `SessionError`."""
    return settings == session_settings(folder, None, None) and truth_note(folder) is None


def truth_note(folder: Path) -> str | None:
    """What a replay measures in another way than a session did, if anything. Raises `SessionError`."""
    truth = read_manifest_of(folder, TrialManifest, "only trials have lifts to replay").truth
    if truth == TRUTH:
        return None
    return (
        f"true angles were measured by the markers' {truth}, a replay measures them by their {TRUTH}: errors "
        "differ by some hundredths of a degree; the stored rows stay as they are"
    )


def session_settings(folder: Path, estimator: str | None, window: int | None) -> TrialSettings:
    """Return the settings a trial session was made with, or with another estimator.

    An estimator that is not the rig's own is imported where it is named here, and not where the session
    alone names it: then it cannot be made. Raises `SessionError`, `InputError`.
    """
    manifest = read_manifest_of(folder, TrialManifest, "only trials have lifts to replay")
    return TrialSettings(
        manifest.config,
        manifest.seed,
        _choice(manifest, estimator, window),
        react=manifest.react,
        slip=SlipSettings(manifest.false_alarms_per_hour, manifest.max_turn_deg),
    )


def _choice(manifest: TrialManifest, estimator: str | None, window: int | None) -> EstimatorChoice:
    """Return the session's own estimator, or another with its usual window."""
    if estimator is None:
        return stored_choice(manifest.estimator, window or manifest.window, manifest.skip)
    if estimator == manifest.estimator:
        return choose_estimator(estimator, window or manifest.window, manifest.skip)
    return choose_estimator(estimator, window)
