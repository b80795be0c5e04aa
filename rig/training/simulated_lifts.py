"""SIMULATED lifts as training data: the protocol of a trial on a simulated bench, without unused sensors.

The camera is not rendered, because the ground truth comes from the simulated world. The fingertips are not
rendered if only wrenches are used. Plan, steps and waiting times are those of `rig trial`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from drivers.bench import Bench
from drivers.errors import GraspError
from drivers.types import ArmState, Frame, Image
from protocols.observer import LiftObserver, Phase
from protocols.slip_trial import LiftPlan, run_lift
from rig.bench.learning import LearningBench, build_learning_bench
from rig.config import load_bench
from rig.experiments.lift_plan import LiftTask, TrialSettings, derived_seed, plan_lift
from rig.tactile.estimators import choose_estimator
from rig.training.examples import sized
from rig.training.lifts import SIGHT_HZ, WristSeries, hand_turn_deg, labelled_views, wrist_series

TOUCH_N = 0.06
"""Approximate force at which a fingertip shows contact."""


def simulated_wrists(
    objects: Sequence[str], lifts: int, seed: int, report: Callable[[int, int], None]
) -> list[WristSeries]:
    """Carry out `lifts` lifts of each object without tactile images; return the arm's states.

    report: called with the numbers of finished and of all lifts. Equal seeds give equal lifts.
    """
    return [
        wrist_series(plan.object_id, seen.states, seen.phases, seen.turn_deg)
        for plan, seen, _ in _lifts(objects, lifts, seed, None, report)
    ]


def simulated_views(
    objects: Sequence[str],
    lifts: int,
    seed: int,
    size: tuple[int, int],
    report: Callable[[int, int], None],
) -> Iterator[tuple[str, Image, float]]:
    """Carry out lifts; yield object, frame at (width, height) `size` and angle of both fingertips."""
    for plan, seen, bench in _lifts(objects, lifts, seed, SIGHT_HZ, report):
        hand = hand_turn_deg(plan.base_T_grasp)
        for tip in bench.fingertips:
            frames = iter(seen.frames[tip.sensor.serial])
            for frame, angle in labelled_views(frames, tip.sign, hand, seen.phases, seen.turn_deg):
                yield plan.object_id, sized(frame.image, size), angle


def _lifts(
    objects: Sequence[str], lifts: int, seed: int, sight_hz: float | None, report: Callable[[int, int], None]
) -> Iterator[tuple[LiftPlan, "_Seen", Bench]]:
    config = load_bench("fake")
    settings = TrialSettings(config, seed, choose_estimator())
    tasks = [LiftTask(0, object_id, lift) for object_id in objects for lift in range(1, lifts + 1)]
    for done, task in enumerate(tasks, 1):
        made = build_learning_bench(config, derived_seed(seed, "learnt", task.object_id, task.lift), sight_hz)
        plan = plan_lift(settings, task, made.bench.base_T_table)
        seen = _Seen(made)
        try:
            _carry_out(made, plan, seen)
        except GraspError:  # no contact: nothing to learn
            continue
        finally:
            report(done, len(tasks))
        yield plan, seen, made.bench


def _carry_out(made: LearningBench, plan: LiftPlan, seen: "_Seen") -> None:
    with made.bench.connected():
        made.bench.gripper.activate()
        made.place(plan.object_id)
        run_lift(made.bench, plan, seen)


@dataclass(slots=True)
class _Seen(LiftObserver):
    """Stores the events of one lift, and the object's rotation in the hand at each sample and frame."""

    made: LearningBench
    phases: dict[str, int] = field(default_factory=dict)
    states: list[ArmState] = field(default_factory=list)
    frames: dict[str, list[Frame]] = field(default_factory=dict)
    _turns_deg: dict[int, float] = field(default_factory=dict)

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Store the start of a phase."""
        self.phases[phase] = time_ns
        self._note(time_ns)

    def frame(self, frame: Frame) -> None:
        """Store the frame."""
        self.frames.setdefault(frame.serial, []).append(frame)
        self._note(frame.time_ns)

    def arm(self, state: ArmState) -> None:
        """Store the state."""
        self.states.append(state)
        self._note(state.time_ns)

    def touching(self, serial: str) -> bool:
        """Whether the fingers press on the object."""
        return self.made.force_n(self.made.bench.clock.now_ns()) >= TOUCH_N

    def turn_deg(self, time_ns: int) -> float:
        """The object's rotation in the hand since the start of the lift, at the time of an event."""
        return self._turns_deg[time_ns] - self._turns_deg[self.phases[Phase.LIFT]]

    def _note(self, time_ns: int) -> None:
        self._turns_deg[time_ns] = self.made.turn_deg(time_ns)
