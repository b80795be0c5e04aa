"""`rig benchmark trials`: the systems of the paper's Tables III and IV on the same simulated lifts."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.benchmark.trials.benchmark import TrialsResult


def trials(
    model: Annotated[
        list[str] | None,
        typer.Option(
            "--model",
            help="NAME=FILE: a network of rig train (pspnet, deeplabv3plus, unetplusplus, ours) or rig "
            "train-angle (anglenet, anglenet-on-test, toskov) beside the shipped ones; repeat for more.",
        ),
    ] = None,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=100, help="Lifts of each object.")] = 5,
    objects: Annotated[
        list[str] | None, typer.Option("--object", help="Only this object; repeat for more.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for results.json, trials.png, index.html and the lifts.",
            callback=folder_place,
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, max=64, help="Processes that record; default: cores.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Run networks, angle methods, windows and the paper's peers over the same SIMULATED lifts.

    One fingertip at 30 frames per second over phase B, as the paper compares. A network that was not
    trained yet says so, with the command that trains it. A run that was interrupted goes on with --out.
    At most 20 minutes on 2 cores with all nine objects and five lifts of each.

    Examples:
      rig benchmark trials --out trials

      rig benchmark trials --lifts 1 --object t3 --out quick --json

      rig benchmark trials --model unetplusplus=runs/unetplusplus_D_s3/model.onnx

      rig benchmark trials --out trials --model anglenet-on-test=runs/anglenet-on-test/model.onnx

    """
    from rig.benchmark.estimators.files import check_writable
    from rig.benchmark.trials.benchmark import TrialsSettings, as_json, parse_models, run_trials
    from rig.benchmark.trials.files import write_trials
    from rig.cli.benchmark.estimators import Parts
    from rig.experiments.trial import resolve_objects
    from rig.sessions.session import default_folder

    folder = out or default_folder("trials")
    chosen, models = tuple(resolve_objects(objects)), parse_models(model or [])
    check_writable(folder, None)
    settings = TrialsSettings(folder, seed, jobs or max(1, os.cpu_count() or 1), lifts, chosen, models)
    say(f"SIMULATED: benchmark of the paper's systems, seed {seed}, results in {folder}")
    with Parts() as parts:
        result = run_trials(settings, parts)
    write_trials(folder, result)
    _print(result, json)
    if json:
        emit_json({"out": str(folder), **as_json(result)})


def _print(result: "TrialsResult", to_stderr: bool) -> None:
    from rich.table import Table as RichTable

    from rig.benchmark.trials.paper_tables import notes, table_four, table_three
    from rig.cli.fitting import table_console

    console = table_console(to_stderr)
    for table in (table_three(result), table_four(result)):
        shown = RichTable(*table.columns, title=table.title)
        for row in table.rows:
            shown.add_row(*row)
        console.print(shown)
    for note in notes(result):
        console.print(note, highlight=False)
    console.print(f"{result.wall_s / 60.0:.1f} minutes", highlight=False)
