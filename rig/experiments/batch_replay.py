"""Replay many sessions with any estimator: lift by lift, resumable, into one table.

The output folder is a session of the kind "replay": one line per finished lift in `replays.jsonl`, and at the
end `results.csv` and `results.parquet`. A lift that cannot be read gets a line with its problem; the others
continue.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from rig.experiments.lift_plan import StoredTrial, trial_of
from rig.experiments.replay import replay_around_gaps
from rig.results.listing import find_sessions
from rig.results.table import COLUMNS, REPLAYS, broken_row, session_cells, table_row, unread_row
from rig.sessions.manifest import ReplayManifest, TrialManifest, begun, read_manifest
from rig.sessions.records import Lift
from rig.sessions.rows import read_usable_lifts
from rig.sessions.session import Session, open_session
from rig.sessions.table_files import Line, csv_bytes, has_parquet, parquet_bytes
from rig.sessions.timing import ReplayTiming
from rig.tactile.estimators import choose_estimator

TABLES = ("results.csv", "results.parquet")
Key = tuple[str, int | None, int | None]


@dataclass(frozen=True, slots=True)
class ReplayTask:
    """A recorded lift to replay, in any process or on any machine that can read its folder."""

    trial: StoredTrial
    row: Lift

    @property
    def key(self) -> Key:
        """Key of the lift in the table."""
        return str(self.trial.folder), self.row.number, self.row.attempt


@dataclass(frozen=True, slots=True)
class ReplayPlan:
    """Lifts to replay, unreadable sessions or lines (broken), and sessions without lifts (left_out).

    If a line of a session is broken, its other lifts are replayed.
    """

    tasks: tuple[ReplayTask, ...]
    broken: tuple[tuple[Path, str], ...]
    left_out: tuple[tuple[Path, str], ...]


Runner = Callable[[Callable[[ReplayTask], Line], list[ReplayTask]], Iterable[Line]]
"""Executes tasks and yields their rows as they finish."""


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
        for row in run(replay_task, todo):
            key = _key(row)
            session.add(row, ReplayTiming(session=key[0], number=key[1]))
            done[key] = row
            progress(len(done), len(plan.tasks), row)
        rows = sorted(done.values(), key=_key)
        rows += [broken_row(str(folder), problem) for folder, problem in plan.broken]
        _write_tables(session, rows)
        if not any(row["problem"] for row in rows) and not session.complete:
            session.rows[:] = rows
            session.finish(order=_key)
        return rows


def replay_manifest(folders: list[Path], estimator: str | None, window: int | None) -> ReplayManifest:
    """Return the manifest of a new table: the request, which must be the same to continue it."""
    sessions = tuple(str(folder) for folder in folders)
    return ReplayManifest(**vars(begun("replay")), sessions=sessions, estimator=estimator, window=window)


def replay_task(task: ReplayTask) -> Line:
    """Replay one lift; return its row of the table, with the problem if it cannot be read completely."""
    trial, choice = task.trial, task.trial.settings.estimator
    about = session_cells(str(trial.folder), trial.manifest, choice.name, choice.window)
    row, problem = replay_around_gaps(trial.folder, trial.settings, task.row)
    if row is None:
        return unread_row(about, task.row, problem or "")
    return table_row(about, row, row == task.row if trial.own_estimator else None, problem)


def _write_tables(session: Session[Line], rows: list[Line]) -> None:
    session.write(TABLES[0], csv_bytes(COLUMNS, rows))
    if has_parquet():
        session.write(TABLES[1], parquet_bytes(COLUMNS, rows))


def _key(row: Line) -> Key:
    session, number, attempt = (row[name] for name in ("session", "number", "attempt"))
    return str(session), number, attempt  # type: ignore[return-value]
