"""The files that a run of the benchmark leaves."""

import json
from pathlib import Path

from drivers.errors import InputError
from rig.benchmark.estimators.benchmark import BenchmarkResult, as_json
from rig.benchmark.estimators.page import page
from rig.benchmark.estimators.picture import draw
from rig.benchmark.estimators.tables import NAME, readme_section
from rig.benchmark.readme import check_readme, write_section

FIGURES, PICTURE, PAGE, TABLE = "results.json", "pareto.png", "index.html", "table.md"


def check_writable(folder: Path, readme: Path | None) -> None:
    """Find out before the run what could not be written after it. Raises `InputError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / FIGURES).touch()
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}): choose another --out") from error
    if readme is not None:
        check_readme(readme, NAME)


def write_results(folder: Path, result: BenchmarkResult, readme: Path | None = None) -> None:
    """Write the results as JSON, picture, page and table, and the table into a README."""
    picture, chart = draw(result)
    (folder / FIGURES).write_text(json.dumps(as_json(result), indent=1) + "\n", encoding="utf-8")
    (folder / PICTURE).write_bytes(picture)
    (folder / PAGE).write_text(page(result, chart), encoding="utf-8")
    (folder / TABLE).write_text(readme_section(result) + "\n", encoding="utf-8")
    if readme is not None:
        write_section(readme, NAME, readme_section(result))
