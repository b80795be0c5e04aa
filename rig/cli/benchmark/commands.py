"""`rig benchmark`: what the rig does, measured, as tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from rig.cli.benchmark.calibration import calibration
from rig.cli.benchmark.clips import clips
from rig.cli.benchmark.estimators import estimators
from rig.cli.benchmark.safety import safety
from rig.cli.benchmark.segmentation import segmentation
from rig.cli.benchmark.trials import trials
from rig.cli.benchmark.wire import wire
from rig.cli.common import Exit, JsonOption, emit_json, say, session_folder

if TYPE_CHECKING:
    from rig.benchmark.wire.faults import FaultResult


class EstimatorsByDefault(TyperGroup):
    """`rig benchmark` is `rig benchmark estimators`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the default subcommand in front of options, and where there is nothing."""
        if not args or (args[0].startswith("-") and args[0] != "--help"):
            args = ["estimators", *args]
        return super().parse_args(ctx, args)


benchmark = typer.Typer(
    cls=EstimatorsByDefault,
    help="Measure what the rig does, and print it as tables. Without a command: estimators.",
)


benchmark.command("estimators")(estimators)
benchmark.command("wire")(wire)
benchmark.command("safety")(safety)
benchmark.command("calibration")(calibration)
benchmark.command("segmentation")(segmentation)
benchmark.command("trials")(trials)
benchmark.command("clips")(clips)


@benchmark.command("faults")
def faults(
    cases: Annotated[
        list[str] | None,
        typer.Option("--case", help="Only cases whose name contains this; repeat for more."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Session folder of the lifts.")] = None,
    json: JsonOption = False,
) -> None:
    """Let each device fail in mid-lift on the bench behind wires; print how the rig comes through.

    Runs in real time, about 25 s a case. Exit code 4 when a fault was not seen, not named, not
    made safe within a second, or the next lift did not run.

    Examples:
      rig benchmark faults

      rig benchmark faults --case arm --case "gripper: silent" --json

    """
    from drivers.errors import InputError
    from rig.benchmark.wire.fault_cases import CASES
    from rig.benchmark.wire.faults import run_faults

    wanted = tuple(c for c in CASES if not cases or any(text.lower() in c.name for text in cases))
    if not wanted:
        names = ", ".join(case.name for case in CASES)
        raise InputError(f"no case contains {' or '.join(cases or [])}; cases are: {names}")
    folder = session_folder(out, False, "faults")
    say(f"SIMULATED bench 'wire', {len(wanted)} faults in mid-lift, session {folder}")
    results = run_faults(folder, wanted, lambda result: say(f"  {result.case.name}: {_outcome(result)}"))
    if json:
        emit_json({"session": str(folder), "faults": [_plain(result) for result in results]})
    else:
        _print_table(results)
    if not all(result.passed for result in results):
        raise typer.Exit(Exit.LIMIT_MISSED)


def _outcome(result: "FaultResult") -> str:
    return "; then: ".join(result.faults) if result.faults else "no fault was noticed"


def _short(result: "FaultResult") -> str:
    """What failed, without the advice, and how the bench was left."""
    parts = []
    for fault in result.faults:
        text, _, left = fault.partition(" [")
        parts.append(f"{text.partition('; ')[0]} ({left.partition(' (')[0].rstrip(']') or 'nothing moved'})")
    return "; then: ".join(parts) or "no fault was noticed"


def _plain(result: "FaultResult") -> dict[str, object]:
    return {
        "fault": result.case.name,
        "detected_s": result.detected_s,
        "still_s": result.safe_s,
        "outcomes": result.faults,
        "recovered": result.recovered,
        "passed": result.passed,
    }


def _print_table(results: "list[FaultResult]") -> None:
    from rich.markup import escape
    from rich.table import Table

    from rig.cli.printing import table_console

    table = Table("fault in mid-lift", "detected, s", "then still, s", "outcome", "next lift", "")
    table.title = "SIMULATED bench 'wire': from the fault to the rig's stop, from there to standstill"
    for result in results:
        times = ["never" if t is None else f"{t:.3f}" for t in (result.detected_s, result.safe_s)]
        after = "done" if result.recovered else "not done"
        verdict = "passed" if result.passed else "FAILED"
        table.add_row(result.case.name, *times, escape(_short(result)), after, verdict)
    table_console(width=200).print(table)
