"""`--dry-run`: every device reached by reading, the whole plan shown, and nothing moved or kept."""

from typing import TYPE_CHECKING

import typer

from rig.cli.common import Exit, emit_json, say

if TYPE_CHECKING:
    from rig.bench.plan import Plan
    from rig.config import BenchConfig


def dry_run(config: "BenchConfig", plan: "Plan", json: bool) -> None:
    """Show what would happen.

    Raises `typer.Exit`, with 1 where a device cannot be read, else 2 where something would be refused.
    """
    from rig.bench.reading import read_devices
    from rig.bench.source import unconnected_bench

    with unconnected_bench(config) as bench:
        readings = read_devices(bench)
    silent = [reading for reading in readings if reading.problem]
    if json:
        emit_json(
            {
                "dry_run": True,
                "bench": config.name,
                "simulated": config.simulated,
                "devices": [{"device": r.device, "seen": r.seen, "problem": r.problem} for r in readings],
                "plan": list(plan.lines),
                "refused": list(plan.refused),
            }
        )
    else:
        print("Devices, by reading alone:")
        for reading in readings:
            print(f"  {reading.problem or f'{reading.device}: {reading.seen}'}")
        print(plan.text())
    say("dry run: nothing was moved, nothing kept")
    raise typer.Exit(Exit.FAULT if silent else Exit.USAGE if plan.refused else Exit.DONE)
