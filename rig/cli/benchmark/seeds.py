"""`rig benchmark seeds`: the trial's lifts of many seeds."""

import os
from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import counted
from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.benchmark.tables import ReadmeOption, print_tables
from rig.cli.common import JobsOption, JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place

FEW, MANY = 2, 20


def seeds(
    full: Annotated[bool, typer.Option("--full", help=f"{MANY} seeds instead of {FEW}.")] = False,
    bench: Annotated[
        str, typer.Option("--bench", help="fake, hard, or the path of a bench file simulated in process.")
    ] = "fake",
    objects: Annotated[
        list[str] | None, typer.Option("--object", help="By id or name; repeat. Default: the trial's nine.")
    ] = None,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=100, help="Lifts of each object.")] = 5,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results.", callback=folder_place)
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the seeds that --out has not.")
    ] = False,
    readme: ReadmeOption = None,
    jobs: JobsOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Carry out SIMULATED trials of several seeds; print how far off and how confidently wrong they are.

    The estimator is slip, as it answers in the lifts. A trial of 45 lifts takes two minutes on two cores.
    Recordings are removed once they are scored. Exit code 4 when a limit was missed.

    Examples:
      rig benchmark seeds

      rig benchmark seeds --full --out seeds --resume

      rig benchmark seeds --bench hard --readme docs/estimators.md

    """
    from rig.benchmark.estimators.tables import limit_table
    from rig.benchmark.readme import check_readme, markdown_table, write_section
    from rig.benchmark.seeds.benchmark import as_json, run_seeds, table
    from rig.cli.printing import WorkProgress
    from rig.config.calibrations import load_calibrated_bench
    from rig.experiments.trial import resolve_objects
    from rig.sessions.session import default_folder

    config = load_calibrated_bench(bench, say)
    section = f"seeds {config.name}"
    if readme is not None:
        check_readme(readme, section)
    folder = out or default_folder("seeds")
    ids = resolve_objects(objects or [], config.objects)
    drawn = range(seed, seed + (MANY if full else FEW))
    say(f"SIMULATED bench '{config.name}', {counted(len(drawn), 'seed')} from {seed}, results in {folder}")
    with WorkProgress(0, "lifts") as progress:
        result = run_seeds(
            folder, config, drawn, jobs or os.cpu_count() or 1, resume, ids, lifts, progress.show
        )
    shown = table(result)
    print_tables((shown, limit_table(result.limits, "slip")), json, result.wall_s, 1)
    if readme is not None:
        write_section(readme, section, f"{shown.title}.\n\n{markdown_table(shown.columns, shown.rows)}")
    if json:
        emit_json({"out": str(folder), **as_json(result)})
    exit_where_missed(result.limits)
