"""`rig doctor`: is the bench fit for a trial, and if not, what to do."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import BenchOption, Exit, JsonOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.doctor.finding import Finding

COLOURS = {"good": "green", "warning": "yellow", "failure": "red", "note": "dim"}


def doctor(
    bench: BenchOption = "fake",
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.5, max=600, help="How long each rate is measured, s.")
    ] = 3.0,
    snapshot: Annotated[
        Path | None,
        typer.Option(
            "--snapshot", help="Save one frame per camera and sensor in this folder.", callback=folder_place
        ),
    ] = None,
    disk: Annotated[
        Path, typer.Option("--disk", help="Where sessions go: the disk that is measured.")
    ] = Path(),
    json: JsonOption = False,
) -> None:
    """Look at every device of a bench and at this computer; nothing moves.

    Exit code 1 when something does not work; warnings alone are 0.

    Examples:
      rig doctor --bench my_bench.toml

      rig doctor --bench my_bench.toml --snapshot today --json

    """
    from rig.config import load_bench
    from rig.doctor.examination import examine

    config = load_bench(bench)
    simulated = "SIMULATED " if config.simulated else ""
    say(f"{simulated}bench '{config.name}': looking, nothing moves ...")
    folder = Path(bench).resolve().parent
    findings = list(examine(config, folder, disk, seconds, snapshot))
    if json:
        emit_json(
            {"bench": config.name, "simulated": config.simulated, "findings": [_plain(f) for f in findings]}
        )
    else:
        _print_table(f"{simulated}bench '{config.name}'", findings)
    if any(finding.verdict == "failure" for finding in findings):
        raise typer.Exit(Exit.FAULT)


def _plain(finding: "Finding") -> dict[str, object]:
    from dataclasses import asdict

    return asdict(finding)


def _print_table(title: str, findings: "list[Finding]") -> None:
    from rich.table import Table
    from rich.text import Text

    from rig.cli.fitting import table_console

    table = Table("device", "check", "", "found", "what to do", title=title)
    for finding in findings:
        verdict = Text(finding.verdict, COLOURS[finding.verdict])
        table.add_row(finding.device, finding.check, verdict, finding.seen, finding.todo)
    table_console().print(table)
