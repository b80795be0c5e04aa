"""The table of `rig benchmark safety` in Markdown."""

from collections.abc import Sequence

from rig.benchmark.readme import markdown_table
from rig.benchmark.wire.safety import SafetyRun
from rig.benchmark.wire.safety_limits import COLUMNS, judge_runs, table_rows


def section(runs: Sequence[SafetyRun], seed: int) -> str:
    """Return the table with the limits under it."""
    what = "longest time (s) and way (mm) from the event to standstill"
    head = f"SIMULATED, {len(runs)} runs, seed {seed}: {what}, by stage of the lift."
    return "\n".join(
        [head, "", markdown_table(COLUMNS, table_rows(runs)), "", *(limit.line for limit in judge_runs(runs))]
    )
