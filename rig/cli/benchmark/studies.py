"""The command of a benchmark that is declared as a `rig.benchmark.harness.Study`."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rig.cli.benchmark.tables import ReadmeOption, say_faults
from rig.cli.common import Exit, JobsOption, JsonOption, SeedOption, emit_json, say, session_folder
from rig.cli.declared import option_parameters, set_signature
from rig.cli.places import file_place, folder_place

if TYPE_CHECKING:
    from rig.benchmark.harness import Report, Study
    from rig.benchmark.measured import Measured


@dataclass(frozen=True, slots=True)
class SharedOptions:
    """Options that most studies have; a study names those it has in `Study.shared`."""

    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the results.", callback=folder_place)
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue with the cases that are missing in --out.")
    ] = False
    readme: ReadmeOption = None
    jobs: JobsOption = None
    seed: SeedOption = 0


def command_of(study: "Study[Any]") -> Callable[..., None]:
    """Return a study's command, for typer."""
    own = [each.name for each in fields(study.options)]
    shared = [each for each in option_parameters(SharedOptions) if each.name in study.shared]

    def command(json: bool, **values: Any) -> None:
        options = study.options(**{name: values.pop(name) for name in own})
        _carry_out(study, options, SharedOptions(**values), json)

    set_signature(command, [*option_parameters(study.options), *shared, *_JSON])
    command.__name__, command.__doc__ = study.name, study.measure.__doc__
    return command


@dataclass(frozen=True, slots=True)
class _JsonOptions:
    json: JsonOption = False


_JSON = option_parameters(_JsonOptions)


def _carry_out(study: "Study[Any]", options: Any, shared: SharedOptions, json: bool) -> None:
    from rig.benchmark.harness import Run, as_json
    from rig.benchmark.readme import check_readme, write_section
    from rig.cli.printing import WorkProgress

    began = time.perf_counter()
    section = study.name
    for name in study.written:
        file_place(getattr(options, name))
    if shared.readme is not None:
        section = study.section(options) if study.section else section
        check_readme(shared.readme, section)
    folder = session_folder(shared.out, shared.resume, study.name) if study.keeps_results else shared.out
    say(_first_line(study, shared, folder))
    with WorkProgress(0, study.cases) as progress:
        run = Run(shared.seed, shared.jobs, folder, shared.resume, progress.show, say)
        report = study.measure(options, run)
    wall_s = time.perf_counter() - began
    _print(report, wall_s, json)
    result = as_json(study, options, run, report, wall_s)
    if folder is not None:
        _write(folder, report, result)
    if shared.readme is not None:
        write_section(shared.readme, section, report.section)
    if json:
        emit_json(result)
    exit_if_missed(report.limits)


def _first_line(study: "Study[Any]", shared: SharedOptions, folder: Path | None) -> str:
    parts = [f"{'SIMULATED ' if study.simulated else ''}benchmark {study.name}"]
    parts += [f"seed {shared.seed}"] if "seed" in study.shared else []
    return ", ".join([*parts, *([f"results in {folder}"] if folder else [])])


def _print(report: "Report", wall_s: float, to_stderr: bool) -> None:
    from rig.benchmark.harness import limit_table
    from rig.cli.fitting import table_console
    from rig.cli.printing import console_table

    console = table_console(to_stderr)
    limits = [limit_table(report.limits, report.limits_of)] if report.limits else []
    for table in (*report.tables, *limits):
        console.print(console_table(table.columns, table.rows, table.left, table.title))
    for note in (*report.notes, f"{wall_s:.0f} s"):
        console.print(note, highlight=False)
    say_faults(report.faults)


def _write(folder: Path, report: "Report", result: dict[str, Any]) -> None:
    from rig.frames.masks import make_folder
    from rig.sessions.files import write_file, write_json

    make_folder(folder)
    write_json(folder / "results.json", result)
    for name, content in report.files.items():
        write_file(folder / name, content.encode() if isinstance(content, str) else content)


def exit_if_missed(limits: "Iterable[Measured]") -> None:
    """Name every limit that was missed; if there is any, end the command with its exit code."""
    missed = [limit for limit in limits if limit.met is False]
    for limit in missed:
        value = "nothing to measure" if limit.value is None else f"{limit.value:.3g}"
        say(f"rig: limit missed: {limit.name}: {value}, asked {limit.asked}")
    if missed:
        raise typer.Exit(Exit.LIMIT_MISSED)
