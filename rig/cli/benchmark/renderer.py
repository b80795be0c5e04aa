"""`rig benchmark renderer`: estimators on lifts that another simulator drew."""

from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.benchmark.tables import print_tables, say_faults
from rig.cli.common import JobsOption, JsonOption, SeedOption, emit_json

if TYPE_CHECKING:
    from rig.benchmark.renderer.benchmark import RendererResult


def renderer(
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            help="Repeat for more, also your own as package.module:Class; limits are for the first. "
            "Default: slip.",
        ),
    ] = None,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=1000, help="How many are drawn.")] = 45,
    jobs: JobsOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Let estimators follow SIMULATED lifts of a second renderer, which shares nothing with the bench's.

    Its gel, lamps, faces and turns are its own, so what is tuned to one simulator shows here. Exit code 4
    when a limit of the first estimator was missed.

    Examples:
      rig benchmark renderer

      rig benchmark renderer --estimator slip --estimator ecc --lifts 16 --json

    """
    from rig.benchmark.renderer.benchmark import as_json, run_renderer
    from rig.cli.printing import WorkProgress

    with WorkProgress(0, "lifts") as progress:
        result = run_renderer(estimator or ["slip"], lifts, seed, jobs, progress.show)
    _print(result, json)
    if json:
        emit_json(as_json(result))
    exit_where_missed(result.limits)


def _print(result: "RendererResult", to_stderr: bool) -> None:
    from rig.benchmark.estimators.tables import limit_table
    from rig.benchmark.renderer.benchmark import lift_table

    tables = (lift_table(result), limit_table(result.limits, f"'{next(iter(result.lifts))}'"))
    print_tables(tables, to_stderr, result.wall_s)
    say_faults(result.faults)
