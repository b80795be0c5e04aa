"""Many sessions again, with any estimator: lift by lift, resumable, into one table.

The folder written to is a session of the kind "replay": a line in `replays.jsonl` for each lift as
it is done, and at the end `results.csv` and `results.parquet`. What is broken becomes a line with
its problem, and the rest goes on.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import InputError, RigError, SessionError
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.replay import replay_lift, same_as_stored, session_settings
from rig.results.listing import find_sessions
from rig.results.table import COLUMNS, flat_row
from rig.sessions.files import read_lines
from rig.sessions.layout import RESULTS
from rig.sessions.session import Session, open_session, read_manifest
from rig.sessions.table_files import csv_bytes, has_parquet, parquet_bytes
from rig.tactile.estimators import choose_estimator

KIND = "replay"
TABLES = ("results.csv", "results.parquet")
Key = tuple[str, int, int]


@dataclass(frozen=True, slots=True)
class ReplayTask:
    """One recorded lift to replay, in whatever process or on whatever machine sees its folder."""

    folder: Path
    settings: TrialSettings
    row: dict[str, Any]
    started: str

    @property
    def key(self) -> Key:
        """What identifies the lift in the table."""
        return str(self.folder), self.row["number"], self.row["attempt"]


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """What is to be replayed, what cannot be, and what was left out because it is no trial."""

    tasks: tuple[ReplayTask, ...]
    broken: tuple[tuple[Path, str], ...]
    left_out: tuple[tuple[Path, str], ...]


Runner = Callable[[Callable[[ReplayTask], dict[str, Any]], list[ReplayTask]], Iterable[dict[str, Any]]]
"""Carries out tasks somewhere and yields their lines as they come."""


def gather_sessions(paths: list[Path]) -> list[Path]:
    """Return the session folders named, or found below the folders named, each once, absolute."""
    found: dict[Path, None] = {}
    for path in paths:
        inside = find_sessions(path) if path.is_dir() else []
        found.update(dict.fromkeys(folder.resolve() for folder in inside or [path]))
    return list(found)


def plan_campaign(folders: list[Path], estimator: str | None, window: int | None) -> CampaignPlan:
    """Read what is to be replayed. Raises `InputError` for an unknown estimator or window."""
    if estimator is not None or window is not None:
        choose_estimator(estimator, window)
    tasks: list[ReplayTask] = []
    broken: list[tuple[Path, str]] = []
    left_out: list[tuple[Path, str]] = []
    for folder in folders:
        try:
            kind = read_manifest(folder).get("kind") if folder.is_dir() else "trial"
            if kind in RESULTS and kind != "trial":
                left_out.append((folder, f"a '{kind}' session has no lifts to replay"))
                continue
            tasks += _tasks_of(folder, estimator, window)
        except InputError as error:
            broken.append((folder, str(error)))
    return CampaignPlan(tuple(tasks), tuple(broken), tuple(left_out))


def run_campaign(
    out: Path,
    plan: CampaignPlan,
    request: dict[str, Any],
    run: Runner,
    resume: bool = False,
    progress: Callable[[int, int, dict[str, Any]], None] = lambda done, total, line: None,
) -> list[dict[str, Any]]:
    """Replay what is left of a plan, and return the lines of the whole table.

    request: what identifies the work, the same to continue it. Lines that have a problem are tried
    again when resumed. Raises `InputError` or `RecordingError` as `open_session` does.
    """
    with open_session(out, {"kind": KIND, **request}, RESULTS[KIND], resume) as session:
        done = {_key(line): line for line in session.rows if not line["problem"]}
        todo = [task for task in plan.tasks if task.key not in done]
        for line in run(replay_task, todo):
            session.add(line, {"session": line["session"], "number": line["number"]})
            done[_key(line)] = line
            progress(len(done), len(plan.tasks), line)
        lines = [done[key] for key in sorted(done)]
        lines += [_broken_line(folder, problem) for folder, problem in plan.broken]
        _write_tables(session, lines)
        if not any(line["problem"] for line in lines) and not session.complete:
            session.rows[:] = lines
            session.finish(order=("session", "number", "attempt"))
        return lines


def replay_task(task: ReplayTask) -> dict[str, Any]:
    """Replay one lift; return its line of the table, with the problem where it cannot be read."""
    choice = task.settings.estimator
    head = {
        "session": str(task.folder),
        "started": task.started,
        "bench": task.settings.bench.name,
        "estimator": choice.name,
        "window": choice.window,
    }
    try:
        row = replay_lift(task.folder, task.settings, task.row)
    except RigError as error:
        named = {
            key: task.row.get(key) for key in ("number", "attempt", "object", "name", "lift", "simulated")
        }
        return flat_row(named, **head, accepted=False, problem=str(error))
    return flat_row(row, **head, identical=same_as_stored(row, task.row))


def _tasks_of(folder: Path, estimator: str | None, window: int | None) -> list[ReplayTask]:
    settings = session_settings(folder, estimator, window)
    rows = [row for row in read_lines(folder / RESULTS["trial"]) if row["accepted"]]
    if not rows:
        raise SessionError(f"{folder}: no finished lift to replay; run it with --resume first")
    started = str(read_manifest(folder).get("started", ""))
    return [ReplayTask(folder, settings, row, started) for row in rows]


def _write_tables(session: Session, lines: list[dict[str, Any]]) -> None:
    session.write(TABLES[0], csv_bytes(COLUMNS, lines))
    if has_parquet():
        session.write(TABLES[1], parquet_bytes(COLUMNS, lines))


def _broken_line(folder: Path, problem: str) -> dict[str, Any]:
    return flat_row({}, session=str(folder), number=0, attempt=0, accepted=False, problem=problem)


def _key(line: dict[str, Any]) -> Key:
    return line["session"], line["number"], line["attempt"]
