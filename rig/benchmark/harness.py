"""One harness for all benchmarks: cases, resumption, rows, limits and tables.

A benchmark is a `Study`. Its options are a frozen dataclass (`rig.declared`). Its function `measure` calls
`Run.each` with the cases that it measures and returns a `Report`. Everything else is done here and in
`rig.cli.benchmark`: worker processes, progress, resumption, tables on the terminal, JSON, sections of
Markdown files and exit codes.
"""

import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2

from drivers.errors import InputError, plural
from rig.benchmark.measured import NONE, Measured
from rig.experiments.process_pool import runner
from rig.frames.masks import make_folder
from rig.sessions.codec import Codec, json_line, json_value
from rig.sessions.files import append_line, drop_torn_line
from rig.sessions.rows import read_rows
from rig.tactile.sample import EstimatorFaults
from rig.version import processor, version_text

RESULTS = "results.jsonl"  # file of a study's folder: a line per finished case
ALL = "all"  # name of the group of all cases
SCHEMA = 4  # version of a study's JSON

Options = TypeVar("Options")
Case = TypeVar("Case")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Cell:
    """A value of a row: its name in JSON, and the heading, format and meaning of its column.

    heading: None without a column; "" also for a dataclass that declares columns itself. show: a format
    specification such as ".2f", which is applied to each value of a tuple and shows None as "-"; or a
    function that returns the text of a value, including None. doc: unit and meaning, which the legend below
    the table explains. optional: the column is left out if it has no value in any row.
    """

    name: str
    value: Any
    heading: str | None = ""
    show: str | Callable[[Any], str] = ""
    doc: str = ""
    optional: bool = False

    def __str__(self) -> str:
        if callable(self.show):
            return self.show(self.value)
        if isinstance(self.value, tuple):
            return ", ".join(format(each, self.show) for each in self.value)
        return NONE if self.value is None else format(self.value, self.show)


def column(heading: str, show: str | Callable[[Any], str] = "", doc: str = "", optional: bool = False) -> Any:
    """Declare a field of a dataclass as a cell of a row; the arguments are those of `Cell`."""
    return field(metadata={"heading": heading, "show": show, "doc": doc, "optional": optional})


@dataclass(frozen=True, slots=True)
class Table:
    """A title, headings, and rows with one cell per heading."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    left: int = 1  # number of left-aligned columns
    records: tuple[Any, ...] = ()  # the rows for JSON: dataclasses, or values by name
    legend: tuple[tuple[str, str], ...] = ()  # headings that need an explanation, and the explanations

    def markdown(self) -> str:
        """Return the columns and rows in Markdown, without the title. A "|" in a cell is written as "/"."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in of) + " |" for of in lines)


def table_of(title: str, rows: Sequence[Any], left: int = 1) -> Table:
    """Return a table. rows: at least one, dataclasses with fields declared by `column`, or lists of cells."""
    shown = [
        of
        for of in zip(*map(_cells, rows), strict=True)
        if of[0].heading is not None and (not of[0].optional or any(cell.value is not None for cell in of))
    ]
    headings = tuple(first.heading for first, *_ in shown)
    records = tuple({of.name: of.value for of in row} if isinstance(row, list) else row for row in rows)
    legend = tuple((first.heading, first.doc) for first, *_ in shown if first.doc)
    return Table(
        title, headings, list(zip(*(map(str, of) for of in shown), strict=True)), left, records, legend
    )


def _cells(row: Any) -> Iterator[Cell]:
    if not isinstance(row, list):
        row = [
            Cell(each.name, getattr(row, each.name), **each.metadata) for each in fields(row) if each.metadata
        ]
    for cell in row:
        yield from [cell] if cell.heading or not is_dataclass(cell.value) else _cells(cell.value)


def limit_table(limits: Sequence[Measured], whose: str) -> Table:
    verdicts = {True: "kept", False: "MISSED", None: ""}
    rows = [(of.name, of.shown, of.asked, verdicts[of.met]) for of in limits]
    return Table(f"Limits for {whose}", ("limit", "measured", "asked", ""), rows)


@dataclass(frozen=True, slots=True)
class Report:
    tables: Sequence[Table]  # for the terminal, in this order; a table of the limits follows
    limits: Sequence[Measured] = ()
    limits_of: str = ""  # the limits' subject
    notes: Sequence[str] = ()  # lines below the tables
    section: str = ""  # Markdown for the document given with --readme
    figures: Mapping[str, Any] = field(default_factory=dict)  # further JSON values, beside the tables' rows
    files: Mapping[str, str | bytes] = field(default_factory=dict)  # for --out, by name
    faults: Mapping[str, EstimatorFaults] = field(default_factory=dict)  # of a lab's own estimators


@dataclass(frozen=True, slots=True)
class Study(Generic[Options]):
    """A benchmark: `rig benchmark NAME`."""

    name: str
    options: type[Options]  # its own options, a frozen dataclass
    measure: "Callable[[Options, Run], Report]"  # carries out the study; its docstring is the command's help
    cases: str  # name of the cases in the progress, in the plural
    shared: tuple[str, ...] = ("jobs", "seed")  # its options, of out, resume, readme, jobs, seed and engine
    section: Callable[[Options], str] | None = None  # name of its section in a document, if not its name
    keeps_results: bool = False  # results are stored, in a default folder if --out is not given
    simulated: bool = True  # marks the JSON


@dataclass(frozen=True, slots=True)
class _StoredCase:
    """A line of `RESULTS`."""

    case: str
    result: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Run:
    """Settings of the run of a study, from the options that studies share."""

    seed: int = 0
    jobs: int | None = None
    folder: Path | None = None  # of its results; None if it stores none
    resume: bool = False
    progress: Callable[[int, int, str], None] = lambda *_: None  # finished cases, all, note on the last one
    say: Callable[[str], None] = lambda _: None  # prints a line for the user
    engine: str | None = None  # dask cluster that runs the cases

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
        ends, and a stored case is not run again. common: see `read_stored`. finish: called in this
        process with a case and its new result before the result is stored; returns the note for the progress,
        by default the case's name. Raises `InputError` like `read_stored`, and the errors of `work`.
        """
        names = [name(case) for case in cases]
        before = {} if stored is None else self.read_stored(stored, common)
        found = {each: result for each, result in before.items() if each in names}
        left = [case for case in cases if name(case) not in found]
        for case, result in runner(self.engine, workers or self.workers)(work, left):
            note = name(case) if finish is None else finish(case, result)
            found[name(case)] = result
            if self.folder is not None and stored is not None:
                append_line(self.folder / RESULTS, json_line(_StoredCase(name(case), json_value(result))))
            self.progress(len(found), len(names), note)
        return [found[each] for each in names]

    def read_stored(self, kind: type[Result], common: str = "") -> dict[str, Result]:
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
                f"{self.folder}: holds {plural(len(lines), 'result')}; continue with --resume, or give "
                "another folder"
            )
        if strange := [line.case for line in lines if not line.case.startswith(common)]:
            raise InputError(
                f"{self.folder}: holds the result of '{strange[0]}', and this run is '{common}'; continue "
                "with the options that it was begun with, or give another folder"
            )
        try:
            return {line.case: results.parse_values(line.result) for line in lines}
        except ValueError as error:
            raise InputError(
                f"{file}: its results were written by another command or version ({error}); give another "
                "folder"
            ) from error


def as_json(study: Study[Any], options: Any, run: Run, report: Report, wall_s: float) -> dict[str, Any]:
    def plain(value: Any) -> Any:
        if isinstance(value, list):
            return list(map(plain, value))
        if isinstance(value, dict):
            return {name: plain(each) for name, each in value.items()}
        if is_dataclass(value) and not isinstance(value, type):
            return asdict(value)
        return str(value) if isinstance(value, Path) else value

    tables = [{"title": of.title, "rows": [plain(row) for row in of.records]} for of in report.tables]
    return {
        "schema": SCHEMA,
        "tool_version": version_text(),
        "benchmark": study.name,
        "simulated": study.simulated,
        "options": plain(asdict(options)),
        **({"seed": run.seed} if "seed" in study.shared else {}),
        **({"out": str(run.folder)} if run.folder else {}),
        "machine": machine(),
        "tables": [of for of in tables if of["rows"]],
        **report.figures,
        "faults": {name: asdict(faults) for name, faults in report.faults.items()},
        "limits": [asdict(limit) for limit in report.limits],
        "wall_s": round(wall_s, 1),
    }


def machine() -> dict[str, object]:
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "opencv": cv2.__version__,
    }


def processor_and_cores() -> str:
    """Return the processor and its number of cores, for published times."""
    return f"{processor()}, {os.cpu_count()} cores"


def markers(name: str) -> tuple[str, str]:
    """Return the two lines that enclose the table of `rig benchmark NAME` in a document."""
    return f"<!-- rig benchmark {name}: begin -->", f"<!-- rig benchmark {name}: end -->"


def check_readme(path: Path, name: str) -> None:
    """Raise `InputError` unless a file has the two marker lines, once each and in order."""
    begin, end = markers(name)
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if not (text.count(begin) == text.count(end) == 1 and text.index(begin) < text.index(end)):
        raise InputError(f"{path}: put these two lines where the table belongs: {begin} and {end}")


def write_section(path: Path, name: str, section: str) -> None:
    """Replace the lines between the two markers, and name the version that measured them.

    Raises `InputError` if the markers are missing.
    """
    check_readme(path, name)
    begin, end = markers(name)
    head, _, rest = path.read_text(encoding="utf-8").partition(begin)
    path.write_text(
        f"{head}{begin}\n{section}\n\nMeasured with rig {version_text()}.\n{end}{rest.partition(end)[2]}",
        encoding="utf-8",
    )
