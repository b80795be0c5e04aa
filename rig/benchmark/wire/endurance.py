"""`rig benchmark endurance`: hold an object still for an hour, in real time, over the wire protocols.

A long session must not drop frames, must report angles in time, must report the same angle for the same
contact, and its memory, threads and open files must not grow. Everything is recorded as in a lift, one file
per minute.
"""

import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from drivers.types import Pose
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.slip_trial import REFERENCE_S, SETTLE_S
from protocols.steps import approach, close_to_contact, open_and_rise, start_watching, tighten
from rig.bench.fakes_process import started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.harness import Report, Run, Study
from rig.benchmark.measured import Measured, at_least, at_most
from rig.benchmark.wire.still_contact import Minute, MinuteRecordings, StillContact
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import LiftTask, TrialSettings, plan_lift
from rig.tactile.estimators import choose_estimator

OBJECT = "t1"
MINUTE_S = 60.0
WANDER_DEG, GROWN_MB, ANSWERED = 0.3, 10.0, 0.95


@dataclass(frozen=True, slots=True)
class EnduranceOptions:
    """Options of `rig benchmark endurance`."""

    hours: Annotated[float, typer.Option("--hours", min=0.01, max=100, help="Duration, in real time.")] = 1.0


def measure(options: EnduranceOptions, run: Run) -> Report:
    """Hold an object still over the wire protocols, in real time, and print the measurements per minute.

    All frames are recorded as in a lift, into a file per minute of about 0.3 GB in the folder for temporary
    files (TMPDIR), which is then deleted. Exit code 4 if a frame was dropped or its time jumped, if in any
    minute the 99th percentile of the time from capture to angle exceeded one frame period, if the angle
    changed by more than 0.3 degrees, or if memory, threads or open files grew.

    Examples:
      rig benchmark endurance

      rig benchmark endurance --hours 0.05 --json

    """
    bench, count = load_bench("wire"), max(1, round(60.0 * options.hours))
    minutes = measure_endurance(count, lambda number, of: run.progress(number, count, str(of)), bench)
    limits = judge_endurance(minutes, 1e3 / max(tactile.rate_hz for tactile in bench.tactile))
    return Report((), limits, "the contact at rest", figures={"minutes": [asdict(of) for of in minutes]})


def judge_endurance(minutes: Sequence[Minute], period_ms: float) -> tuple[Measured, ...]:
    """Compare with the limits. period_ms: time between two frames of a fingertip, the largest latency."""
    first, last = minutes[0], minutes[-1]
    wander_deg = [minute.wander_deg for minute in minutes]
    return (
        at_most("frames dropped", sum(minute.dropped for minute in minutes), 0),
        at_most("frames whose time jumped", sum(minute.jumped for minute in minutes), 0),
        at_most("capture to angle, 99th percentile, ms", max(of.p99_ms for of in minutes), period_ms),
        at_most(
            "farthest angle from the first minute, deg",
            max(wander_deg) if np.isfinite(wander_deg).all() else None,
            WANDER_DEG,
        ),
        at_least("share of frames answered, worst minute", min(m.answered for m in minutes), ANSWERED),
        at_most("growth of memory since the first minute, MB", last.memory_mb - first.memory_mb, GROWN_MB),
        at_most("threads more than in the first minute", last.threads - first.threads, 0),
        at_most("open files more than in the first minute", last.files - first.files, 0),
    )


def measure_endurance(
    minutes: int,
    progress: Callable[[int, Minute], None],
    wanted: BenchConfig,
    minute_s: float = MINUTE_S,
) -> list[Minute]:
    """Grasp an object that stands on its support, as a lift does, and return the measurements of each minute.

    progress: called after each minute with its number, from 1, and its measurements. wanted: the bench whose
    fakes are reached over the wire protocols. minute_s: length of a "minute" in s; shorter in tests. Raises
    the device's error if a device fails, `RecordingError` if a recording cannot be written.
    """
    measured = []
    with (
        tempfile.TemporaryDirectory(prefix="endurance-") as folder,
        closing(MinuteRecordings(Path(folder))) as recordings,
        started_fakes(wanted) as config,
        closing(StandingBench(config, ConsoleOperator(lambda _: True), "")) as benches,
        benches.for_lift(0, "endurance") as (bench, operator),
    ):
        make_ready(bench, operator)
        settings = TrialSettings(config, 0, choose_estimator())
        plan = plan_lift(settings, LiftTask(1, OBJECT, 1), Pose(config.table.position_m))
        operator.place(plan.object_id, plan.object_name)
        observer = StillContact(config, bench.clock, recordings)
        with safe_end(bench):
            approach(bench, plan.base_T_grasp, plan.width_m, plan.object_name)
            pump = start_watching(bench, observer, REFERENCE_S)
            tighten(bench, pump, observer, close_to_contact(bench, pump, observer), plan.grip_steps)
            pump.run_for(SETTLE_S)
            observer.begin_minute()
            for number in range(1, minutes + 1):
                pump.run_for(minute_s)
                measured.append(observer.minute())
                progress(number, measured[-1])
            open_and_rise(bench, plan.base_T_grasp, plan.width_m, pump)
    return measured


STUDY = Study("endurance", EnduranceOptions, measure, "minutes", shared=())
