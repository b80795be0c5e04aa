"""Figures and tables of a report as files for a paper: PDF, SVG and PNG at column width, LaTeX and CSV."""

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError
from rig.pages.figure import column_files
from rig.report.parts import ReportPage, Table
from rig.sessions.files import write_file

TABLE = "rotational_error"
SIMULATED = "simulated_"
"""Prefix of file names if the lifts are simulated, so that they are not published as measured."""
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{",
    "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "°": r"$^\circ$",
}  # fmt: skip


def write_paper(folder: Path, page: ReportPage) -> None:
    """Write each figure and the table of a page, with the page's text.

    Raises `InputError` if the folder cannot be made, `RecordingError` if a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another --figures") from error
    mark, table = SIMULATED if page.simulated else "", page.table
    for chart in page.charts:
        for ending, data in column_files(chart.figure).items():
            write_file(folder / f"{mark}{_file_name(chart.title)}.{ending}", data)
    if table is not None:
        write_file(folder / f"{mark}{TABLE}.tex", latex(table, page.simulated).encode())
        write_file(folder / f"{mark}{TABLE}.csv", csv_text(table).encode())


def latex(table: Table, simulated: bool) -> str:
    """Return a table as a LaTeX tabular, which needs no package."""
    columns = "".join("l" if number in table.text else "r" for number in range(len(table.columns)))
    lines = [_latex_row(table.columns), r"\hline", *map(_latex_row, table.rows)]
    if table.total:
        lines.insert(-1, r"\hline")
    about = ["% SIMULATED: objects, sensors and light are computed."] if simulated else []
    begin, end = rf"\begin{{tabular}}{{{columns}}}", r"\end{tabular}"
    return "\n".join([*about, begin, r"\hline", *lines, r"\hline", end]) + "\n"


def csv_text(table: Table) -> str:
    """Return a table as CSV with the page's text."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([table.columns, *table.rows])
    return text.getvalue()


def _latex_row(cells: Sequence[str]) -> str:
    texts = ("".join(_LATEX.get(character, character) for character in cell) for cell in cells)
    return " & ".join(texts) + r" \\"


def _file_name(title: str) -> str:
    return re.sub(r"[^\w]+", "_", title.replace("|", "")).strip("_")
