"""`rig doctor`: is the bench fit for a trial, and if not, what to do."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import BenchOption, Exit, JsonOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.doctor.finding import Finding

COLOURS = {"failure": "red", "warning": "yellow", "note": "dim", "good": "green"}
"""By verdict, in the order in which findings are printed."""


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
        _print(f"{simulated}bench '{config.name}'", findings)
    if any(finding.verdict == "failure" for finding in findings):
        raise typer.Exit(Exit.FAULT)


def _plain(finding: "Finding") -> dict[str, object]:
    from dataclasses import asdict

    return asdict(finding)


def _print(bench: str, findings: "list[Finding]") -> None:
    """Print one line per check, failures first, then the verdict, then what to do."""
    from rich.text import Text

    from rig.cli.fitting import table_console

    console = table_console()
    devices, checks = (max(len(text) for text in texts) for texts in zip(*map(_name, findings), strict=True))
    order = list(COLOURS)
    for finding in sorted(findings, key=lambda each: order.index(each.verdict)):
        device, check = _name(finding)
        line = Text(f"{finding.verdict:7}", COLOURS[finding.verdict])
        line.append(f"  {device:{devices}}  {check:{checks}}  {finding.seen}", "default")
        line.truncate(console.width, overflow="ellipsis")
        console.print(line, no_wrap=True)
    console.print(Text(f"{bench}: {_verdict(findings)}", "bold"))
    cures: dict[str, list[str]] = {}
    for finding in findings:
        if finding.todo:
            whole = f"{finding.seen}; " if finding.verdict == "failure" else ""  # its line may be cut
            cures.setdefault(whole + finding.todo, []).append(" ".join(_name(finding)))
    for todo, where in cures.items():
        console.print(f"- {', '.join(where)}: {todo}", highlight=False)


def _name(finding: "Finding") -> tuple[str, str]:
    return finding.device, finding.check


def _verdict(findings: "list[Finding]") -> str:
    """Say whether a trial can run, and how many checks say otherwise."""
    counts = {kind: sum(each.verdict == kind for each in findings) for kind in ("failure", "warning")}
    amiss = ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n)
    if counts["failure"]:
        return f"not fit for a trial: {amiss}"
    return f"fit for a trial, with {amiss}" if amiss else "fit for a trial"
