"""`rig benchmark`: measure the rig, and print the results as tables.

The commands are made from the studies (`rig.benchmark.harness.Study`).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from drivers.errors import InputError
from rig.cli.common import Exit, emit_json, report_faults, say
from rig.cli.helping import Commands, Group, as_command
from rig.cli.options import EngineOption, JsonOption, SeedOption
from rig.declared import file_place, folder_place, option, option_parameters, set_signature

if TYPE_CHECKING:
    from rig.benchmark.harness import Report, Study

STUDIES = {
    "estimators": "Measure run time and error of every estimator, on 45 lifts and on disturbed clips.",
    "clips": "Compare the angles of estimators with the labels of clips, real or simulated.",
    "reaction": "Lift the same SIMULATED objects without and with a reaction to slip, and compare.",
    "lifts": "Carry out SIMULATED lifts of several seeds; print errors and confidently wrong angles.",
    "segmentation": "Score the segmentation networks on SIMULATED objects and on real frames.",
    "wire": "Do one lift over the wire protocols in real time; measure lost frames, rates and agreement.",
    "safety": "Stop, kill or break a lift at random moments; print how the arm comes to rest.",
    "trials": "Score networks, angle methods, windows and the paper's rivals on the same SIMULATED lifts.",
}
"""First line of help by name. The study NAME is in `rig.benchmark.NAME`, or in a module of that package."""
MODULES = {
    **{name: f"{name}.study" for name in ("estimators", "clips")},
    "safety": "wire.safety",
    "wire": "wire.lift",
}


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
    engine: EngineOption = None
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
    from rig.benchmark.harness import Run, as_json, check_readme, write_section
    from rig.frames.masks import make_folder
    from rig.sessions.files import write_file, write_json
    from rig.sessions.session import default_folder
    from rig.terminal.progress import WorkProgress

    began = time.perf_counter()
    section = study.name
    if shared.readme is not None:
        section = study.section(options) if study.section else section
        check_readme(shared.readme, section)
    if study.keeps_results and shared.resume and shared.out is None:
        raise InputError("--resume continues the run in --out: give its folder with --out")
    folder = shared.out or (default_folder(study.name) if study.keeps_results else None)
    seed, place = f", seed {shared.seed}" if "seed" in study.shared else "", f", results in {folder}"
    say(f"{'SIMULATED ' * study.simulated}benchmark {study.name}{seed}{place if folder else ''}")
    with WorkProgress(0, study.cases) as progress:
        run = Run(shared.seed, shared.jobs, folder, shared.resume, progress.show, say, shared.engine)
        report = study.measure(options, run)
    wall_s = time.perf_counter() - began
    _print(report, wall_s, shared.json)
    result = as_json(study, options, run, report, wall_s)
    if folder is not None:
        make_folder(folder)
        write_json(folder / "results.json", result)
        for name, content in report.files.items():
            write_file(folder / name, content.encode() if isinstance(content, str) else content)
    if shared.readme is not None:
        write_section(shared.readme, section, report.section)
    if shared.json:
        emit_json(result)
    missed = [limit for limit in report.limits if limit.met is False]
    for limit in missed:
        value = "no value" if limit.value is None else limit.shown
        say(f"rig: limit missed: {limit.name}: {value}, required {limit.asked}")
    if missed:
        raise typer.Exit(Exit.LIMIT_MISSED)
    report_faults(report.faults.values())


def _print(report: "Report", wall_s: float, to_stderr: bool) -> None:
    from rig.benchmark.harness import limit_table
    from rig.terminal.tables import console_table, table_console

    console, explained = table_console(to_stderr), dict[str, str]()
    limits = [limit_table(report.limits, report.limits_of)] if report.limits else []
    for table in (*report.tables, *limits):
        console.print(console_table(table.columns, table.rows, range(table.left), table.title))
        explained |= table.legend
    legend = (f"{heading}: {meaning}" for heading, meaning in explained.items())
    for line in (*legend, *report.notes, f"{wall_s:.0f} s"):
        console.print(line, highlight=False)


def load_study(name: str) -> Any:
    """Return the command of a study. name: of its module in `rig.benchmark`, which is imported."""
    study = import_module(f"rig.benchmark.{name}").STUDY
    return as_command(study.name, command_of(study))


class Benchmarks(Group):
    """The group of benchmarks; `rig benchmark` alone runs `rig benchmark estimators`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, summary in STUDIES.items():
            self.announce(name, summary, partial(load_study, MODULES.get(name, name)))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the default subcommand if none is given."""
        if not ctx.resilient_parsing and (not args or (args[0].startswith("-") and args[0] != "--help")):
            args = ["estimators", *args]
        return super().parse_args(ctx, args)


benchmark = Commands(
    cls=Benchmarks, help="Measure the rig, and print the results as tables. Without a command: estimators."
)


@benchmark.callback()
def _group() -> None:
    """Make typer keep the group, which registers no commands: `Benchmarks` imports them on use."""
