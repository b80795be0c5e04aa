"""Lifts over the wire protocols in which a device fails in mid-lift.

In the trial a fault occurs in the first attempt at each lift. Then the actions of a person at the bench are
simulated, and the next attempt has to succeed. The rig's reports are compared with the true motion of the
tool in the simulated world.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from drivers.errors import DeviceError
from drivers.interfaces import Arm
from protocols.operator import Operator
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.harness import column
from rig.benchmark.wire.fault_cases import FaultCase
from rig.benchmark.wire.world import Moment, Stage, bench_ns, dropped, read_track, standstill, wait_for
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.records import Lift
from rig.sessions.rows import read_usable_lifts
from rig.tactile.estimators import choose_estimator

SAFE_WITHIN_S = 1.0
LEAST_ATTEMPTS = 2
"""Number of attempts at the next lift after its case is mended, before it is given up."""
MID_LIFT = Moment(Stage.LIFT, 0.4)
LATE = (Stage.HOLD, Stage.LOWER, Stage.RELEASE)
"""Stages in which a lift may be over before a failed device is missed."""


@dataclass(slots=True)
class FaultyLift:
    """A lift with a fault.

    The times are of the bench's clock, in ns: of the fault, of the rig's first stop command to the arm after
    it, and of the simulated tool's standstill after that; 0 if it has not happened. stage: of the lift at the
    fault.
    dropped: whether the object fell. faults: outcomes of failed attempts. given_up: whether the next lift did
    not run although the fault had been repaired. recovered: whether it ran.
    """

    case: FaultCase
    stage: Stage | None = None
    dropped: bool = False
    injected_ns: int = 0
    detected_ns: int = 0
    still_ns: int = 0
    faults: list[str] = field(default_factory=list)
    given_up: bool = False
    recovered: bool = False

    @property
    def passed(self) -> bool:
        """Whether the fault was detected, named, made safe in time, and recovered from, and nothing fell."""
        if self.dropped or not self.recovered:
            return False
        if not self.faults:
            return self.stage in LATE
        named = any(word.lower() in fault.lower() for fault in self.faults for word in self.case.named)
        return named and 0 < self.detected_ns and self.still_ns - self.detected_ns <= SAFE_WITHIN_S * NS_PER_S


def _short(outcomes: Sequence[str]) -> str:
    """Return the failures, without advice, and the state in which the bench was left."""
    parts = []
    for outcome in outcomes:
        text, _, left = outcome.partition(" [")
        parts.append(f"{text.partition('; ')[0]} ({left.partition(' (')[0].rstrip(']') or 'nothing moved'})")
    return "; then: ".join(parts) or "no fault was noticed"


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.3f}"


@dataclass(frozen=True, slots=True)
class FaultRow:
    """Result of a fault.

    number: of its lift, from 1. stage: of the lift at the fault. outcomes: of the attempts that the fault
    ended; none if the lift was over before it was noticed.
    """

    number: int
    stage: Stage
    dropped: bool
    fault: str = column("fault in mid-lift")
    seen_s: float | None = column("detected, s", _seconds, "from the fault to the rig's stop")
    safe_s: float | None = column("then still, s", _seconds, "from the rig's stop to standstill")
    outcomes: tuple[str, ...] = column("outcome", _short)
    recovered: bool = column("next lift", lambda done: "done" if done else "not done")
    passed: bool = column("", lambda passed: "passed" if passed else "FAILED")


def row_of(number: int, lift: FaultyLift) -> FaultRow:
    """Return the stored row of a lift with a fault."""
    seen = bool(lift.detected_ns)
    return FaultRow(
        number=number,
        fault=lift.case.name,
        stage=lift.stage or MID_LIFT.stage,
        seen_s=(lift.detected_ns - lift.injected_ns) / NS_PER_S if seen else None,
        safe_s=max(0, lift.still_ns - lift.detected_ns) / NS_PER_S if seen else None,
        dropped=lift.dropped,
        outcomes=tuple(lift.faults),
        recovered=lift.recovered,
        passed=lift.passed,
    )


def run_faults(
    folder: Path,
    cases: Sequence[FaultCase],
    progress: Callable[[FaultRow], None] = lambda row: None,
    bench: BenchConfig | None = None,
) -> list[FaultRow]:
    """Run a trial with one lift per case, each with its fault in mid-lift, stored in `folder`.

    bench: whose fakes are started, by default `wire`. Raises `DeviceError` unless each case's lift is
    whole on disk in the end.
    """
    lifts = [FaultyLift(case) for case in cases]
    attempts: list[FaultyLift] = []

    def note(done: int, total: int, row: Lift) -> None:
        lift = lifts[row.lift - 1]
        attempts.append(lift)
        if row.accepted:
            lift.recovered = bool(lift.injected_ns) and not lift.given_up
            progress(row_of(row.lift, lift))
        elif lift.injected_ns and row.fault is not None:
            lift.faults.append(row.fault)

    with (
        started_fakes(bench or load_bench("wire")) as config,
        closing(_FaultyBench(config, lifts)) as benches,
    ):
        settings = TrialSettings(config, 0, choose_estimator())
        run = partial(run_trial, folder, settings, ["t1"], len(cases), benches=benches, progress=note)
        _run_to_the_end(run, attempts)
    kept = read_usable_lifts(folder, checked=True).lifts
    if len(kept) != len(cases):
        raise DeviceError(f"faults: {len(kept)} of {len(cases)} finished lifts are whole on disk in {folder}")
    return [row_of(number, lift) for number, lift in enumerate(lifts, start=1)]


def _run_to_the_end(run: Callable[..., object], attempts: list[FaultyLift]) -> None:
    """Run the trial; if it ends after three faults in a row, resume it, as a person would.

    A case has failed if the attempts after its mending have. attempts: the lifts of the attempts so far.
    Raises `DeviceError` if a lift fails again after that, and if no attempt is made.
    """
    while True:
        before = len(attempts)
        try:
            run(resume=bool(attempts))
            return
        except DeviceError:
            if len(attempts) == before or attempts[-1].given_up:
                raise
            lift = attempts[-1]
            mended = sum(attempt is lift for attempt in attempts) - lift.case.mended_after
            lift.given_up = mended >= LEAST_ATTEMPTS


class _FaultyBench(StandingBench):
    """A bench that injects a fault in the first attempt at each lift that reaches the moment of the fault.

    The nth case occurs in lift n. Between attempts a simulated person repairs faults that the rig cannot
    clear.
    """

    def __init__(self, config: BenchConfig, lifts: list[FaultyLift]) -> None:
        super().__init__(config, ConsoleOperator(lambda _: True), "")
        self._control = fakes_control(config)
        self._grasp_m = config.table.position_m[2]
        self._lifts = lifts

    def begin(self) -> None:
        """Clear the faults of the previous case, as a person does before a trial continues, then begin."""
        self._control.call("fault", device="all", kind="clear")
        super().begin()

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        """Yield the bench, mended if the time has come; inject the fault meanwhile."""
        faulty = self._lifts[int(lift.rpartition("/")[2]) - 1]
        if attempt == 0 or len(faulty.faults) >= faulty.case.mended_after:
            self._control.call("fault", device="all", kind="clear")
        with super().for_lift(seed, lift, attempt) as (bench, operator):
            if faulty.injected_ns:
                yield bench, operator
                return
            over = threading.Event()
            timed = _TimedArm(bench.arm, lambda: _note_stop(faulty, over, bench.clock.now_ns()))
            injector = threading.Thread(target=self._inject, args=(faulty, over), daemon=True)
            injector.start()
            try:
                yield replace(bench, arm=cast("Arm", timed)), operator
            finally:
                over.set()
                injector.join()
                self._judge(faulty)

    def _inject(self, lift: FaultyLift, over: threading.Event) -> None:
        """Wait for the moment, then inject the fault."""
        stage = wait_for(MID_LIFT, self._grasp_m, lambda: self._control.call("world"), over.is_set)
        if stage is not None:
            lift.stage, lift.injected_ns = stage, bench_ns(self._control.call)
            for device, kind, arguments in lift.case.injected:
                self._control.call("fault", device=device, kind=kind, **arguments)

    def _judge(self, lift: FaultyLift) -> None:
        """Read the time of standstill after the rig's stop, and whether the object fell, from the world."""
        if lift.injected_ns:
            track = read_track(self._control.call, lift.injected_ns)
            lift.still_ns = standstill(track, lift.detected_ns or lift.injected_ns).time_ns
            lift.dropped = lift.dropped or dropped(track, self._grasp_m)


class _TimedArm:
    """An arm that reports its stop commands."""

    def __init__(self, arm: Arm, stopped: Callable[[], None]) -> None:
        self._arm, self._stopped = arm, stopped

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arm, name)

    def stop(self) -> None:
        self._stopped()
        self._arm.stop()


def _note_stop(lift: FaultyLift, over: threading.Event, now_ns: int) -> None:
    """Note the first stop after the fault; after a stop before it, the fault waits for the next attempt."""
    if not lift.injected_ns:
        over.set()
    elif not lift.detected_ns:
        lift.detected_ns = now_ns
