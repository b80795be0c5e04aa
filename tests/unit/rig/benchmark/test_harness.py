"""The harness of benchmarks: cases, rows, limits and the command of a study."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from drivers.errors import InputError
from rig.benchmark.harness import RESULTS, Cell, Report, Run, Study, column, table_of
from rig.benchmark.measured import at_most
from rig.cli.benchmark import STUDIES, benchmark, command_of
from rig.declared import option


@dataclass(frozen=True, slots=True)
class Square:
    """A row."""

    number: int = column("number")
    square: float | None = column("its square", ".1f", "of the number")
    parity: str = ""


@dataclass(frozen=True, slots=True)
class SquareOptions:
    """Options of the study."""

    count: int = option(3, "Numbers.", min=1)
    limit: float = option(100.0, "Largest square.")


def square(number: int) -> Square:
    if number == 5:
        raise InputError("5 has no square here")
    return Square(number, float(number**2), "even" if number % 2 == 0 else "odd")


def measure(options: SquareOptions, run: Run) -> Report:
    """Square numbers."""
    rows = run.each(square, range(options.count), stored=Square)
    table = table_of("Squares", rows)
    limits = (at_most("largest square", max(row.square or 0.0 for row in rows), options.limit),)
    files: dict[str, str | bytes] = {"count.txt": str(len(rows)), "count.bin": bytes([len(rows)])}
    return Report((table,), limits, "squares", section=table.markdown(), files=files)


STUDY = Study("squares", SquareOptions, measure, "numbers", ("out", "resume", "readme", "jobs", "seed"))


def test_table_shows_declared_columns_only() -> None:
    table = table_of("Squares", [square(2), Square(3, None)])
    assert table.columns == ("number", "its square")
    assert table.rows == [("2", "4.0"), ("3", "-")]
    assert table.legend == (("its square", "of the number"),)
    assert table_of("Squares", [Square(3, None)]).rows == [("3", "-")]
    assert table.markdown().splitlines()[0] == "| number | its square |"


def test_row_of_cells_contains_dataclasses_and_optional_columns() -> None:
    def row(root: float | None) -> list[Cell]:
        more = Cell("more", root, "root", ".1f", optional=True)
        return [Cell("pair", (1.0, 2.0), "pair", ".1f"), more, Cell("of", square(2)), Cell("n", 7, None)]

    table = table_of("Squares", [row(None), row(2.0)])
    assert table.columns == ("pair", "root", "number", "its square")
    assert table.rows == [("1.0, 2.0", "-", "2", "4.0"), ("1.0, 2.0", "2.0", "2", "4.0")]
    assert table.records[0] == {"pair": (1.0, 2.0), "more": None, "of": square(2), "n": 7}
    assert table_of("Squares", [row(None)]).columns == ("pair", "number", "its square")


@pytest.mark.heavy
@pytest.mark.parametrize("jobs", [1, 2])
def test_results_have_the_order_of_the_cases(jobs: int) -> None:
    assert [row.number for row in Run(jobs=jobs).each(square, [3, 1, 2])] == [3, 1, 2]


def test_interrupted_run_resumes_with_missing_cases(tmp_path: Path) -> None:
    run = Run(jobs=1, folder=tmp_path)
    with pytest.raises(InputError, match="no square"):
        run.each(square, [1, 2, 5], stored=Square)
    with (tmp_path / RESULTS).open("ab") as file:
        file.write(b'{"case": "torn')
    done: list[str] = []
    again = replace(run, resume=True, progress=lambda *of: done.append(of[2]))
    assert again.each(square, [1, 2, 3], stored=Square) == [square(1), square(2), square(3)]
    assert done == ["3"]


def test_results_of_other_runs_are_not_overwritten_or_continued(tmp_path: Path) -> None:
    run = Run(jobs=1, folder=tmp_path, resume=True)
    run.each(square, [1], lambda number: f"seed 0, {number}", Square, common="seed 0, ")
    with pytest.raises(InputError, match="holds 1 result; continue with --resume"):
        Run(jobs=1, folder=tmp_path).each(square, [1], stored=Square)
    with pytest.raises(InputError, match=r"'seed 0, 1'.*'seed 1, '; continue with the options"):
        run.each(square, [1], lambda number: f"seed 1, {number}", Square, common="seed 1, ")
    (tmp_path / RESULTS).write_text('{"case": "1", "result": {"number": 1, "root": 1.0}}\n')
    with pytest.raises(InputError, match=r"another command or version .*; give another folder"):
        run.each(square, [1], stored=Square)
    (tmp_path / "old.jsonl").touch()
    with pytest.raises(InputError, match=r"old\.jsonl, written by .* an older version; give another folder"):
        run.each(square, [1], stored=Square)


def test_finished_case_is_passed_on_before_it_is_stored(tmp_path: Path) -> None:
    notes: list[str] = []

    def finish(number: int, result: Square) -> str:
        stored = (tmp_path / RESULTS).read_text() if (tmp_path / RESULTS).exists() else ""
        return f"{number}: {result.square:g}, {len(stored.splitlines())} before"

    run = Run(jobs=1, folder=tmp_path, progress=lambda *of: notes.append(of[2]))
    run.each(square, [2, 3], stored=Square, finish=finish)
    assert notes == ["2: 4, 0 before", "3: 9, 1 before"]


def run_command(*arguments: str, **changes: object) -> Result:
    app = typer.Typer()
    app.command()(command_of(replace(STUDY, **changes)))  # type: ignore[arg-type]
    return CliRunner().invoke(app, [*arguments, "--jobs", "1"])


def test_command_prints_one_json_object_and_writes_files(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("<!-- rig benchmark squares: begin -->\nold\n<!-- rig benchmark squares: end -->\n")
    out = tmp_path / "out"
    result = run_command("--count", "2", "--json", "--out", str(out), "--readme", str(document))
    assert result.exit_code == 0, result.output
    values = json.loads(result.stdout)
    assert values["options"] == {"count": 2, "limit": 100.0}
    assert values["tables"][0]["rows"][1] == {"number": 1, "square": 1.0, "parity": "odd"}
    assert values["limits"][0]["met"] is True
    assert json.loads((out / "results.json").read_text()) == values
    assert (out / "count.txt").read_text() == "2"
    assert (out / "count.bin").read_bytes() == b"\x02"
    assert "| 1 | 1.0 |" in document.read_text()


def test_command_ends_with_exit_code_4_if_a_limit_is_missed_and_resumes_only_with_a_folder() -> None:
    result = run_command("--limit", "1")
    assert result.exit_code == 4
    assert "limit missed: largest square: 4, required at most 1" in result.stderr
    result = run_command("--resume", keeps_results=True)
    assert isinstance(result.exception, InputError)
    assert "--resume continues the run in --out: give its folder" in str(result.exception)


@pytest.mark.parametrize("name", STUDIES)
def test_listed_summary_is_the_first_line_of_the_help(name: str) -> None:
    result = CliRunner().invoke(benchmark, [name, "--help"])
    assert result.exit_code == 0
    assert " ".join(STUDIES[name].split()) in " ".join(result.output.split())
