"""Serve the page of --watch.

Also --dry-run: read every device and show the plan; nothing is moved or stored.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from rig.cli.common import Exit, print_result, say
from rig.cli.options import WatchOptions
from rig.terminal.onlookers import observed_by, report_to
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.bench.plan import Plan
    from rig.config import BenchConfig
    from rig.live.feed import Listener


@contextmanager
def watched(
    context: typer.Context, options: WatchOptions, title: str, what: str, total: int, done: int = 0
) -> "Iterator[tuple[Listener, ...]]":
    """Serve the page if an option asks for it; yield the listeners of lifts and poses.

    title, what, total, done: see `rig.live.state.Progress`. The page is served until the command ends; it
    then shows the report. Raises `InputError`.
    """
    if not options.watch and options.watch_at is None:
        yield ()
        return
    from rig.live.watch import WatchPage, watch_address

    page = WatchPage(watch_address(options.watch_at), title, what, done, total)
    context.call_on_close(page.close)
    context.call_on_close(report_to(page.show_report))
    with observed_by(page.show_event):
        say(f"watch page: {page.address}")
        yield (page.listener,)


def dry_run(config: "BenchConfig", plan: "Plan", json: bool) -> None:
    """Read every device of the bench and print the readings and the plan.

    Always raises `typer.Exit`: with 1 if a device cannot be read, else with 2 if a step of the plan would be
    refused, else with 0.
    """
    from rig.bench.reading import read_devices
    from rig.bench.source import unconnected_bench

    begin_phase("reading the devices")
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
