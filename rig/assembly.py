"""From a bench file to a bench: the one module that names concrete devices."""

import hashlib
from collections.abc import Callable
from functools import cache

from scipy.spatial.transform import Rotation

from drivers.bench import Bench, Fingertip
from drivers.errors import InputError, OperatorStopError
from drivers.types import Pose
from fakes.arm import FakeArm
from fakes.camera import FakeCamera
from fakes.catalogue import find_object
from fakes.clock import SimulatedClock
from fakes.faults import Fault, FaultScript
from fakes.gripper import FakeGripper
from fakes.scene import MarkerScene
from fakes.source import Shutter
from fakes.tactile import FakeDigit
from fakes.world import Layout, World
from protocols.watch import Operator
from rig.config import BenchConfig, TactileConfig

TOOL_DOWN = Rotation.from_euler("x", 180, degrees=True)
CAMERA_MISALIGNMENT = Rotation.from_euler("xyz", (0.8, -0.6, 0.4), degrees=True)
"""The simulated camera does not stand exactly where the bench file says; no real one does."""

_scene = cache(MarkerScene)
"""A scene is the same on every bench, and costs a hundred frames to make."""


def build_bench(
    config: BenchConfig, seed: int = 0, lift: str = "", attempt: int = 0, realtime: bool = False
) -> tuple[Bench, Operator]:
    """Make the devices of a bench file, and the operator who goes with them.

    seed: of the simulated world. lift, attempt: choose the scripted faults that apply.
    Raises `InputError` for drivers that are not part of this version.
    """
    _require_simulated(config)
    world = World(_layout(config), seed)
    clock = SimulatedClock(realtime)
    faults = FaultScript(tuple(f for f in map(_fault, config.faults) if f.concerns(lift, attempt)))
    bench = Bench(
        name=config.name,
        simulated=True,
        clock=clock,
        arm=FakeArm(world, clock, faults),
        gripper=FakeGripper(world, clock, faults),
        fingertips=tuple(
            Fingertip(_digit(world, clock, faults, tactile, number), tactile.finger, tactile.sign)
            for number, tactile in enumerate(config.tactile)
        ),
        camera=_camera(world, clock, faults, config),
        base_T_camera=config.camera.base_T_camera(),
        base_T_table=world.layout.base_T_table,
    )
    return bench, SimulatedOperator(world)


class SimulatedOperator:
    """Agrees to everything and lays objects into the simulated world."""

    def __init__(self, world: World) -> None:
        self._world = world

    def confirm(self, question: str) -> None:
        """Agree."""

    def place(self, object_id: str, name: str) -> None:
        """Lay the object on its place."""
        self._world.place(find_object(object_id))

    def displaced(self) -> None:
        """Nothing to note: each lift begins with a world of its own."""


class ConsoleOperator:
    """A person at a terminal; `ask` puts a question and returns whether they agree."""

    def __init__(self, ask: Callable[[str], bool]) -> None:
        self._ask = ask
        self._in_place: str | None = None

    def confirm(self, question: str) -> None:
        """Ask, and stop unless agreed."""
        if not self._ask(question):
            raise OperatorStopError("stopped: the operator did not agree; nothing was moved")

    def place(self, object_id: str, name: str) -> None:
        """Ask for the object unless the last lift set it down in its place."""
        if self._in_place != object_id:
            self.confirm(f"Place object {object_id} ({name}) on its mark. Ready?")
        self._in_place = object_id

    def displaced(self) -> None:
        """Ask again before the next lift."""
        self._in_place = None


def _require_simulated(config: BenchConfig) -> None:
    drivers = [config.arm.driver, config.gripper.driver, config.camera.driver]
    drivers += [tactile.driver for tactile in config.tactile]
    real = sorted({driver for driver in drivers if driver != "fake"})
    if real:
        raise InputError(
            f"bench '{config.name}': driver {', '.join(real)} is not part of this version; "
            "use driver = \"fake\" (see README, 'A real bench')"
        )


def _layout(config: BenchConfig) -> Layout:
    return Layout(
        base_T_table=Pose(config.table.position_m),
        home=Pose.from_rotation(config.arm.home_m, TOOL_DOWN),
    )


def _fault(fault: object) -> Fault:
    return Fault(**fault.model_dump())  # type: ignore[attr-defined]


def _unit_seed(serial: str) -> int:
    """A sensor unit's peculiarities belong to its serial, on every bench."""
    return int.from_bytes(hashlib.sha256(serial.encode()).digest()[:4], "big")


def _digit(
    world: World, clock: SimulatedClock, faults: FaultScript, tactile: TactileConfig, number: int
) -> FakeDigit:
    shutter = Shutter(tactile.rate_hz, phase_s=0.002 + 0.005 * number)
    return FakeDigit(world, clock, faults, tactile.serial, _unit_seed(tactile.serial), tactile.sign, shutter)


def _camera(world: World, clock: SimulatedClock, faults: FaultScript, config: BenchConfig) -> FakeCamera:
    camera = config.camera
    nominal = camera.base_T_camera()
    true_pose = Pose.from_rotation(nominal.position_m, nominal.rotation * CAMERA_MISALIGNMENT)
    shutter = Shutter(camera.rate_hz, phase_s=0.009, latency_s=0.006)
    scene = _scene(
        size=camera.size_px,
        focal_px=camera.focal_px,
        marker_ids=camera.marker_ids,
        marker_side_m=camera.marker_side_m,
        dictionary=camera.marker_dictionary,
        unit_seed=_unit_seed(camera.serial),
    )
    return FakeCamera(world, clock, faults, camera.serial, shutter, scene, true_pose)
