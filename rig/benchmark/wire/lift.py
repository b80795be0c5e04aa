"""`rig benchmark wire`: a whole lift with the real drivers over the wire protocols, in real time.

The frames that the simulated devices served are compared with the recording, and the lift's result with lifts
of the same object on the simulated bench in this process, over several seeds.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from protocols.grasps import find_grasp_file
from protocols.operator import Operator
from rig.benchmark.harness import Report, Run, Study, column, table_of
from rig.benchmark.measured import Measured, at_least, at_most
from rig.benchmark.wire.campaign import WireBench, serve
from rig.config import BenchConfig, load_bench
from rig.declared import option
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.files import TIMING
from rig.sessions.reading import recorded_frames
from rig.sessions.records import LIFT_TIMINGS, Lift, accepted_lifts
from rig.sessions.rows import read_finished_lifts, read_rows
from rig.tactile.estimators import choose_estimator
from rig.terminal.screen import begin_phase

LEAST_STATE_HZ, MOST_CORE = 490.0, 0.25
TRUTHS_APART_DEG = 1.5
"""Largest difference of the same seed's true turns: creep and slip depend on the exact times of motions."""
SPREADS = 2.0  # largest difference of the error from its mean over the seeds, in standard deviations


@dataclass(frozen=True, slots=True)
class WireOptions:
    object_name: str = option("wrench", "Object id or name.", "--object")
    seeds: int = option(20, "Lifts in this process whose spread is printed.", min=20, max=100)


@dataclass(frozen=True, slots=True)
class StreamRow:
    """Frames of one source between the first and the last recorded one."""

    serial: str = column("source")
    served: int = column("served")
    recorded: int = column("recorded")
    missing: int = column("missing", doc="served, but not in the recording")
    median_ms: float = column("capture to log, ms: median", ".1f", "over phases B and C")
    p99_ms: float = column("99 %", ".1f", "percentile of the same")


@dataclass(frozen=True, slots=True)
class WireLift:
    streams: tuple[StreamRow, ...]
    state_hz: float  # rate at which the arm's driver received states
    controller_core: float  # share of a core that the simulated controller used
    wall_s: float
    row: Lift
    seeds: tuple[Lift, ...]  # rows of the same lift in this process

    @property
    def errors_deg(self) -> list[float]:
        return [row.re_b.mean_deg for row in self.seeds if row.re_b]

    @property
    def spread_deg(self) -> tuple[float, float]:
        return float(np.mean(self.errors_deg)), float(np.std(self.errors_deg, ddof=1))


def measure(options: WireOptions, run: Run) -> Report:
    """Do one lift over the wire protocols in real time; measure lost frames, rates and agreement.

    The lift is stored as a session in the folder of the results. The exit code is 4 in these cases: a frame
    that was sent is not in the recording; the arm's driver received fewer than 490 of 500 states per second;
    the simulated controller used more than a quarter of a core; or the result differs from that of the same
    lift in this process by more than the spread over seeds. Times are printed and not judged, because they
    depend on the load of the computer.

    Examples:
      rig benchmark wire
      rig benchmark wire --object spam --json
    """
    object_id = find_grasp_file(options.object_name).id
    lift = measure_wire(run.results_folder, object_id, options.seeds)
    row, same, (mean, spread) = lift.row, lift.seeds[0], lift.spread_deg
    error = f"{row.re_b.mean_deg:.2f} deg" if row.re_b else "none"
    notes = (
        f"arm states {lift.state_hz:.1f}/s of 500, fake controller {lift.controller_core:.2f} core, "
        f"{lift.wall_s:.1f} s",
        f"{row.outcome}, true turn {row.final_truth_deg or 0.0:.1f} deg; in this process {same.outcome}, "
        f"{same.final_truth_deg or 0.0:.1f} deg",
        f"mean error over phase B {error}; in this process {mean:.2f} ± {spread:.2f} deg over "
        f"{len(lift.errors_deg)} seeds",
    )
    return Report(
        tables=(table_of("SIMULATED bench 'wire': frames of one lift", lift.streams),),
        limits=judge_wire(lift),
        limits_of="the lift",
        notes=notes,
        figures={
            "outcome": row.outcome,
            "re_b_deg": row.re_b and row.re_b.mean_deg,
            "final_truth_deg": row.final_truth_deg,
            "seeds_re_b_deg": lift.errors_deg,
            "seeds_outcomes": [row.outcome for row in lift.seeds],
        },
    )


def judge_wire(lift: WireLift) -> tuple[Measured, ...]:
    row, same, (mean_deg, spread_deg) = lift.row, lift.seeds[0], lift.spread_deg
    turns = row.final_truth_deg, same.final_truth_deg
    turn_deg = None if turns[0] is None or turns[1] is None else abs(turns[0] - turns[1])
    error_deg = None if row.re_b is None else abs(row.re_b.mean_deg - mean_deg)
    return (
        at_most("frames served that are not in the recording", sum(of.missing for of in lift.streams), 0),
        at_least("states a second that the arm's driver received", lift.state_hz, LEAST_STATE_HZ),
        at_most("share of a core used by the simulated controller", lift.controller_core, MOST_CORE),
        at_most("outcomes other than that in this process", row.outcome is not same.outcome, 0),
        at_most("difference of the true turn from that in this process, deg", turn_deg, TRUTHS_APART_DEG),
        at_most("difference of the error from its mean over seeds, deg", error_deg, SPREADS * spread_deg),
    )


def measure_wire(folder: Path, object_id: str, seeds: int = 20, bench: BenchConfig | None = None) -> WireLift:
    """Do one lift over the wire protocols, stored in a folder, and the lifts of the seeds in this process."""
    choice = choose_estimator()
    with serve(_CountedBench, bench) as benches:
        began = time.perf_counter()
        begin_phase("lifting over the wire in real time")
        run_trial(folder, TrialSettings(benches.config, 0, choice), [object_id], 1, benches=benches)
        wall_s = time.perf_counter() - began
        status = benches.call("status")
    row = read_finished_lifts(folder)[0]
    begin_phase(f"lifting with {seeds} seeds in this process")
    fake, task = load_bench("fake"), LiftTask(1, row.object, row.lift, attempt=row.attempt)
    return WireLift(
        streams=_streams(folder, row, benches.config, status["devices"]),
        state_hz=benches.state_hz,
        controller_core=status["devices"]["arm"]["cpu_s"] / (status["now_ns"] / NS_PER_S),
        wall_s=wall_s,
        row=row,
        seeds=tuple(
            accepted_lifts(attempt_lift(TrialSettings(fake, seed, choice), task).row for seed in range(seeds))
        ),
    )


class _CountedBench(WireBench):
    """A bench that counts the states of its arm over each lift."""

    state_hz = 0.0

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        with super().for_lift(seed, lift, attempt) as (bench, operator):
            before, began_ns = bench.arm.counters().get("samples", 0), bench.clock.now_ns()
            yield bench, operator
            after = bench.arm.counters().get("samples", 0)
            self.state_hz = (after - before) / ((bench.clock.now_ns() - began_ns) / NS_PER_S)


def _streams(
    folder: Path, row: Lift, config: BenchConfig, devices: Mapping[str, Any]
) -> tuple[StreamRow, ...]:
    """Compare the recorded frames of each source with the ranges of frame numbers that its device served."""
    timings = read_rows(folder / TIMING, LIFT_TIMINGS)
    timing = next(of for of in timings if (of.number, of.attempt) == (row.number, row.attempt))
    rows = []
    for serial in (*(tactile.serial for tactile in config.tactile), config.require("camera").serial):
        recorded = [frame.sequence for frame in recorded_frames(folder / row.recording, serial)]
        first, last = min(recorded), max(recorded)
        ranges = devices[serial]["ranges"]
        served = {n for low, high in ranges for n in range(max(low, first), min(high, last) + 1)}
        late = (timing.capture_to_angle or {})[serial]
        missing = len(served - set(recorded))
        rows.append(StreamRow(serial, len(served), len(recorded), missing, late.p50_ms, late.p99_ms))
    return tuple(rows)


STUDY = Study("wire", WireOptions, measure, "lifts", shared=("out",), keeps_results=True)
