"""Make the command of a benchmark from its `rig.benchmark.harness.Study`."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from drivers.errors import InputError
from rig.cli.common import Exit, emit_json, report_faults, say
from rig.cli.declared import file_place, folder_place, option, option_parameters, set_signature
from rig.cli.options import JsonOption, SeedOption

if TYPE_CHECKING:
    from rig.benchmark.harness import Report, Study
    from rig.benchmark.measured import Measured


@dataclass(frozen=True, slots=True)
class SharedOptions:
    """Options that most studies share. Every study has --json; `Study.shared` names the others it has."""

    out: Path | None = option(None, "Folder for the results.", callback=folder_place)
    resume: bool = option(False, "Continue the run in --out: do only the cases that are missing.")
    readme: Path | None = option(
        None,
        "Also write the table into this file, between the comments that mark it, as in docs/measurements.md.",
        callback=file_place,
    )
    jobs: int | None = option(None, "Lifts in parallel. Default: one per core.", min=1, max=64)
    seed: SeedOption = 0
    json: JsonOption = False


def command_of(study: "Study[Any]") -> Callable[..., None]:
    """Return the command of a study, for typer."""
    own = [each.name for each in fields(study.options)]
    shared = [each for each in option_parameters(SharedOptions) if each.name in (*study.shared, "json")]

    def command(**values: Any) -> None:
        options = study.options(**{name: values.pop(name) for name in own})
        _carry_out(study, options, SharedOptions(**values))

    set_signature(command, [*option_parameters(study.options), *shared])
    command.__name__, command.__doc__ = study.name, study.measure.__doc__
    return command


def _carry_out(study: "Study[Any]", options: Any, shared: SharedOptions) -> None:
    from rig.benchmark.harness import Run, as_json
    from rig.benchmark.measured import check_readme, write_section
    from rig.live.terminal import WorkProgress

    began = time.perf_counter()
    section = study.name
    if shared.readme is not None:
        section = study.section(options) if study.section else section
        check_readme(shared.readme, section)
    folder = _folder(study, shared)
    say(_first_line(study, shared, folder))
    with WorkProgress(0, study.cases) as progress:
        run = Run(shared.seed, shared.jobs, folder, shared.resume, progress.show, say)
        report = study.measure(options, run)
    wall_s = time.perf_counter() - began
    _print(report, wall_s, shared.json)
    result = as_json(study, options, run, report, wall_s)
    if folder is not None:
        _write(folder, report, result)
    if shared.readme is not None:
        write_section(shared.readme, section, report.section)
    if shared.json:
        emit_json(result)
    if report.binding:
        exit_if_missed(report.limits)
    report_faults(report.faults.values())


def _folder(study: "Study[Any]", shared: SharedOptions) -> Path | None:
    """Return the folder of the results, or None. Raises `InputError` for --resume without --out."""
    from rig.sessions.session import default_folder

    if study.keeps_results and shared.resume and shared.out is None:
        raise InputError("--resume continues the run in --out: give its folder with --out")
    return shared.out or (default_folder(study.name) if study.keeps_results else None)


def _first_line(study: "Study[Any]", shared: SharedOptions, folder: Path | None) -> str:
    parts = [f"{'SIMULATED ' if study.simulated else ''}benchmark {study.name}"]
    parts += [f"seed {shared.seed}"] if "seed" in study.shared else []
    return ", ".join([*parts, *([f"results in {folder}"] if folder else [])])


def _print(report: "Report", wall_s: float, to_stderr: bool) -> None:
    from rig.benchmark.harness import limit_table
    from rig.live.tables import console_table, table_console

    console = table_console(to_stderr)
    limits = [limit_table(report.limits, report.limits_of)] if report.limits else []
    explained: dict[str, str] = {}
    for table in (*report.tables, *limits):
        console.print(console_table(table.columns, table.rows, range(table.left), table.title))
        explained |= table.legend
    for heading, meaning in explained.items():
        console.print(f"{heading}: {meaning}", highlight=False)
    for note in (*report.notes, f"{wall_s:.0f} s"):
        console.print(note, highlight=False)


def _write(folder: Path, report: "Report", result: dict[str, Any]) -> None:
    from rig.frames.masks import make_folder
    from rig.sessions.files import write_file, write_json

    make_folder(folder)
    write_json(folder / "results.json", result)
    for name, content in report.files.items():
        write_file(folder / name, content.encode() if isinstance(content, str) else content)


def exit_if_missed(limits: "Iterable[Measured]") -> None:
    """Print every missed limit; if there is one, end the command with exit code 4."""
    missed = [limit for limit in limits if limit.met is False]
    for limit in missed:
        value = "no value" if limit.value is None else limit.shown
        say(f"rig: limit missed: {limit.name}: {value}, required {limit.asked}")
    if missed:
        raise typer.Exit(Exit.LIMIT_MISSED)
