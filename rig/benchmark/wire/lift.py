"""A whole lift on the bench behind wires, in real time: frames lost, rates, and agreement.

What the fakes say that they served is held against what the recording holds, and the lift's
result against lifts of the same object on the simulated bench in this process, over several seeds.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from protocols.operator import Operator
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.experiments.trial import run_trial
from rig.live.feed import NOBODY, LiveFeed
from rig.live.phases import begin_phase
from rig.sessions.layout import TIMING
from rig.sessions.reading import recorded_frames
from rig.sessions.records import FinishedLift, finished
from rig.sessions.rows import read_finished_lifts, read_rows
from rig.sessions.timing import LIFT_TIMINGS, LatencyTimes
from rig.tactile.estimators import choose_estimator

TRUTHS_APART_DEG = 1.5
"""How far the same seed's true turns may be apart: creep and slip depend on when exactly things happen."""
SPREADS = 2.0
"""An error agrees when it is this many standard deviations from the mean over seeds, or nearer."""


@dataclass(frozen=True, slots=True)
class StreamCount:
    """Frames of one source between the first and the last that was recorded."""

    serial: str
    served: int
    recorded: int
    missing: int


@dataclass(frozen=True, slots=True)
class WireReport:
    """What a lift behind wires came to.

    state_hz: states a second that the arm's driver received; controller_core: share of a core that
    the fake controller used. latency: by serial, percentiles of the time from a frame's capture to its
    logged angle. row: the lift's. seeds: rows of the same lift in this process.
    """

    streams: tuple[StreamCount, ...]
    state_hz: float
    controller_core: float
    wall_s: float
    latency: dict[str, LatencyTimes]
    period_ms: float
    row: FinishedLift
    seeds: tuple[FinishedLift, ...]

    @property
    def errors_deg(self) -> list[float]:
        """Mean error over phase B of each seed's lift in this process."""
        return [row.re_b.mean_deg for row in self.seeds if row.re_b]

    @property
    def agrees(self) -> bool:
        """Whether the object did what it does in this process, and the error is within the seeds' spread.

        The first seed's lift is the same lift: its outcome has to be the same, its true turn nearly so.
        """
        same, own = self.seeds[0], self.row
        if own.outcome is not same.outcome or own.re_b is None or not self.errors_deg:
            return False
        if own.final_truth_deg is None or same.final_truth_deg is None:
            return False
        mean, spread = self.spread_deg
        near = abs(own.final_truth_deg - same.final_truth_deg) <= TRUTHS_APART_DEG
        return near and abs(own.re_b.mean_deg - mean) <= SPREADS * spread

    @property
    def spread_deg(self) -> tuple[float, float]:
        """Mean and standard deviation over the seeds of the mean error over phase B."""
        return float(np.mean(self.errors_deg)), float(np.std(self.errors_deg, ddof=1))

    @property
    def latest_ms(self) -> float:
        """The worse fingertip's 99th percentile from capture to logged angle, ms."""
        return max((self.latency[serial].p99_ms for serial in self.row.contact_area_px), default=np.inf)

    @property
    def complete(self) -> bool:
        """Whether every frame that was served is in the recording."""
        return not any(stream.missing for stream in self.streams)


def measure_wire(
    folder: Path,
    object_id: str,
    seeds: int = 20,
    live: LiveFeed = NOBODY,
    bench: BenchConfig | None = None,
) -> WireReport:
    """Do one lift behind wires, kept as a session in `folder`, and the seeds' lifts in this process.

    live: who looks on at the lift behind wires. bench: that bench, by default `wire`.
    """
    choice = choose_estimator()
    with started_fakes(bench or load_bench("wire")) as config:
        benches = _Counted(config)
        began = time.perf_counter()
        try:
            settings = TrialSettings(config, 0, choice)
            begin_phase("lifting over the wire in real time")
            run_trial(folder, settings, [object_id], 1, benches=benches, live=live)
        finally:
            benches.close()
        wall_s = time.perf_counter() - began
        status = fakes_control(config).call("status")
    row = read_finished_lifts(folder)[0]
    recording = folder / row.recording
    timing = next(t for t in read_rows(folder / TIMING, LIFT_TIMINGS) if t.number == row.number)
    streams = tuple(
        _counted(recording, serial, status["devices"][serial]["ranges"]) for serial in _serials(config)
    )
    controller_core = status["devices"]["arm"]["cpu_s"] / (status["now_ns"] / NS_PER_S)
    task = LiftTask(1, row.object, row.lift, row.attempt)
    fake = load_bench("fake")
    begin_phase(f"lifting with {seeds} seeds in this process")
    again = finished(attempt_lift(TrialSettings(fake, seed, choice), task).row for seed in range(seeds))
    period_ms = 1e3 / max(tactile.rate_hz for tactile in config.tactile)
    late = timing.capture_to_angle or {}
    return WireReport(streams, benches.state_hz, controller_core, wall_s, late, period_ms, row, tuple(again))


class _Counted(StandingBench):
    """The bench behind wires, with the arm's states counted over each lift."""

    def __init__(self, config: BenchConfig) -> None:
        super().__init__(config, ConsoleOperator(lambda _: True), "")
        self.state_hz = 0.0

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        with super().for_lift(seed, lift, attempt) as (bench, operator):
            before, began = _samples(bench), time.monotonic()
            yield bench, operator
            self.state_hz = (_samples(bench) - before) / (time.monotonic() - began)


def _samples(bench: Bench) -> int:
    return bench.arm.counters().get("samples", 0)


def _serials(config: BenchConfig) -> list[str]:
    return [*(tactile.serial for tactile in config.tactile), config.camera.serial]


def _counted(recording: Path, serial: str, ranges: list[list[int]]) -> StreamCount:
    recorded = [frame.sequence for frame in recorded_frames(recording, serial)]
    first, last = min(recorded), max(recorded)
    served = {n for low, high in ranges for n in range(max(low, first), min(high, last) + 1)}
    return StreamCount(serial, len(served), len(recorded), len(served - set(recorded)))
