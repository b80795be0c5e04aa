"""Lifts on a simulated bench without images, and a person who presses Ctrl-C under a given condition."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

import pytest

from drivers.bench import Bench, Hand
from drivers.errors import DeviceError, OperatorStopError
from drivers.types import HandState, Holding, Pose
from fakes.clock import SimulatedClock
from fakes.faults import FaultScript
from learning_bench import LearningBench, build_learning_bench
from protocols.observer import LiftObserver, Phase
from protocols.slip_trial import LiftPlan, run_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings, plan_lift
from rig.tactile.estimators import choose_estimator
from support.benches import lighter
from support.finger_counts import counts_of

When = Callable[[], bool]
WATCHED_NS = 8_000_000


@dataclass
class Touching(LiftObserver):
    """An observer that reports contact from the force on the simulated fingers."""

    made: LearningBench
    phase_now: Phase | None = None

    def phase(self, phase: Phase, time_ns: int) -> None:
        self.phase_now = phase

    def touching(self, serial: str) -> bool:
        return self.made.force_n(self.made.bench.clock.now_ns()) > 0.2


class SwitchedFaults(FaultScript):
    """Faults of the gripper that a test switches on during a lift."""

    on: ClassVar[set[str]] = set()

    def active(self, kind: str, time_ns: int, *names: str) -> bool:
        return kind in self.on and "gripper" in names


@dataclass
class LiftOf:
    """A lift to execute, and a trace of the bench meanwhile."""

    made: LearningBench
    plan: LiftPlan
    observer: Touching
    trace: list[tuple[float, float, int, bool]] = field(default_factory=list)
    """x and z of the tool, m, counts of the fingers, and whether they press an object, every 8 ms."""
    interruptions: list[tuple[When, Exception]] = field(default_factory=list)
    interrupted_at: list[int] = field(default_factory=list)
    """Heights and positions in the trace."""
    kept: list[HandState] = field(default_factory=list)

    @property
    def bench(self) -> Bench:
        return self.made.bench

    @property
    def pose(self) -> Pose:
        """Position of the tool, from the world: the arm's state would also solve its joints, at ten times
        the cost."""
        return self.bench.arm._world.tool_pose_at(self.bench.clock.now_ns())  # type: ignore[attr-defined]

    @property
    def height_m(self) -> float:
        """Height of the tool over the grasp."""
        return self.pose.position_m[2] - self.plan.base_T_grasp.position_m[2]

    @property
    def counts(self) -> int:
        return counts_of(self.bench.gripper)

    @property
    def held(self) -> bool:
        return self.made.force_n(self.bench.clock.now_ns()) > 0.0

    def run(self) -> str:
        """Execute the lift; return the notes of its error, or "done"."""
        try:
            run_lift(self.bench, self.plan, self.observer)
        except (OperatorStopError, DeviceError) as error:
            return "; ".join(getattr(error, "__notes__", []))
        return "done"

    def break_gripper(self, kind: str) -> None:
        """Switch on one of the gripper faults in `fakes.faults.KINDS`."""
        SwitchedFaults.on.add(kind)

    def interrupt(self, when: When, by: Exception | None = None) -> None:
        """Send a signal (or start a fault) as soon as a condition holds."""
        self.interruptions.append((when, by or OperatorStopError("stopped")))

    def see(self) -> None:
        """Append to the trace, and interrupt if the time has come."""
        try:
            x, _, z = self.pose.position_m
            self.trace.append((x, z, self.counts, self.held))
        except DeviceError:  # not connected
            return
        if self.interruptions and self.interruptions[0][0]():
            self.interrupted_at.append(len(self.trace) - 1)
            raise self.interruptions.pop(0)[1]


@pytest.fixture
def lift_of(monkeypatch: pytest.MonkeyPatch) -> Callable[..., LiftOf]:
    """Create a connected, activated bench with an object at its place: `lift_of(object_id="t1")`. step_m:
    resolution of the gripper; None: that of a Robotiq 3-Finger."""
    lifts: list[LiftOf] = []
    SwitchedFaults.on.clear()
    passes = SimulatedClock.sleep_until

    def sleep_until(clock: SimulatedClock, time_ns: int) -> None:
        while lifts and clock.now_ns() + WATCHED_NS < time_ns:
            passes(clock, clock.now_ns() + WATCHED_NS)
            lifts[0].see()
        passes(clock, time_ns)
        if lifts:
            lifts[0].see()

    monkeypatch.setattr(SimulatedClock, "sleep_until", sleep_until)
    monkeypatch.setattr("protocols.slip_trial.GRASP_S", 0.5)  # the fingers rest until then

    def make(object_id: str = "t1", step_m: float | None = None) -> LiftOf:
        config = lighter()
        if step_m is not None:
            steps = {"max_counts": 6 + round(0.155 / step_m), "opening_per_count_m": step_m}
            limits = config.gripper.limits.model_copy(update=steps)
            gripper = config.gripper.model_copy(update={"limits": limits})
            config = config.model_copy(update={"gripper": gripper})
        made = build_learning_bench(config, 3, None, SwitchedFaults())
        settings = TrialSettings(config, 0, choose_estimator())
        plan = plan_lift(settings, LiftTask(1, object_id, 1), made.bench.base_T_table)
        for device in (*made.bench.frame_sources, made.bench.gripper, made.bench.arm):
            device.connect()
        made.bench.gripper.activate()
        made.place(object_id)
        kept: list[HandState] = []
        made = replace(made, bench=replace(made.bench, hand=Hand(HandState(Holding.FREE), kept.append)))
        lift = LiftOf(made, plan, Touching(made), kept=kept)
        lifts.append(lift)
        return lift

    return make
