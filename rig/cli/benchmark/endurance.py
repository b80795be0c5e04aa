"""`rig benchmark endurance`: hold an object still for an hour in real time."""

from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.benchmark.studies import exit_if_missed
from rig.cli.common import JsonOption, emit_json, say

if TYPE_CHECKING:
    from rig.benchmark.wire.endurance import Minute


def endurance(
    hours: Annotated[float, typer.Option("--hours", min=0.01, max=100, help="How long, in real time.")] = 1.0,
    json: JsonOption = False,
) -> None:
    """Hold an object still over the wire protocols, in real time, and print the measurements per minute.

    All frames are recorded as in a lift, into a file per minute of about 0.3 GB in the folder for temporary
    files (TMPDIR), which is then deleted. Exit code 4 if a frame was dropped or its time jumped, if in any
    minute the 99th percentile of the time from capture to angle exceeded one frame period, if the angle
    changed by more than 0.3 degrees, or if memory, threads or open files grew.

    Examples:
      rig benchmark endurance

      rig benchmark endurance --hours 0.05 --json

    """
    from rig.benchmark.wire.endurance import judge_endurance, measure_endurance
    from rig.config import load_bench

    minutes = max(1, round(60.0 * hours))
    say(f"SIMULATED bench 'wire', {minutes} minutes in real time")
    told = measure_endurance(minutes, lambda number, minute: say(f"  {number}/{minutes} {_line(minute)}"))
    limits = judge_endurance(told, 1e3 / max(tactile.rate_hz for tactile in load_bench("wire").tactile))
    if json:
        from dataclasses import asdict

        figures = {"minutes": [asdict(m) for m in told], "limits": [asdict(limit) for limit in limits]}
        emit_json({"simulated": True, **figures})
    else:
        for limit in limits:
            value = "nothing to measure" if limit.value is None else f"{limit.value:.3g}"
            print(f"{limit.name}: {value} ({limit.asked})")
    exit_if_missed(limits)


def _line(minute: "Minute") -> str:
    return (
        f"{minute.frames} frames, {minute.dropped} dropped; angle after {minute.p50_ms:.1f} ms, 99 % "
        f"{minute.p99_ms:.1f} ms; at most {minute.wander_deg:.2f} deg off; "
        f"{minute.recorded_mb:.0f} MB recorded; {minute.memory_mb:.0f} MB, {minute.threads} threads, "
        f"{minute.files} files"
    )
