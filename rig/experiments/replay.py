"""Replay the lifts of a session from their stored frames, with any estimator."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import RigError, SessionError
from drivers.realtime import compute_in_one_thread
from rig.experiments.lift_plan import StoredTrial, TrialSettings, new_measurement
from rig.experiments.process_pool import run_tasks
from rig.lift.result import lift_result
from rig.results.summary import TrialSummary, summarize_trial
from rig.sessions.reading import show_again
from rig.sessions.recording_file import Gaps, gaps_text
from rig.sessions.records import Lift
from rig.sessions.rows import read_usable_lifts
from rig.tactile.angles import FUSED, Angles


@dataclass(frozen=True, slots=True)
class Replay:
    """Result of a replay: summary, rows, and the number of lifts that equal the stored ones bit for bit.

    identical: None with another estimator. problems: unreadable parts; a lift with a gap in its
    recording counts with the rest of it.
    """

    summary: TrialSummary
    rows: list[Lift]
    identical: int | None
    problems: tuple[str, ...] = ()


def run_replay(
    trial: StoredTrial,
    jobs: int,
    progress: Callable[[int, int, Lift], None] = lambda done, total, row: None,
) -> Replay:
    """Replay all accepted lifts of a trial; nothing in its session changes.

    Raises `SessionError` if no finished lift can be read, `EstimatorError` if the estimator is from another
    package and was not named.
    """
    folder, settings = trial.folder, trial.settings
    settings.estimator.require_named()
    usable = read_usable_lifts(folder)
    stored, problems = {row.number: row for row in usable.lifts}, list(usable.problems)
    rows: dict[int, Lift] = {}
    work = partial(replay_around_gaps, folder, settings)
    for _, (row, problem) in run_tasks(work, list(stored.values()), jobs):
        if problem is not None:
            problems.append(problem)
        if row is not None:
            rows[row.number] = row
            progress(len(rows), len(stored), row)
    if not rows:
        raise SessionError(problems[0])
    in_order = [rows[number] for number in sorted(rows)]
    identical = sum(row == stored[row.number] for row in in_order) if trial.own_estimator else None
    return Replay(summarize_trial(in_order), in_order, identical, tuple(problems))


def replay_around_gaps(folder: Path, settings: TrialSettings, row: Lift) -> tuple[Lift | None, str | None]:
    """Replay one recorded lift; return its row, and the unreadable part of its recording, if any."""
    gaps, path = Gaps(), folder / row.recording
    try:
        again, _ = replay_with_angles(folder, settings, row, gaps)
    except RigError as error:
        return None, gaps_text(path, gaps, error) if gaps else str(error)
    return again, gaps_text(path, gaps) if gaps else None


def replay_or_problem(folder: Path, settings: TrialSettings, row: Lift) -> tuple[Lift, Angles] | str:
    """Replay one lift as `replay_with_angles`; return the reason if its recording is damaged."""
    try:
        return replay_with_angles(folder, settings, row)
    except RigError as error:
        return str(error)


def replay_with_angles(
    folder: Path, settings: TrialSettings, row: Lift, gaps: Gaps | None = None
) -> tuple[Lift, Angles]:
    """Replay one recorded lift; return its row with the measured part computed again, and its fused angles.

    gaps: list to which damaged parts of the recording are added; they are then skipped. Raises
    `SessionError`.
    """
    compute_in_one_thread()
    measurement = new_measurement(settings)
    known_ns = {name: round(time_s * NS_PER_S) for name, time_s in row.phases_s.items()}
    show_again(folder / row.recording, measurement, known_ns, gaps)
    again, angles = lift_result(measurement, row)
    return again, angles[FUSED]
