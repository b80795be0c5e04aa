"""`rig benchmark faults`: each device fails in mid-lift over the wire protocols; the rig has to recover.

In the trial a fault occurs in the first attempt at each lift. Then the actions of a person at the bench are
simulated, and the next attempt has to succeed.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from drivers.bench import Bench
from drivers.clock import NS_PER_S
from drivers.errors import DeviceError, InputError
from drivers.interfaces import Arm
from protocols.operator import Operator
from rig.benchmark.harness import Cell, Report, Run, Study, table_of
from rig.benchmark.measured import at_most
from rig.benchmark.wire import campaign
from rig.benchmark.wire.campaign import Event, Stage, WireBench, fault, standstill, strike
from rig.config import BenchConfig, load_bench
from rig.declared import option
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.records import Lift
from rig.sessions.rows import read_usable_lifts
from rig.tactile.estimators import choose_estimator

SAFE_WITHIN_S = 1.0
LEAST_ATTEMPTS = 2  # number of attempts at the next lift after its case is mended, before it is given up
MID_LIFT_S = 0.4  # of the fault, after the beginning of the lift's rise
LATE = (Stage.HOLD, Stage.LOWER, Stage.RELEASE)
"""Stages in which a lift may be over before a failed device is missed."""


def _reconnect(name: str, kind: str) -> Event:
    """Return a fault of the arm that only shows when its sockets are opened again."""
    return Event(name, faults=(("arm", kind, {}), ("arm", "socket_dropped", {})), named="arm", mended_after=2)


CASES = (
    fault("arm: protective stop", "arm", "protective_stop", named="protective stop"),
    fault("arm: program killed", "arm", "program_killed", named="program"),
    fault("arm: stream frozen", "arm", "stream_frozen"),
    fault("arm: stream repeats itself", "arm", "stream_frozen", repeat=True),
    fault("arm: sockets dropped", "arm", "socket_dropped"),
    fault("arm: silent peer", "arm", "silent"),
    _reconnect("arm: remote control off, then reconnect", "remote_control_off"),
    _reconnect("arm: recipe refused at reconnect", "recipe_refused"),
    fault("gripper: silent", "gripper", "silent"),
    fault("gripper: connection closed", "gripper", "disconnect"),
    fault("gripper: power lost", "gripper", "power_lost"),
    fault("gripper: fault 0x0D", "gripper", "fault", named="0x0D", code=0x0D),
    fault("gripper: fingers blocked", "gripper", "blocked"),
    fault("gripper: fingers stuck, success reported", "gripper", "stuck"),
    fault("gripper: success and position reported falsely", "gripper", "false_success"),
    fault("gripper: fingers move too far", "gripper", "overshoot"),
    fault("gripper: fingers drift open without a command", "gripper", "drift", named="without a command"),
    fault("gripper: garbage", "gripper", "garbage"),
    fault("fingertip: frozen", "SIM-D0001", "freeze"),
    fault("fingertip: no frames", "SIM-D0001", "drop"),
    fault("fingertip: unplugged", "SIM-D0002", "disconnect"),
    fault("fingertip: green frames", "SIM-D0001", "green"),
    fault("fingertip: shifted frames", "SIM-D0001", "shift"),
    fault("fingertip: truncated frames", "SIM-D0001", "truncate"),
    fault("camera: frozen", "camera", "freeze", named="SIM-C0001"),
    fault("camera: unplugged", "camera", "disconnect", named="SIM-C0001"),
)


def _short(outcomes: Sequence[str]) -> str:
    """Return the failures, without advice, and the state in which the bench was left."""
    parts = []
    for outcome in outcomes:
        text, _, left = outcome.partition(" [")
        parts.append(f"{text.partition('; ')[0]} ({left.partition(' (')[0].rstrip(']') or 'nothing moved'})")
    return "; then: ".join(parts) or "no fault was noticed"


@dataclass(slots=True)
class FaultyLift:
    """A lift with a fault. number: of the lift, from 1.

    The times are of the bench's clock, in ns: of the fault, of the rig's first stop command to the arm after
    it, and of the simulated tool's standstill after that; 0 if it has not happened.
    """

    case: Event
    number: int = 1
    stage: Stage | None = None  # of the lift at the fault
    dropped: bool = False  # whether the object fell
    injected_ns: int = 0
    detected_ns: int = 0
    still_ns: int = 0
    faults: list[str] = field(default_factory=list)  # outcomes of failed attempts
    given_up: bool = False  # whether the next lift did not run although the fault had been repaired
    recovered: bool = False  # whether it ran

    @property
    def passed(self) -> bool:
        """Whether the fault was detected, named, made safe in time, and recovered from, and nothing fell."""
        if self.dropped or not self.recovered:
            return False
        if not self.faults:
            return self.stage in LATE
        named = any(self.case.named.lower() in fault.lower() for fault in self.faults)
        return named and 0 < self.detected_ns and self.still_ns - self.detected_ns <= SAFE_WITHIN_S * NS_PER_S

    def row(self) -> list[Cell]:
        def seconds(from_ns: int, until_ns: int) -> float | None:
            return max(0, until_ns - from_ns) / NS_PER_S if self.detected_ns else None

        def show(value: float | None) -> str:
            return "never" if value is None else f"{value:.3f}"

        seen_s, safe_s = seconds(self.injected_ns, self.detected_ns), seconds(self.detected_ns, self.still_ns)
        return [
            Cell("number", self.number, None),
            Cell("stage", self.stage or Stage.LIFT, None),
            Cell("dropped", self.dropped, None),
            Cell("fault", self.case.name, "fault in mid-lift"),
            Cell("seen_s", seen_s, "detected, s", show, "from the fault to the rig's stop"),
            Cell("safe_s", safe_s, "then still, s", show, "from the rig's stop to standstill"),
            Cell("outcomes", tuple(self.faults), "outcome", _short),  # of the attempts that the fault ended
            Cell("recovered", self.recovered, "next lift", lambda done: "done" if done else "not done"),
            Cell("passed", self.passed, "", lambda passed: "passed" if passed else "FAILED"),
        ]

    def note_stop(self, over: threading.Event, now_ns: int) -> None:
        """Note the first stop after the fault. After an earlier stop the fault waits for the next attempt."""
        if not self.injected_ns:
            over.set()
        elif not self.detected_ns:
            self.detected_ns = now_ns


def run_faults(
    folder: Path,
    cases: Sequence[Event],
    progress: Callable[[FaultyLift], None] = lambda lift: None,
    bench: BenchConfig | None = None,
) -> list[FaultyLift]:
    """Run a trial with one lift per case, each with its fault in mid-lift, stored in `folder`.

    bench: whose fakes are started, by default `wire`. Raises `DeviceError` unless each case's lift is
    whole on disk in the end.
    """
    lifts = [FaultyLift(case, number) for number, case in enumerate(cases, start=1)]
    attempts: list[FaultyLift] = []

    def note(done: int, total: int, row: Lift) -> None:
        lift = lifts[row.lift - 1]
        attempts.append(lift)
        if row.accepted:
            lift.recovered = bool(lift.injected_ns) and not lift.given_up
            progress(lift)
        elif lift.injected_ns and row.fault is not None:
            lift.faults.append(row.fault)

    with campaign.served(partial(_FaultyBench, lifts), bench) as benches:
        settings = TrialSettings(benches.config, 0, choose_estimator())
        run = partial(run_trial, folder, settings, ["t1"], len(cases), benches=benches, progress=note)
        run_to_the_end(run, attempts)
    kept = read_usable_lifts(folder, checked=True).lifts
    if len(kept) != len(cases):
        raise DeviceError(f"faults: {len(kept)} of {len(cases)} finished lifts are whole on disk in {folder}")
    return lifts


def run_to_the_end(run: Callable[..., object], attempts: list[FaultyLift]) -> None:
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


class _FaultyBench(WireBench):
    """A bench that injects a fault in the first attempt at each lift that reaches the moment of the fault.

    The nth case occurs in lift n. Between attempts a simulated person repairs faults that the rig cannot
    clear, and before a trial continues those of the previous case.
    """

    def __init__(self, lifts: list[FaultyLift], config: BenchConfig) -> None:
        super().__init__(config)
        self._lifts = lifts

    def begin(self) -> None:
        self.call("fault", device="all", kind="clear")
        super().begin()

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        faulty = self._lifts[int(lift.rpartition("/")[2]) - 1]
        if attempt == 0 or len(faulty.faults) >= faulty.case.mended_after:
            self.call("fault", device="all", kind="clear")
        with super().for_lift(seed, lift, attempt) as (bench, operator):
            if faulty.injected_ns:
                yield bench, operator
                return
            over = threading.Event()
            timed = _TimedArm(bench.arm, lambda: faulty.note_stop(over, bench.clock.now_ns()))

            def inject() -> None:
                stage = campaign.wait_for(Stage.LIFT, MID_LIFT_S, self.grasp_m, self.call, over.is_set)
                if stage is not None:
                    faulty.stage, faulty.injected_ns = stage, strike(faulty.case, self.call)

            injector = threading.Thread(target=inject, daemon=True)
            injector.start()
            try:
                yield replace(bench, arm=cast("Arm", timed)), operator
            finally:
                over.set()
                injector.join()
                if faulty.injected_ns:
                    track = campaign.read_track(self.call, faulty.injected_ns)
                    faulty.still_ns = standstill(track, faulty.detected_ns or faulty.injected_ns).time_ns
                    faulty.dropped = faulty.dropped or campaign.dropped(track, self.grasp_m)


class _TimedArm:
    def __init__(self, arm: Arm, stopped: Callable[[], None]) -> None:
        self._arm, self._stopped = arm, stopped

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arm, name)

    def stop(self) -> None:
        self._stopped()
        self._arm.stop()


@dataclass(frozen=True, slots=True)
class FaultsOptions:
    cases: list[str] | None = option(None, "Only cases whose name contains this; repeat for more.", "--case")
    bench: str = option("wire", "wire, or the path of a bench file whose \\[fakes] are started for it.")


def measure(options: FaultsOptions, run: Run) -> Report:
    """Let each device fail during a lift over the wire protocols; print how the rig recovers.

    The lifts run in real time, about 25 s per lift, and are stored as a session in the folder of the results.
    The exit code is 4 if a fault was not detected, not named or not made safe within a second, if an object
    was dropped, or if the next lift did not run.

    Examples:
      rig benchmark faults
      rig benchmark faults --case arm --case "gripper: silent" --json
      rig benchmark faults --bench slow.toml
    """
    bench = load_bench(options.bench)
    if bench.fakes is None or bench.fakes.control is not None:
        raise InputError(
            f"bench '{bench.name}': faults are injected into fakes that the benchmark starts itself; give a "
            "bench of real drivers with an empty [fakes] table, as wire"
        )
    wanted = [c for c in CASES if not options.cases or any(text.lower() in c.name for text in options.cases)]
    if not wanted:
        names = ", ".join(case.name for case in CASES)
        raise InputError(f"no case contains {' or '.join(options.cases or [])}; cases are: {names}")

    def show(lift: FaultyLift) -> None:
        text = "; then: ".join(lift.faults) or "no fault was noticed"
        run.progress(lift.number, len(wanted), f"{lift.case.name}: {text}")

    lifts = run_faults(run.results_folder, wanted, show, bench)
    title = f"SIMULATED bench '{bench.name}': from the fault to the rig's stop, from there to standstill"
    limits = (
        at_most("objects dropped", sum(lift.dropped for lift in lifts), 0),
        at_most("lifts after a fault that did not run", sum(not lift.recovered for lift in lifts), 0),
        at_most("faults not seen, not named or not made safe", sum(not lift.passed for lift in lifts), 0),
    )
    return Report((table_of(title, [lift.row() for lift in lifts], left=6),), limits, "the rig")


STUDY = Study("faults", FaultsOptions, measure, "faults", shared=("out",), keeps_results=True)
