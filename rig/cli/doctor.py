"""`rig doctor`: is the bench fit for a trial, and if not, what to do."""

from dataclasses import asdict, dataclass
from pathlib import Path

import typer

from rig.cli.common import Exit, emit_json, mark, say
from rig.cli.declared import option
from rig.cli.options import BenchOption, JsonOption
from rig.cli.places import folder_place


@dataclass(frozen=True, slots=True)
class DoctorOptions:
    """The bench, and how it is examined."""

    bench: BenchOption = "fake"
    seconds: float = option(3.0, "How long each rate is measured, s.", min=0.5, max=600)
    snapshot: Path | None = option(
        None, "Save one frame per camera and sensor in this folder.", callback=folder_place
    )
    disk: Path = option(Path(), "Where sessions go: the disk that is measured.")
    json: JsonOption = False


def doctor(options: DoctorOptions) -> None:
    """Look at every device of a bench and at this computer; nothing moves.

    Exit code 1 when something does not work; warnings alone are 0.

    Examples:
      rig doctor --bench my_bench.toml

      rig doctor --bench my_bench.toml --snapshot today --json

    """
    from rig.config import load_bench
    from rig.doctor.examination import examine
    from rig.doctor.printing import print_findings

    config = load_bench(options.bench)
    simulated = mark(config.simulated)
    say(f"{simulated}bench '{config.name}': looking, nothing moves ...")
    folder = Path(options.bench).resolve().parent
    findings = list(examine(config, folder, options.disk, options.seconds, options.snapshot))
    if options.json:
        emit_json(
            {"bench": config.name, "simulated": config.simulated, "findings": [asdict(f) for f in findings]}
        )
    else:
        print_findings(f"{simulated}bench '{config.name}'", findings)
    if any(finding.verdict == "failure" for finding in findings):
        raise typer.Exit(Exit.FAULT)
