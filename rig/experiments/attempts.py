"""Attempts at the tasks of a session, sequential or parallel, each task repeated until accepted.

Used for the lifts of a trial and the poses of a recording. A rig fault gives a row that is not accepted, and
the task is repeated. After MAX_FAULTS_IN_A_ROW faults in a row a person has to intervene.
"""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from drivers.errors import DeviceError, counted, without_values
from rig.experiments.process_pool import run_tasks
from rig.sessions.session import Session
from rig.sessions.timing import TimingLine

MAX_FAULTS_IN_A_ROW = 3
"""Consecutive faults after which a run ends."""
_log = logging.getLogger("rig.experiments.attempts")


class Task(Protocol):
    """A task of a session, a frozen dataclass with its number in the session (from 1) and its attempt."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def number(self) -> int:
        """Number in the session."""
        ...

    @property
    def attempt(self) -> int:
        """Number of attempts before this one."""
        ...

    @property
    def name(self) -> str:
        """Name in logs and fault scripts."""
        ...


class AttemptRow(Protocol):
    """The stored result of an attempt, such as `Lift` and `PoseRow`."""

    @property
    def accepted(self) -> bool:
        """Whether the attempt counts."""
        ...


Piece = TypeVar("Piece", bound=Task)
Row = TypeVar("Row", bound=AttemptRow)


@dataclass(frozen=True, slots=True)
class Attempt(Generic[Row]):
    """The result of an attempt.

    files: by name in the session, their bytes, or the path of an existing file with an unfinished name.
    fault: why the attempt failed, None if it is accepted. warning: problem of an accepted attempt that a
    person should check.
    """

    row: Row
    timing: TimingLine
    fault: str | None
    files: Mapping[str, bytes | Path]
    warning: str | None = None


@dataclass(frozen=True, slots=True)
class Wording:
    """Names of the session and of one task in messages, such as "trial" and "lift"."""

    session: str
    piece: str


Progress = Callable[[int, int, Row], None]
"""Called after each attempt with the number of finished tasks, the number of all tasks, and the row."""


def left_to_do(tasks: Iterable[Piece], rows: Sequence[Row], number_of: Callable[[Row], int]) -> list[Piece]:
    """Return the unfinished tasks, each with the number of attempts already made.

    number_of: returns the task number of a row.
    """
    done = {number_of(row) for row in rows if row.accepted}
    made = Counter(number_of(row) for row in rows)
    return [replace(task, attempt=made[task.number]) for task in tasks if task.number not in done]


def repeat_until_accepted(
    session: Session[Row],
    tasks: list[Piece],
    work: Callable[[Piece], Attempt[Row]],
    wording: Wording,
    progress: Progress[Row],
    jobs: int = 1,
) -> None:
    """Execute all tasks, each until it is accepted; the result of each attempt is stored immediately.

    Raises `DeviceError` after three faults in a row; finished tasks stay on disk.
    """
    done = sum(row.accepted for row in session.rows)
    total, faults, kinds = done + len(tasks), 0, set[str]()
    for task, attempt in run_tasks(work, tasks, jobs):
        _keep(session, task, attempt, wording)
        if attempt.fault is None:
            done, faults, kinds = done + 1, 0, set()
        else:
            faults += 1
            kinds.add(without_values(attempt.fault))
            tasks.insert(0, replace(task, attempt=task.attempt + 1))
        progress(done, total, attempt.row)
        if faults >= MAX_FAULTS_IN_A_ROW:
            raise DeviceError(
                f"{wording.session}: {_in_a_row(faults, len(kinds))}: {attempt.fault}; "
                f"{done} of {counted(total, wording.piece)} are done: fix the fault, then continue "
                "with --resume"
            )


def fault_text(error: Exception) -> str:
    """Return what failed, and in which state the bench was left."""
    notes = "; ".join(getattr(error, "__notes__", []))
    return f"{type(error).__name__}: {error}" + (f" [{notes}]" if notes else "")


def _in_a_row(faults: int, kinds: int) -> str:
    return f"{counted(faults, 'rig fault')} in a row, " + ("all the same" if kinds == 1 else "the last")


def _keep(session: Session[Row], task: Task, attempt: Attempt[Row], wording: Wording) -> None:
    """Store files first and the row last: a row in the results means that all its files exist."""
    for name, data in attempt.files.items():
        if isinstance(data, Path):
            session.adopt(name, data)
        else:
            session.write(name, data)
    session.add(attempt.row, attempt.timing)
    if attempt.fault is not None:
        _log.warning("%s %s attempt %d: %s", wording.piece, task.name, task.attempt, attempt.fault)
    elif attempt.warning is not None:
        _log.warning("%s %s: %s", wording.piece, task.name, attempt.warning)
