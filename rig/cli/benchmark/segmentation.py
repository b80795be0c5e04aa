"""`rig benchmark segmentation`: networks and the classical mask against labels, and their run time."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import Exit, JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.benchmark.estimators.tables import BenchmarkTable
    from rig.benchmark.segmentation.benchmark import SegmentationReport


def segmentation(
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model",
            help="NAME=FILE: a network of rig train or rig model import beside the shipped ones, or instead "
            "(pspnet, deeplabv3plus, unetplusplus, ours); repeat for more.",
        ),
    ] = None,
    frames: Annotated[int, typer.Option("--frames", min=24, help="Simulated frames to score on.")] = 360,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Folder for results.json and the picture of the real frames.", callback=folder_place
        ),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Score the shipped networks on objects they never saw, and on nine real frames where they are.

    Prints the paper's Table II with the kept results of rig train --all, what is measured now, and the
    limits. Simulated figures are marked SIMULATED. Exit code 4 when a limit is missed.

    Examples:
      rig benchmark segmentation

      rig benchmark segmentation --frames 1000 --out segmentation --json

      rig benchmark segmentation --model unetplusplus=runs/unetplusplus_D_s3/model.onnx

    """
    from dataclasses import asdict

    from rig.benchmark.calibration.benchmark import data_folder
    from rig.benchmark.segmentation.benchmark import run_segmentation
    from rig.benchmark.segmentation.paper_table import trained_models
    from rig.benchmark.trials.benchmark import parse_models
    from rig.frames.masks import make_folder
    from rig.sessions.files import write_json

    models = parse_models(model or [])
    if out is not None:
        make_folder(out)
    report = run_segmentation(frames, seed, data_folder(), models, say)
    figures = {
        "passed": report.passed,
        "scores": [asdict(row) for row in report.scores],
        "times": [asdict(row) for row in report.times],
        "limits": [asdict(row) for row in report.limits],
        "table2": trained_models(),
    }
    if out is not None:
        write_json(out / "results.json", figures)
        _write_picture(report, out / "real_frames.png")
    _print(report, json)
    if json:
        emit_json(figures)
    if not report.passed:
        say("rig: a limit was missed: see the table")
        raise typer.Exit(Exit.LIMIT_MISSED)


def _write_picture(report: "SegmentationReport", path: Path) -> None:
    from drivers.images import encode_png
    from rig.benchmark.segmentation.panels import panels_picture
    from rig.sessions.files import write_file

    if report.panels is not None:
        write_file(path, encode_png(panels_picture(report.panels, report.masks)))


def _print(report: "SegmentationReport", to_stderr: bool) -> None:
    from rig.benchmark.estimators.tables import BenchmarkTable
    from rig.benchmark.segmentation.paper_table import score_table, table_two, time_table
    from rig.cli.fitting import table_console

    console = table_console(to_stderr)
    verdicts = {None: "", True: "met", False: "MISSED"}
    limits = [
        (row.name, "" if row.value is None else f"{row.value:.3g}", row.asked, verdicts[row.met])
        for row in report.limits
    ]
    for table in (
        table_two(),
        score_table(report),
        time_table(report),
        BenchmarkTable("Limits", ("limit", "value", "asked", ""), limits),
    ):
        console.print(_rich(table))


def _rich(table: "BenchmarkTable") -> object:
    from rich.table import Table as RichTable

    shown = RichTable(*table.columns, title=table.title)
    for row in table.rows:
        shown.add_row(*row)
    return shown
