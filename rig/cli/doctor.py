"""`rig doctor`: check whether a bench is ready for a trial, and print what to do if not."""

from dataclasses import asdict, dataclass
from pathlib import Path

import typer

from rig.cli.common import Exit, emit_json, mark, say
from rig.cli.options import BenchOption, JsonOption
from rig.declared import folder_place, option


@dataclass(frozen=True, slots=True)
class DoctorOptions:
    bench: BenchOption = "fake"
    seconds: float = option(3.0, "Time over which each frame rate is measured, s.", min=0.5, max=600)
    snapshot: Path | None = option(
        None, "Also save one frame per camera and sensor in this folder.", callback=folder_place
    )
    disk: Path = option(
        Path(), "Folder of the sessions, whose disk is measured. Default: the current folder."
    )
    json: JsonOption = False


def doctor(options: DoctorOptions) -> None:
    """Check every device of a bench and this computer. Nothing moves.

    The exit code is 1 if a check fails, and 0 if there are only warnings.

    Examples:
      rig doctor --bench my_bench.toml
      rig doctor --bench my_bench.toml --snapshot today --json
    """
    from rig.config import load_bench
    from rig.doctor.examination import examine
    from rig.doctor.finding import print_findings, verdict_on

    config = load_bench(options.bench)
    simulated = mark(config.simulated)
    say(f"{simulated}bench '{config.name}': checking, nothing moves ...")
    folder = Path(options.bench).resolve().parent
    findings = list(examine(config, folder, options.disk, options.seconds, options.snapshot))
    if options.json:
        emit_json(
            {"bench": config.name, "simulated": config.simulated, "findings": [asdict(f) for f in findings]}
        )
    else:
        print_findings(findings, f"{simulated}bench '{config.name}': {verdict_on(findings)}")
    if any(finding.failed for finding in findings):
        raise typer.Exit(Exit.FAULT)
