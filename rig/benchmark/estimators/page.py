"""The benchmark's page: one HTML file that needs nothing else."""

from collections.abc import Sequence

from markupsafe import Markup

from rig.benchmark.estimators.benchmark import BenchmarkResult
from rig.benchmark.estimators.tables import (
    estimator_table,
    notes,
    stress_table,
    time_table,
)
from rig.benchmark.harness import Table, limit_table, machine
from rig.pages.page import render
from rig.tactile.estimators import DEFAULT_ESTIMATOR

_TEXT = {"estimator", "stage", "group", "condition", "limit", "asked", "worst lift", ""}


def page(result: BenchmarkResult, picture: Markup) -> str:
    """Return the HTML page, with the picture inside, as SVG."""
    every_window = estimator_table(result, windows=True)
    tables = [
        limit_table(result.limits, f"'{DEFAULT_ESTIMATOR}'"),
        estimator_table(result),
        time_table(result),
        stress_table(result),
        Table("Every window", every_window.columns, every_window.rows),
    ]
    return render(
        "rig.benchmark.estimators",
        "page.html",
        simulated="SIMULATED: " if result.simulated else "",
        lifts=result.lifts,
        seed=result.settings.seed,
        of=machine(),
        picture=picture,
        tables=[_shown(table) for table in tables],
        notes=notes(result),
    )


def _shown(table: Table) -> dict[str, object]:
    """Say which columns hold text, which rows begin a group, and which are about our estimator."""
    rows = []
    before: str | None = None
    for cells in table.rows:
        begins = bool(cells[0]) and cells[0] != before and before is not None and _grouped(table)
        before = cells[0] or before
        marks = [name for name, so in (("first", begins), ("ours", _is_ours(cells))) if so]
        rows.append({"cells": cells, "marks": " ".join(marks)})
    return {
        "title": table.title,
        "columns": table.columns,
        "text": [column in _TEXT for column in table.columns],
        "rows": rows,
    }


def _grouped(table: Table) -> bool:
    firsts: Sequence[str] = [cells[0] for cells in table.rows]
    return len(set(firsts)) < len(firsts)


def _is_ours(cells: Sequence[str]) -> bool:
    return cells[0] == DEFAULT_ESTIMATOR
