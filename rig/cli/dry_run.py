"""`--dry-run`: read every device and show the plan, without moving or storing anything."""

from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from rig.cli.common import Exit, print_result, say

if TYPE_CHECKING:
    from rig.bench.plan import Plan
    from rig.config import BenchConfig


def dry_run(config: "BenchConfig", plan: "Plan", json: bool) -> None:
    """Read every device of the bench and print the readings and the plan.

    Always raises `typer.Exit`: with 1 if a device cannot be read, else with 2 if a step of the plan would be
    refused, else with 0.
    """
    from rig.bench.reading import read_devices
    from rig.bench.source import unconnected_bench

    with unconnected_bench(config) as bench:
        readings = read_devices(bench)
    silent = [reading for reading in readings if reading.problem]
    figures = {
        "dry_run": True,
        "bench": config.name,
        "simulated": config.simulated,
        "devices": [asdict(reading) for reading in readings],
        "plan": list(plan.lines),
        "refused": list(plan.refused),
    }
    read = [f"  {reading.problem or f'{reading.device}: {reading.seen}'}" for reading in readings]
    print_result(json, figures, "Devices (only read):", *read, plan.text())
    say("dry run: nothing was moved or stored")
    raise typer.Exit(Exit.FAULT if silent else Exit.USAGE if plan.refused else Exit.DONE)
