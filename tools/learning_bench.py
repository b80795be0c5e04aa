"""Simulated benches for training, with access to the ground truth of the world. Not for measurements.

The camera delivers noise, because the ground truth comes from the world. If a network is trained only on the
wrench at the wrist, the fingertips deliver a sketched gel, which is drawn much faster than a rendered one.
Used by `tools/learnt_lifts.py`. To train on lifts, run `python tools/train_angle.py --help`.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from drivers.bench import Bench, Fingertip
from drivers.errors import DeviceError
from drivers.interfaces import Camera, TactileSensor
from drivers.types import Image
from fakes.clock import SimulatedClock
from fakes.devices.camera import FakeSource, Shutter
from fakes.devices.digit import DigitPlan
from fakes.devices.gripper import FakeGripper
from fakes.faults import FaultScript
from fakes.objects.catalogue import find_object
from fakes.world.world import World
from rig.bench.assembly import simulated_arm, simulated_bench_plan
from rig.config import BenchConfig

MOST_BRIGHTER, HALF_FORCE_N = 140.0, 4.0
"""Brightness of a sketched contact in grey levels at a very large force, and the force that gives half of it.
Chosen so that a contact is visible at 0.2 N and still becomes brighter at 20 N."""
Draw = Callable[[int, np.random.Generator], Image]


@dataclass(frozen=True, slots=True)
class LearningBench:
    """A simulated bench with access to its true state.

    Attributes:
        place: puts an object, given its id, on its mark.
        force_n: true force of the fingers at a time in ns.
        turn_deg: true rotation of the object in the hand at a time in ns, counter-clockwise as the camera
            sees it.

    """

    bench: Bench
    place: Callable[[str], None]
    force_n: Callable[[int], float]
    turn_deg: Callable[[int], float]


def build_learning_bench(
    config: BenchConfig, seed: int, sight_hz: float | None, faults: FaultScript | None = None
) -> LearningBench:
    """Build a bench on a new world. sight_hz: rate of rendered tactile frames; None: sketched frames."""
    plan, faults = simulated_bench_plan(config), faults or FaultScript()
    world, clock = World(plan.layout, seed), SimulatedClock()

    def cheap(serial: str, rate_hz: float, draw: Draw) -> _Cheap:
        return _Cheap((serial,), Shutter(rate_hz, 0.002), draw, clock, faults, world.seed)

    def sensor(digit: DigitPlan) -> TactileSensor:
        if sight_hz is None:
            return cheap(digit.serial, digit.rate_hz, partial(sketch, world))
        return replace(digit, rate_hz=sight_hz).make(world, clock, faults)

    tips = tuple(Fingertip(sensor(digit), f"finger {digit.number}", digit.side) for digit in plan.digits)
    bench = Bench(
        name="simulated lifts",
        simulated=True,
        clock=clock,
        arm=simulated_arm(config, world, clock, faults),
        gripper=FakeGripper(world, clock, faults),
        fingertips=tips,
        camera=cheap(plan.camera.serial, plan.camera.rate_hz, _noise),
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


class _Cheap(FakeSource, TactileSensor, Camera):
    """A source of small frames on a schedule, so that the protocol runs without rendering."""

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Do nothing: there are no LEDs."""


def _noise(time_ns: int, rng: np.random.Generator) -> Image:
    return rng.integers(0, 256, (8, 8, 3), np.uint8)


def sketch(world: World, time_ns: int, rng: np.random.Generator) -> Image:
    """Draw a noisy gel of 32 x 32 pixels with a bar that becomes brighter with the force of the fingers."""
    image = rng.integers(90, 110, (32, 32, 3), np.uint8)
    with suppress(DeviceError):  # a frame from before the world's memory shows no contact
        force_n = world.state_at(time_ns).force_n
        image[10:14, 4:28] += np.uint8(MOST_BRIGHTER * force_n / (force_n + HALF_FORCE_N))
    return image
