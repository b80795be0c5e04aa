"""Faults in mid-lift, one after the other, on the bench behind wires: seen, made safe, recovered from.

A trial in which the first attempt at each lift meets a fault while the object hangs in the
fingers, and the next attempt has to succeed after what a person at the bench would do. What the
rig claims is held against the simulated world: where its tool truly moved, and when.
"""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from drivers.errors import DeviceError
from drivers.interfaces import Arm, Motion
from drivers.types import ArmLimits, ArmState, Pose
from protocols.operator import Operator
from protocols.reaction import ReactionKind
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.benchmark.wire.fault_cases import CASES, FaultCase
from rig.benchmark.wire.moments import Moment, Stage, wait_for
from rig.benchmark.wire.true_track import dropped, read_track, standstill
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.records import FinishedLift, LiftRow
from rig.sessions.rows import read_usable_lifts
from rig.tactile.estimators import choose_estimator

SAFE_WITHIN_S = 1.0
LEAST_ATTEMPTS = 2
"""So often the next lift is tried once its case is mended, before it is given up."""
MID_LIFT = Moment(Stage.LIFT, 0.4)
IN_REACTION = Moment(Stage.HOLD, 0.03)
"""In a lift that reacts the arm first stands when it was stopped; the fingers are closing then."""
LATE = (Stage.HOLD, Stage.LOWER, Stage.RELEASE)
"""From here on a lift may be over before a device is missed."""


@dataclass(slots=True)
class FaultResult:
    """What came of a case.

    Monotonic times in ns: when the fault was injected, when the rig first told the arm to stop
    after it, when the simulated tool then stood still. stage: of the lift at the fault. dropped: whether
    the object fell. faults: outcomes of failed attempts. given_up: the next lift did not run although its
    case was mended. recovered: it ran. reacts: the lift reacts to slip, so that it goes on long enough to
    miss any device.
    """

    case: FaultCase
    moment: Moment = MID_LIFT
    stage: Stage | None = None
    dropped: bool = False
    injected_ns: int = 0
    detected_ns: int = 0
    still_ns: int = 0
    faults: list[str] = field(default_factory=list)
    given_up: bool = False
    recovered: bool = False
    reacts: bool = False

    @property
    def detected_s(self) -> float | None:
        """From the fault until the rig stopped the arm; None when it never did."""
        return (self.detected_ns - self.injected_ns) / NS_PER_S if self.detected_ns else None

    @property
    def safe_s(self) -> float | None:
        """From the rig's stop until the tool stood still."""
        return max(0, self.still_ns - self.detected_ns) / NS_PER_S if self.detected_ns else None

    @property
    def passed(self) -> bool:
        """Whether the fault was seen, named, made safe in time, and recovered from, and nothing fell."""
        if self.dropped or not self.recovered:
            return False
        if not self.faults:
            return self.stage in LATE and not self.reacts
        named = any(word.lower() in fault.lower() for fault in self.faults for word in self.case.named)
        return named and self.safe_s is not None and self.safe_s <= SAFE_WITHIN_S


class TimedArm(Arm):
    """An arm that notes when it was first told to stop."""

    def __init__(self, arm: Arm, stopped: Callable[[int], None]) -> None:
        self._arm = arm
        self._stopped = stopped

    @property
    def limits(self) -> ArmLimits:
        """Those of the arm."""
        return self._arm.limits

    def connect(self) -> None:
        """Connect the arm."""
        self._arm.connect()

    def disconnect(self) -> None:
        """Disconnect the arm."""
        self._arm.disconnect()

    def state(self) -> ArmState:
        """State of the arm."""
        return self._arm.state()

    def move_linear(self, base_T_tcp: Pose, speed_m_s: float, acceleration_m_s2: float) -> Motion:  # noqa: N803
        """Move the arm."""
        return self._arm.move_linear(base_T_tcp, speed_m_s, acceleration_m_s2)

    def stop(self) -> None:
        """Stop the arm, and note when."""
        self._stopped(time.monotonic_ns())
        self._arm.stop()

    def recover(self, confirm: Callable[[str], None]) -> None:
        """Recover the arm."""
        self._arm.recover(confirm)


class FaultyBench(StandingBench):
    """The bench behind wires, with a fault in the first attempt at each lift that comes to mid-lift.

    Lift n meets the n-th case. Between attempts somebody mends what the rig cannot.
    """

    def __init__(self, config: BenchConfig, results: list[FaultResult]) -> None:
        super().__init__(config, ConsoleOperator(lambda _: True), "")
        self._control = fakes_control(config)
        self._grasp_m = config.table.position_m[2]
        self._results = results

    def begin(self) -> None:
        """Mend what is left of the last case, as a person does before a trial goes on, then begin."""
        self._control.call("fault", device="all", kind="clear")
        super().begin()

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        """Give the bench, mended where the time has come, with the fault on its way."""
        result = self._results[int(lift.rpartition("/")[2]) - 1]
        if attempt == 0 or len(result.faults) >= result.case.mended_after:
            self._control.call("fault", device="all", kind="clear")
        with super().for_lift(seed, lift, attempt) as (bench, operator):
            if result.injected_ns:
                yield bench, operator
                return
            over = threading.Event()
            timed = replace(bench, arm=TimedArm(bench.arm, lambda now_ns: _note_stop(result, over, now_ns)))
            injector = threading.Thread(target=self._inject, args=(result, over), daemon=True)
            injector.start()
            try:
                yield timed, operator
            finally:
                over.set()
                injector.join()
                self._judge(result)

    def _inject(self, result: FaultResult, over: threading.Event) -> None:
        """Wait for the moment, then let it go wrong."""
        stage = wait_for(result.moment, self._grasp_m, lambda: self._control.call("world"), over.is_set)
        if stage is not None:
            result.stage, result.injected_ns = stage, time.monotonic_ns()
            for device, kind, arguments in result.case.injected:
                self._control.call("fault", device=device, kind=kind, **arguments)

    def _judge(self, result: FaultResult) -> None:
        """See by the simulated world when the tool stood still after the rig's stop, and what fell."""
        if result.injected_ns:
            track = read_track(self._control.call, result.injected_ns)
            result.still_ns = standstill(track, result.detected_ns or result.injected_ns).time_ns
            result.dropped = result.dropped or dropped(track, self._grasp_m)


def _note_stop(result: FaultResult, over: threading.Event, now_ns: int) -> None:
    """Note the first stop after the fault; after one before it, the fault waits for the next attempt.

    A lift that reacts stops the arm and goes on.
    """
    if not result.injected_ns:
        if not result.reacts:
            over.set()
    elif not result.detected_ns:
        result.detected_ns = now_ns


def run_faults(
    folder: Path,
    cases: Sequence[tuple[FaultCase, Moment]] = tuple((case, MID_LIFT) for case in CASES),
    progress: Callable[[FaultResult], None] = lambda result: None,
    bench: BenchConfig | None = None,
    react: ReactionKind = ReactionKind.NONE,
) -> list[FaultResult]:
    """Run cases, each at its moment, as a trial of as many lifts, kept in `folder`; return what came of each.

    bench: the bench behind wires, by default `wire`. react: what the lifts do about slip.
    Raises `DeviceError` unless each case's lift is whole on disk in the end.
    """
    reacts = react is not ReactionKind.NONE
    results = [FaultResult(case, moment, reacts=reacts) for case, moment in cases]
    attempts: list[FaultResult] = []

    def note(done: int, total: int, row: LiftRow) -> None:
        result = results[row.lift - 1]
        attempts.append(result)
        if isinstance(row, FinishedLift):
            result.recovered = bool(result.injected_ns) and not result.given_up
            progress(result)
        elif result.injected_ns:
            result.faults.append(row.fault)

    with (
        started_fakes(bench or load_bench("wire")) as config,
        closing(FaultyBench(config, results)) as benches,
    ):
        settings = TrialSettings(config, 0, choose_estimator(), react=react)
        run = partial(run_trial, folder, settings, ["t1"], len(cases), benches=benches, progress=note)
        _run_to_the_end(run, attempts)
    kept = read_usable_lifts(folder, checked=True).lifts
    if len(kept) != len(cases):
        raise DeviceError(f"faults: {len(kept)} of {len(cases)} finished lifts are whole on disk in {folder}")
    return results


def _run_to_the_end(run: Callable[..., object], attempts: list[FaultResult]) -> None:
    """Run the trial; where it ends after three faults in a row, resume it, as a person would.

    A case has failed where the attempts after its mending have. attempts: the cases of the attempts so far.
    Raises `DeviceError` where a lift fails again after that, and where none is tried.
    """
    while True:
        before = len(attempts)
        try:
            run(resume=bool(attempts))
            return
        except DeviceError:
            if len(attempts) == before or attempts[-1].given_up:
                raise
            case = attempts[-1]
            tried = sum(attempt is case for attempt in attempts) - case.case.mended_after
            case.given_up = tried >= LEAST_ATTEMPTS
