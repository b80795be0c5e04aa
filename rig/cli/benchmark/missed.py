"""How a benchmark ends that missed a limit."""

from collections.abc import Iterable

import typer

from rig.benchmark.measured import Measured
from rig.cli.common import Exit, say


def exit_where_missed(limits: Iterable[Measured]) -> None:
    """Name every limit that was missed, and end the command with its exit code where there is any."""
    missed = [limit for limit in limits if limit.met is False]
    for limit in missed:
        value = "nothing to measure" if limit.value is None else f"{limit.value:.3g}"
        say(f"rig: limit missed: {limit.name}: {value}, asked {limit.asked}")
    if missed:
        raise typer.Exit(Exit.LIMIT_MISSED)
