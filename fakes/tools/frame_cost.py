"""What a served frame costs: `python -m fakes.tools.frame_cost`, for the held object of a lift.

Renders and encodes every frame of a simulated lift, as a served sensor does, on one thread of one
core, and prints mean, 99th percentile and maximum of its processor time in ms. The target is 3 ms.
"""

import sys
import time

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Pose
from fakes.clock import SimulatedClock
from fakes.devices.plan import CameraPlan, DigitPlan
from fakes.faults import FaultScript
from fakes.objects.catalogue import find_object
from fakes.studio.conditions import Difficulty
from fakes.wire.mjpeg.sensor import Kind, MjpegSensor
from fakes.world.motion import FingerPath, ToolPath
from fakes.world.trapezoid import TrapezoidProfile
from fakes.world.world import BenchLayout, World

OBJECTS = ("t1", "t2", "t5", "12")
SENSORS: tuple[tuple[Kind, Difficulty], ...] = (("digit", "easy"), ("digit", "hard"), ("camera", "easy"))
SQUEEZE_COUNTS = 4
LIFT_M = 0.08
DURATION_S = 3.0
_DOWN = Rotation.from_euler("x", 180, degrees=True)


def main() -> int:
    """Print a row per object and sensor; return the exit code."""
    cv2.setNumThreads(1)
    print("object sensor   lifts  frames  mean ms  p99 ms  max ms")
    for name in OBJECTS:
        for kind, difficulty in SENSORS:
            costs = lift_costs_ms(name, kind, difficulty)
            mean, p99, worst = costs.mean(), np.quantile(costs, 0.99), costs.max()
            print(f"{name:6s} {kind:8s} {difficulty:6s} {len(costs):6d} {mean:8.2f} {p99:7.2f} {worst:7.2f}")
    return 0


def lift_costs_ms(name: str, kind: Kind, difficulty: Difficulty = "easy") -> np.ndarray:
    """Return what each frame of a lift of an object costs, (N,) in ms of processor time."""
    world, clock = lifting_world(name), SimulatedClock()
    if kind == "digit":
        source = DigitPlan("SIM-D0001", 1, 60.0, 0, difficulty=difficulty).make(world, clock, FaultScript())
    else:
        source = _camera().make(world, clock, FaultScript())

    def render(time_ns: int) -> np.ndarray:
        return source.draw(time_ns, np.random.default_rng(time_ns))

    sensor = MjpegSensor(render, source.rate_hz, clock, kind)
    costs = []
    while clock.now_ns() < to_ns(DURATION_S):
        clock.sleep_until(sensor.due_ns(NS_PER_S)[0])
        world.state_at(clock.now_ns())  # the world's own steps are another process's work
        began = time.thread_time()
        sensor.capture()
        costs.append((time.thread_time() - began) * 1e3)
    return np.array(costs)


def lifting_world(name: str, seed: int = 1) -> World:
    """Return a world in which the fingers have closed on an object and lift it from 0.5 s on."""
    model = find_object(name)
    site = model.sites[0]
    table = Pose((0.45, 0.0, 0.06))
    start = Pose.from_rotation(table.translated(x_m=site.offset_m).position_m, _DOWN)
    world = World(BenchLayout(base_T_table=table, home=start), seed)
    world.place(model)
    layout = world.layout
    closed = layout.open_counts + (layout.max_opening_m - site.width_m) / layout.opening_per_count_m
    counts = closed + SQUEEZE_COUNTS
    world.fingers = FingerPath(counts, counts, TrapezoidProfile(0, 0.0, 1.0, 1.0))
    profile = TrapezoidProfile(NS_PER_S // 2, LIFT_M, 0.05, 0.5)
    world.tool = ToolPath.between(start, start.translated(z_m=LIFT_M), profile)
    return world


def _camera() -> CameraPlan:
    looking = Pose.from_rotation((0.45, -0.62, 0.16), Rotation.from_euler("x", -95, degrees=True))
    return CameraPlan("SIM-C0001", 30.0, (640, 480), 640.0, (0, 1), 0.04, "DICT_4X4_50", looking)


if __name__ == "__main__":
    sys.exit(main())
