"""SIMULATED lifts for learning: the trial's own protocol on fakes, without what learning does not look at.

The camera is blind (the truth is asked of the simulated world), and so are the fingertips where the
wrist alone is learnt from. Everything else, plan, steps and waiting times, is that of `rig trial`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.bench import Bench, Fingertip
from drivers.clock import Clock
from drivers.errors import GraspError
from drivers.interfaces import Camera, TactileSensor
from drivers.types import ArmState, Frame, GripperState, Image
from fakes.arm import FakeArm
from fakes.catalogue import find_object
from fakes.clock import SimulatedClock
from fakes.faults import FaultScript
from fakes.gripper import FakeGripper
from fakes.plan import BenchPlan
from fakes.source import FakeSource, Shutter
from fakes.world import World
from protocols.slip_trial import LiftPlan, run_lift
from protocols.watch import Phase, Watch
from rig.assembly import simulated_bench_plan
from rig.attempt import LiftTask, TrialSettings, plan_lift
from rig.config import load_bench
from rig.seeds import derived_seed
from rig.tactile.estimator import choose_estimator
from rig.training.examples import sized
from rig.training.lifts import SIGHT_HZ, WristSeries, hand_turn_deg, labelled_views, wrist_series

TOUCH_N = 0.06
"""Force at which a fingertip shows contact, about."""


def simulated_wrists(
    objects: Sequence[str], lifts: int, seed: int, tell: Callable[[int, int], None]
) -> list[WristSeries]:
    """Carry out so many lifts of each object with blind fingertips; return what the wrist felt.

    tell: is told lifts done and wanted. Another seed gives other lifts, the same one the same.
    """
    return [
        wrist_series(plan.object_id, seen.states, seen.phases, seen.turn_deg)
        for plan, seen, _ in _lifts(objects, lifts, seed, None, tell)
    ]


def simulated_views(
    objects: Sequence[str],
    lifts: int,
    seed: int,
    size: tuple[int, int],
    tell: Callable[[int, int], None],
) -> Iterator[tuple[str, Image, float]]:
    """Carry out lifts; yield object, frame at (width, height) `size` and angle of both fingertips."""
    for plan, seen, bench in _lifts(objects, lifts, seed, SIGHT_HZ, tell):
        hand = hand_turn_deg(plan.base_T_grasp)
        for tip in bench.fingertips:
            frames = iter(seen.frames[tip.sensor.serial])
            for frame, angle in labelled_views(frames, tip.sign, hand, seen.phases, seen.turn_deg):
                yield plan.object_id, sized(frame.image, size), angle


def _lifts(
    objects: Sequence[str], lifts: int, seed: int, sight_hz: float | None, tell: Callable[[int, int], None]
) -> Iterator[tuple[LiftPlan, "_Seen", Bench]]:
    config = load_bench("fake")
    settings, layout = TrialSettings(config, seed, choose_estimator()), simulated_bench_plan(config)
    tasks = [LiftTask(0, object_id, lift) for object_id in objects for lift in range(1, lifts + 1)]
    for done, task in enumerate(tasks, 1):
        world = World(layout.layout, derived_seed(seed, "learnt", task.object_id, task.lift))
        plan = plan_lift(settings, task, world.layout.base_T_table)
        bench = _bench(layout, world, sight_hz)
        seen = _Seen(world, bench.clock)
        try:
            _carry_out(bench, world, plan, seen)
        except GraspError:  # no contact: nothing to learn
            continue
        finally:
            tell(done, len(tasks))
        yield plan, seen, bench


def _carry_out(bench: Bench, world: World, plan: LiftPlan, seen: "_Seen") -> None:
    with bench.connected():
        bench.gripper.activate()
        world.place(find_object(plan.object_id), world.seed)
        run_lift(bench, plan, seen)


def _bench(plan: BenchPlan, world: World, sight_hz: float | None) -> Bench:
    """Make a bench around a world: a blind camera, fingertips that look at `sight_hz` or are blind."""
    clock, faults = SimulatedClock(), FaultScript()
    tips = []
    for digit in plan.digits:
        if sight_hz is None:
            sensor: TactileSensor = _Blind(digit.serial, digit.rate_hz, world, clock, faults)
        else:
            sensor = replace(digit, rate_hz=sight_hz).make(world, clock, faults)
        tips.append(Fingertip(sensor, f"finger {digit.number}", digit.side))
    return Bench(
        name="simulated lifts",
        simulated=True,
        clock=clock,
        arm=FakeArm(world, clock, faults),
        gripper=FakeGripper(world, clock, faults),
        fingertips=tuple(tips),
        camera=_Blind(plan.camera.serial, plan.camera.rate_hz, world, clock, faults),
        base_T_camera=plan.camera.base_T_camera,
        base_T_table=world.layout.base_T_table,
    )


class _Blind(FakeSource, TactileSensor, Camera):
    """Frames of noise on a schedule, so that the protocol goes on."""

    def __init__(self, serial: str, rate_hz: float, world: World, clock: Clock, faults: FaultScript) -> None:
        super().__init__((serial,), Shutter(rate_hz, 0.002), _noise, clock, faults, world.seed)

    def set_light(self, red: float, green: float, blue: float) -> None:
        """There is none."""


def _noise(time_ns: int, rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, (8, 8, 3), np.uint8)


@dataclass(slots=True)
class _Seen(Watch):
    """Keeps what happens in one lift, and how the object lay in the hand at each sample and frame."""

    world: World
    clock: Clock
    phases: dict[Phase, int] = field(default_factory=dict)
    states: list[ArmState] = field(default_factory=list)
    frames: dict[str, list[Frame]] = field(default_factory=dict)
    _turns_deg: dict[int, float] = field(default_factory=dict)

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Note when it began."""
        self.phases[phase] = time_ns
        self._note(time_ns)

    def frame(self, frame: Frame) -> None:
        """Keep it."""
        self.frames.setdefault(frame.serial, []).append(frame)
        self._note(frame.time_ns)

    def arm(self, state: ArmState) -> None:
        """Keep it."""
        self.states.append(state)
        self._note(state.time_ns)

    def gripper(self, state: GripperState) -> None:
        """Nothing is learnt from it."""

    def touching(self, serial: str) -> bool:
        """Whether the fingers press on the object."""
        return self.world.moment_at(self.clock.now_ns()).force_n >= TOUCH_N

    def turn_deg(self, time_ns: int) -> float:
        """The object's turn in the hand since the lift began, at a time that was seen."""
        return self._turns_deg[time_ns] - self._turns_deg[self.phases[Phase.LIFT]]

    def _note(self, time_ns: int) -> None:
        moment = self.world.moment_at(time_ns)
        self._turns_deg[time_ns] = float(np.degrees(moment.object_turn_rad - moment.wrist_rad))
