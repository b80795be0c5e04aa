"""The runner of trials and recordings: all tasks of a session, sequential or parallel, each until accepted.

A rig fault gives a row that is not accepted, and the task is repeated. After MAX_FAULTS_IN_A_ROW faults in a
row a person has to intervene.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, TypeVar

from drivers.errors import DeviceError, plural, without_values
from protocols.operator import DISPLACED
from rig.bench.source import BenchSource
from rig.experiments.process_pool import run_tasks
from rig.sessions.codec import Codec
from rig.sessions.files import recording_file
from rig.sessions.manifest import Manifest
from rig.sessions.records import Lift, PoseRow, TimingLine
from rig.sessions.session import Session, open_session

MAX_FAULTS_IN_A_ROW = 3
"""Consecutive faults after which a run ends."""
_log = logging.getLogger("rig.experiments.attempts")


@dataclass(frozen=True, slots=True)
class Task:
    """A lift or a pose to do. number: in the session, from 1. attempt: number of attempts before this one."""

    number: int
    object_id: str
    attempt: int = field(default=0, kw_only=True)

    @property
    def name(self) -> str:
        """Name in logs and fault scripts, e.g. "7/3"."""
        return f"{self.object_id}/{self.number}"


Piece = TypeVar("Piece", bound=Task)
Row = TypeVar("Row", Lift, PoseRow)
Progress = Callable[[int, int, Row], None]
"""Called after each attempt with the number of finished tasks, the number of all tasks, and the row."""


@dataclass(frozen=True, slots=True)
class Attempt(Generic[Row]):
    """The result of an attempt.

    files: by name in the session, their bytes, or the path of an existing file with an unfinished name.
    warning: problem of an accepted attempt that a person should check.
    """

    row: Row
    timing: TimingLine
    files: Mapping[str, bytes | Path]
    warning: str | None = None

    @property
    def fault(self) -> str | None:
        return self.row.fault


@dataclass(frozen=True, slots=True)
class Run(Generic[Piece, Row]):
    """The plan of a session: a trial or a recording.

    session, piece: names of the session and of a task in messages, such as "trial" and "lift". manifest: the
    request. codec: of the rows. tasks: all of them. prepare: returns the function that attempts a task, after
    the bench has begun; called with the session and the number of tasks left. table: name of the table of
    all rows, and a function that returns its bytes. logged: returns the line of the log for a row.
    """

    session: str
    piece: str
    manifest: Manifest
    codec: Codec[Row]
    tasks: Sequence[Piece]
    prepare: Callable[[Session[Row], int], Callable[[Piece], Attempt[Row]]]
    table: tuple[str, Callable[[Sequence[Row]], bytes]]
    logged: Callable[[Row], str]


def run_session(
    folder: Path,
    run: Run[Piece, Row],
    resume: bool,
    benches: BenchSource | None,
    progress: Progress[Row],
    jobs: int = 1,
) -> list[Row]:
    """Execute the unfinished tasks of a session; return the rows of all attempts, also of earlier ones.

    Raises `InputError` or `RecordingError`, see `open_session`, and `DeviceError` after three faults in a
    row; finished tasks stay on disk.
    """
    with open_session(folder, run.manifest, run.codec, resume) as session:
        unfinished = not session.complete
        if unfinished:
            if benches is not None:
                benches.begin()
            session.keep()
            done = {row.number for row in session.rows if row.accepted}
            made = Counter(row.number for row in session.rows)
            tasks = (replace(task, attempt=made[task.number]) for task in run.tasks)
            left = [task for task in tasks if task.number not in done]
            if resume and benches is not None and left:
                benches.place_first(left[0].object_id, _why_displaced(session, run.tasks, left[0]))
            _repeat_until_accepted(session, left, run, run.prepare(session, len(left)), progress, jobs)
            session.finish(order=lambda row: (row.number, row.attempt))
            for row in session.rows:
                _log.info(run.logged(row))
        name, table = run.table
        if unfinished or not (session.folder / name).exists():
            session.write(name, table(session.rows))
        return session.rows


def _why_displaced(session: Session[Row], tasks: Iterable[Task], first: Task) -> str:
    """Return why the object of the first task may not lie in its place; "" if the last attempt set it down.

    A recording without a row belongs to an attempt that was interrupted.
    """
    recording = session.folder / recording_file(first.number, first.attempt)
    if any(recording.parent.glob(f"{recording.stem}.*mcap")):
        return "the last attempt was interrupted, and its object may lie anywhere"
    if not session.rows:
        return ""
    last = session.rows[-1]
    if last.displaced:
        return DISPLACED
    before = next((task.object_id for task in tasks if task.number == last.number), None)
    return "" if before == first.object_id else f"object {before} may still be there"


def _repeat_until_accepted(
    session: Session[Row],
    tasks: list[Piece],
    run: Run[Piece, Row],
    work: Callable[[Piece], Attempt[Row]],
    progress: Progress[Row],
    jobs: int = 1,
) -> None:
    """Execute tasks, each until it is accepted; the result of each attempt is stored immediately."""
    done = sum(row.accepted for row in session.rows)
    total, faults, kinds = done + len(tasks), 0, set[str]()
    for task, attempt in run_tasks(work, tasks, jobs):
        # files first and the row last: a row in the results means that all its files exist
        for name, data in attempt.files.items():
            if isinstance(data, Path):
                session.adopt(name, data)
            else:
                session.write(name, data)
        session.add(attempt.row, attempt.timing)
        if attempt.fault is None:
            done, faults, kinds = done + 1, 0, set()
            if attempt.warning is not None:
                _log.warning("%s %s: %s", run.piece, task.name, attempt.warning)
        else:
            _log.warning("%s %s attempt %d: %s", run.piece, task.name, task.attempt, attempt.fault)
            faults += 1
            kinds.add(without_values(attempt.fault))
            tasks.insert(0, replace(task, attempt=task.attempt + 1))
        progress(done, total, attempt.row)
        if faults >= MAX_FAULTS_IN_A_ROW:
            which = "all the same" if len(kinds) == 1 else "the last"
            raise DeviceError(
                f"{run.session}: {plural(faults, 'rig fault')} in a row, {which}: {attempt.fault}; "
                f"{done} of {plural(total, run.piece)} are done: fix the fault, then continue with --resume"
            )


def fault_text(error: Exception) -> str:
    """Return what failed, and in which state the bench was left."""
    notes = "; ".join(getattr(error, "__notes__", []))
    return f"{type(error).__name__}: {error}" + (f" [{notes}]" if notes else "")
