"""Replay the lifts of one or many sessions from their stored frames, with any estimator.

The replay of many sessions is a session of the kind "replay": one line per finished lift in `replays.jsonl`,
and at the end `results.csv` and `results.parquet`. A lift that cannot be read gets a line with its problem;
the others continue.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import InputError, RigError, SessionError
from drivers.realtime import compute_in_one_thread
from rig.experiments.lift_plan import StoredTrial, TrialSettings, new_measurement, trial_of
from rig.experiments.process_pool import run_tasks
from rig.lift.result import evaluate_lift
from rig.results.listing import find_sessions
from rig.results.summary import TrialSummary, summarize_trial
from rig.results.table import (
    COLUMNS,
    REPLAYS,
    Agreement,
    agreement,
    broken_row,
    compare_lifts,
    session_cells,
    table_row,
    unread_row,
)
from rig.sessions.manifest import ReplayManifest, TrialManifest, begin_manifest, read_manifest
from rig.sessions.reading import show_again
from rig.sessions.recording_file import Gaps, gaps_text
from rig.sessions.records import Lift, ReplayTiming
from rig.sessions.rows import read_usable_lifts
from rig.sessions.session import open_session
from rig.sessions.table_files import Line, csv_bytes, parquet_bytes
from rig.tactile.angles import FUSED
from rig.tactile.estimators import choose_estimator

Key = tuple[str, int | None, int | None]


@dataclass(frozen=True, slots=True)
class Replay:
    """Result of a replay.

    agreement: with the stored lifts; None with another estimator. problems: unreadable parts; a lift with a
    gap in its recording counts with the rest of it.
    """

    summary: TrialSummary
    rows: list[Lift]
    agreement: Agreement | None
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
    for _, (row, problem) in run_tasks(partial(replay_lift, folder, settings), list(stored.values()), jobs):
        if problem is not None:
            problems.append(problem)
        if row is not None:
            rows[row.number] = row
            progress(len(rows), len(stored), row)
    if not rows:
        raise SessionError(problems[0])
    in_order = [rows[number] for number in sorted(rows)]
    cells = [compare_lifts(row, stored[row.number]) for row in in_order if trial.own_estimator]
    return Replay(summarize_trial(in_order), in_order, agreement(cells), tuple(problems))


def replay_lift(
    folder: Path, settings: TrialSettings, row: Lift, around_gaps: bool = True
) -> tuple[Lift | None, str | None]:
    """Replay one recorded lift.

    Returns its row with the measured part computed again, its fused angles and its computing time per frame,
    None if its recording cannot be read, and the unreadable part of the recording, if any. around_gaps: use
    the rest of a recording that is damaged in part.
    """
    gaps, path = Gaps() if around_gaps else None, folder / row.recording
    compute_in_one_thread()
    measurement = new_measurement(settings)
    known_ns = {name: round(time_s * NS_PER_S) for name, time_s in row.phases_s.items()}
    try:
        show_again(path, measurement, known_ns, gaps)
        again = evaluate_lift(measurement, row)
    except RigError as error:
        return None, gaps_text(path, gaps, error) if gaps else str(error)
    total = measurement.stage_times().get("total")
    frame_ms = None if total is None else total.p50_ms or None  # an estimator need not time its stages
    fused = replace(again, angles={FUSED: again.estimate}, frame_ms=frame_ms)
    return fused, gaps_text(path, gaps) if gaps else None


@dataclass(frozen=True, slots=True)
class ReplayTask:
    """A recorded lift to replay, in any process or on any machine that can read its folder."""

    trial: StoredTrial
    row: Lift

    @property
    def key(self) -> Key:
        return str(self.trial.folder), self.row.number, self.row.attempt


@dataclass(frozen=True, slots=True)
class ReplayPlan:
    """Lifts to replay, unreadable sessions or lines (broken), and sessions without lifts (left_out).

    If a line of a session is broken, its other lifts are replayed.
    """

    tasks: tuple[ReplayTask, ...]
    broken: tuple[tuple[Path, str], ...]
    left_out: tuple[tuple[Path, str], ...]


Runner = Callable[[Callable[[ReplayTask], Line], list[ReplayTask]], Iterable[tuple[ReplayTask, Line]]]
"""Executes tasks and yields them with their rows as they finish."""


def gather_sessions(paths: list[Path]) -> list[Path]:
    """Return the given session folders, and those found below the given folders; each once, absolute."""
    found: dict[Path, None] = {}
    for path in paths:
        inside = find_sessions(path) if path.is_dir() else []
        found.update(dict.fromkeys(folder.resolve() for folder in inside or [path]))
    return list(found)


def plan_replays(folders: list[Path], estimator: str | None, window: int | None) -> ReplayPlan:
    """Read the lifts to replay. Raises `InputError` for an unknown estimator or window."""
    if estimator is not None or window is not None:
        choose_estimator(estimator, window)
    tasks: list[ReplayTask] = []
    broken: list[tuple[Path, str]] = []
    left_out: list[tuple[Path, str]] = []
    for folder in folders:
        try:
            manifest = read_manifest(folder)
            if isinstance(manifest, TrialManifest):
                trial, usable = trial_of(folder, manifest, estimator, window), read_usable_lifts(folder)
                trial.settings.estimator.require_named()
                tasks += [ReplayTask(trial, row) for row in usable.lifts]
                broken += [(folder, problem) for problem in usable.problems]
            else:
                left_out.append((folder, f"a '{manifest.kind}' session has no lifts to replay"))
        except InputError as error:
            broken.append((folder, str(error)))
    return ReplayPlan(tuple(tasks), tuple(broken), tuple(left_out))


def run_replays(
    out: Path,
    plan: ReplayPlan,
    manifest: ReplayManifest,
    run: Runner,
    resume: bool = False,
    progress: Callable[[int, int, Line], None] = lambda done, total, row: None,
) -> list[Line]:
    """Replay the unfinished lifts of a plan, and return the rows of the whole table.

    manifest: identifies the work; it must be the same to continue it. Rows with a problem are retried on
    resume. Raises `InputError` or `RecordingError`, see `open_session`.
    """
    with open_session(out, manifest, REPLAYS, resume) as session:
        session.keep()
        done = {_key(row): row for row in session.rows if not row["problem"]}
        todo = [task for task in plan.tasks if task.key not in done]
        for _, row in run(replay_task, todo):
            key = _key(row)
            session.add(row, ReplayTiming(session=key[0], number=key[1]))
            done[key] = row
            progress(len(done), len(plan.tasks), row)
        rows = sorted(done.values(), key=_key)
        rows += [broken_row(str(folder), problem) for folder, problem in plan.broken]
        session.write("results.csv", csv_bytes(COLUMNS, rows))
        if find_spec("pyarrow") is not None:
            session.write("results.parquet", parquet_bytes(COLUMNS, rows))
        if not any(row["problem"] for row in rows) and not session.complete:
            session.rows[:] = rows
            session.finish(order=_key)
        return rows


def replay_manifest(folders: list[Path], estimator: str | None, window: int | None) -> ReplayManifest:
    """Return the manifest of a new table: the request, which must be the same to continue it."""
    sessions = tuple(str(folder) for folder in folders)
    return ReplayManifest(
        **vars(begin_manifest("replay")), sessions=sessions, estimator=estimator, window=window
    )


def replay_task(task: ReplayTask) -> Line:
    """Replay one lift; return its row of the table, with the problem if it cannot be read completely."""
    trial, choice = task.trial, task.trial.settings.estimator
    about = session_cells(str(trial.folder), trial.manifest, choice.name, choice.window)
    row, problem = replay_lift(trial.folder, trial.settings, task.row)
    if row is None:
        return unread_row(about, task.row, problem or "")
    return table_row(about, row, task.row if trial.own_estimator else None, problem)


def _key(row: Line) -> Key:
    session, number, attempt = (row[name] for name in ("session", "number", "attempt"))
    return str(session), number, attempt  # type: ignore[return-value]
