"""Simulated benches for learning, whose world may be asked for what is true: never for a measurement.

The camera is blind, as the truth is asked of the world, and so are the fingertips where the wrist
alone is learnt from.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.bench import Bench, Fingertip
from drivers.clock import Clock
from drivers.interfaces import Camera, TactileSensor
from drivers.types import Image
from fakes.clock import SimulatedClock
from fakes.devices.gripper import FakeGripper
from fakes.devices.source import FakeSource, Shutter
from fakes.faults import FaultScript
from fakes.objects.catalogue import find_object
from fakes.world.world import World
from rig.bench.assembly import simulated_arm, simulated_bench_plan
from rig.config import BenchConfig

NO_FAULTS = FaultScript()


@dataclass(frozen=True, slots=True)
class LearningBench:
    """A simulated bench, and what is true of it.

    place: lays an object, by its id, on its mark. force_n: with which the fingers press at a time in
    ns. turn_deg: of the object in the hand at a time in ns, counter-clockwise as the camera sees it.
    """

    bench: Bench
    place: Callable[[str], None]
    force_n: Callable[[int], float]
    turn_deg: Callable[[int], float]


def build_learning_bench(
    config: BenchConfig, seed: int, sight_hz: float | None, faults: FaultScript = NO_FAULTS
) -> LearningBench:
    """Make a bench on a world of its own. sight_hz: rate of the fingertips; None: they are blind."""
    plan = simulated_bench_plan(config)
    world, clock = World(plan.layout, seed), SimulatedClock()
    tips = []
    for digit in plan.digits:
        if sight_hz is None:
            sensor: TactileSensor = _Blind(digit.serial, digit.rate_hz, world, clock, faults)
        else:
            sensor = replace(digit, rate_hz=sight_hz).make(world, clock, faults)
        tips.append(Fingertip(sensor, f"finger {digit.number}", digit.side))
    bench = Bench(
        name="simulated lifts",
        simulated=True,
        clock=clock,
        arm=simulated_arm(config, world, clock, faults),
        gripper=FakeGripper(world, clock, faults),
        fingertips=tuple(tips),
        camera=_Blind(plan.camera.serial, plan.camera.rate_hz, world, clock, faults),
        base_T_camera=plan.camera.base_T_camera,
        base_T_table=world.layout.base_T_table,
        base_T_home=world.layout.home,
    )

    def turn_deg(time_ns: int) -> float:
        state = world.state_at(time_ns)
        return float(np.degrees(state.object_turn_rad - state.wrist_rad))

    return LearningBench(
        bench,
        lambda object_id: world.place(find_object(object_id), seed),
        lambda time_ns: world.state_at(time_ns).force_n,
        turn_deg,
    )


class _Blind(FakeSource, TactileSensor, Camera):
    """Frames of noise on a schedule, so that the protocol goes on."""

    def __init__(self, serial: str, rate_hz: float, world: World, clock: Clock, faults: FaultScript) -> None:
        super().__init__((serial,), Shutter(rate_hz, 0.002), _noise, clock, faults, world.seed)

    def set_light(self, red: float, green: float, blue: float) -> None:
        """There is none."""


def _noise(time_ns: int, rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, (8, 8, 3), np.uint8)
