"""One harness for all benchmarks: cases, resumption, rows, limits and tables.

A benchmark is a `Study`. Its options are a frozen dataclass whose fields are the options of its command. Its
function `measure` calls `Run.each` with the cases that it measures and returns a `Report`. Everything else is
done here and in `rig.cli.benchmark`: worker processes, progress, resumption, tables on the terminal, JSON,
sections of Markdown files and exit codes.
"""

import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import typer

from drivers.errors import InputError, counted
from rig.benchmark.measured import Measured, markdown_table
from rig.experiments.process_pool import run_tasks
from rig.frames.masks import make_folder
from rig.sessions.codec import Codec, json_line, json_value
from rig.sessions.files import append_line, drop_torn_line
from rig.sessions.rows import read_rows
from rig.tactile.sample import EstimatorFaults

RESULTS = "results.jsonl"
"""File of a study's folder: a line per finished case."""
NONE = "-"
"""A cell without a value."""
SCHEMA = 4
"""Version of a study's JSON."""

Options = TypeVar("Options")
Case = TypeVar("Case")
Result = TypeVar("Result")


def column(heading: str, show: str | Callable[[Any], str] = "", doc: str = "", optional: bool = False) -> Any:
    """Declare a field of a row: heading of its column, format and meaning.

    show: a format specification such as ".2f", which is applied to each value of a tuple and shows None as
    "-"; or a function that returns the text of a value, including None. doc: unit and meaning, which the
    legend below the table explains. optional: the column is left out if it has no value in any row.
    """
    return field(metadata={"heading": heading, "show": show, "doc": doc, "optional": optional})


def option(default: Any, text: str, *flags: str, **settings: Any) -> Any:
    """Declare a field of a study's options, as `rig.cli.declared.option` does. text: its help.

    flags: its names; by default the field's. settings: those of `typer.Option`.
    """
    return field(default=default, metadata={"typer": [typer.Option, flags, {"help": text, **settings}]})


def columns_of(kind: type[Any]) -> Any:
    """Declare a field of a row whose value is a dataclass that declares columns."""
    return field(metadata={"columns": kind})


@dataclass(frozen=True, slots=True)
class Table:
    """A title, headings, and rows with one cell per heading.

    left: number of left-aligned columns. legend: headings that need an explanation, and the explanations.
    """

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    left: int = 1
    records: tuple[Any, ...] = ()
    legend: tuple[tuple[str, str], ...] = ()

    def markdown(self) -> str:
        """Return the columns and rows in Markdown, without the title."""
        return markdown_table(self.columns, self.rows)


def table_of(title: str, kind: type[Any], rows: Sequence[Any], left: int = 1) -> Table:
    """Return a table of rows. kind: their dataclass; the fields declared with `column` are shown."""
    shown = [
        (place, of) for place, of in _columns(kind)
        if not of["optional"] or any(_value(row, place) is not None for row in rows)
    ]  # fmt: skip
    cells = [tuple(_cell(_value(row, place), of["show"]) for place, of in shown) for row in rows]
    legend = tuple((of["heading"], of["doc"]) for _, of in shown if of["doc"])
    return Table(title, tuple(of["heading"] for _, of in shown), cells, left, tuple(rows), legend)


def _columns(
    kind: type[Any], place: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Yield the fields that lead to each column of a row, and what `column` declared."""
    for each in fields(kind):
        if "columns" in each.metadata:
            yield from _columns(each.metadata["columns"], (*place, each.name))
        elif "heading" in each.metadata:
            yield (*place, each.name), each.metadata


def _value(row: Any, place: tuple[str, ...]) -> Any:
    for name in place:
        row = getattr(row, name)
    return row


def limit_table(limits: Sequence[Measured], whose: str) -> Table:
    """Return a row for each limit: measured value, limit, and verdict. whose: the subject of the limits."""
    verdicts = {True: "kept", False: "MISSED", None: ""}
    rows = [(of.name, of.shown, of.asked, verdicts[of.met]) for of in limits]
    return Table(f"Limits for {whose}", ("limit", "measured", "asked", ""), rows)


@dataclass(frozen=True, slots=True)
class Report:
    """Results of a study.

    tables: for the terminal, in this order; a table of the limits follows. limits_of: the limits' subject.
    notes: lines below the tables. section: Markdown for the document given with --readme. figures: further
    JSON values; the rows of the tables are always in the JSON. files: for --out, by name. faults: failures of
    a lab's own estimators, by estimator. binding: whether a missed limit ends the command with exit code 4.
    """

    tables: Sequence[Table]
    limits: Sequence[Measured] = ()
    limits_of: str = ""
    notes: Sequence[str] = ()
    section: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    faults: Mapping[str, EstimatorFaults] = field(default_factory=dict)
    binding: bool = True


@dataclass(frozen=True, slots=True)
class Study(Generic[Options]):
    """A benchmark: `rig benchmark NAME`.

    options: its own options, a frozen dataclass. shared: which of the options "out", "resume", "readme",
    "jobs" and "seed" it has. measure: carries out the study; its docstring is the command's help. cases: name
    of the cases in the progress, in the plural. section: name of its section in a document; None: the study's
    name. keeps_results: results are stored, in a default folder if --out is not given. simulated: marks the
    JSON.
    """

    name: str
    options: type[Options]
    measure: "Callable[[Options, Run], Report]"
    cases: str
    shared: tuple[str, ...] = ("jobs", "seed")
    section: Callable[[Options], str] | None = None
    keeps_results: bool = False
    simulated: bool = True


@dataclass(frozen=True, slots=True)
class Run:
    """Settings of the run of a study, from the options that studies share.

    folder: of its results; None if it stores none. progress: called with the number of finished cases, the
    number of all cases, and a note about the last one. say: prints a line for the user.
    """

    seed: int = 0
    jobs: int | None = None
    folder: Path | None = None
    resume: bool = False
    progress: Callable[[int, int, str], None] = lambda *_: None
    say: Callable[[str], None] = lambda _: None

    @property
    def workers(self) -> int:
        """Number of worker processes: one per core, unless --jobs was given."""
        return self.jobs or os.cpu_count() or 1

    @property
    def results_folder(self) -> Path:
        """Folder of the results of a study that keeps them."""
        if self.folder is None:
            raise ValueError("this run has no folder for results")
        return self.folder

    def each(
        self,
        work: Callable[[Case], Result],
        cases: Sequence[Case],
        name: Callable[[Case], str] = str,
        stored: type[Result] | None = None,
        workers: int | None = None,
        common: str = "",
        finish: Callable[[Case, Result], str] | None = None,
    ) -> list[Result]:
        """Return the result of `work` for each case, in the order of the cases.

        name: returns the name of a case, unique among all cases that may be stored in one folder. stored:
        dataclass of the results. If given, each result is appended to `RESULTS` in the folder when its case
        ends, and a stored case is not run again. common: see the method `stored`. finish: called in this
        process with a case and its new result before the result is stored; returns the note for the progress,
        by default the case's name. Raises `InputError` like `stored`, and the errors of `work`.
        """
        names = [name(case) for case in cases]
        before = {} if stored is None else self.stored(stored, common)
        found = {each: result for each, result in before.items() if each in names}
        left = [case for case in cases if name(case) not in found]
        for case, result in run_tasks(work, left, workers or self.workers):
            note = name(case) if finish is None else finish(case, result)
            found[name(case)] = result
            if self.folder is not None and stored is not None:
                append_line(self.folder / RESULTS, json_line(_StoredCase(name(case), json_value(result))))
            self.progress(len(found), len(names), note)
        return [found[each] for each in names]

    def stored(self, kind: type[Result], common: str = "") -> dict[str, Result]:
        """Return the results in the folder, by the names of their cases. kind: the dataclass of a result.

        common: the beginning that the names of all cases in one folder share, such as bench and seed. Raises
        `InputError` if --resume was not given and there are results, or if they belong to other options,
        another command or another version.
        """
        if self.folder is None:
            return {}
        make_folder(self.folder)
        file = self.folder / RESULTS
        if other := sorted(path.name for path in self.folder.glob("*.jsonl") if path != file):
            raise InputError(
                f"{self.folder}: holds {other[0]}, written by another command or an older version; give "
                "another folder"
            )
        drop_torn_line(file)
        lines, results = read_rows(file, Codec[_StoredCase](_StoredCase)), Codec[Result](kind)
        if lines and not self.resume:
            raise InputError(
                f"{self.folder}: holds {counted(len(lines), 'result')}; continue with --resume, or give "
                "another folder"
            )
        if strange := [line.case for line in lines if not line.case.startswith(common)]:
            raise InputError(
                f"{self.folder}: holds the result of '{strange[0]}', and this run is '{common}'; continue "
                "with the options that it was begun with, or give another folder"
            )
        try:
            return {line.case: results.checked(line.result) for line in lines}
        except ValueError as error:
            raise InputError(
                f"{file}: its results were written by another command or version ({error}); give another "
                "folder"
            ) from error


@dataclass(frozen=True, slots=True)
class _StoredCase:
    """A line of `RESULTS`."""

    case: str
    result: dict[str, Any]


def as_json(study: Study[Any], options: Any, run: Run, report: Report, wall_s: float) -> dict[str, Any]:
    """Return a report as JSON values, with the options and the machine."""
    tables = [{"title": of.title, "rows": [asdict(row) for row in of.records]} for of in report.tables]
    return {
        "schema": SCHEMA,
        "benchmark": study.name,
        "simulated": study.simulated,
        "options": {name: _plain(value) for name, value in asdict(options).items()},
        **({"seed": run.seed} if "seed" in study.shared else {}),
        **({"out": str(run.folder)} if run.folder else {}),
        "machine": machine(),
        "tables": [of for of in tables if of["rows"]],
        **report.figures,
        "faults": {name: asdict(faults) for name, faults in report.faults.items()},
        "limits": [asdict(limit) for limit in report.limits],
        "wall_s": round(wall_s, 1),
    }


def _plain(option: Any) -> Any:
    """Return the value of an option for JSON: paths as text, also those in a list."""
    if isinstance(option, list):
        return list(map(_plain, option))
    return str(option) if isinstance(option, Path) else option


def machine() -> dict[str, object]:
    """Return processor, number of cores, and the versions of Python and OpenCV."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if "model name" in line] if info.exists() else []
    return {
        "processor": names[0].partition(":")[2].strip() if names else platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "opencv": cv2.__version__,
    }


def _cell(value: Any, show: str | Callable[[Any], str]) -> str:
    if callable(show):
        return show(value)
    if isinstance(value, tuple):
        return ", ".join(format(each, show) for each in value)
    return NONE if value is None else format(value, show)
