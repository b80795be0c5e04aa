"""From a bench file to a bench: the one module that names concrete devices."""

from collections.abc import Callable

from scipy.spatial.transform import Rotation

from drivers.bench import Bench, Fingertip
from drivers.errors import InputError, OperatorStopError
from drivers.types import Pose
from fakes.arm import FakeArm
from fakes.catalogue import find_object
from fakes.clock import SimulatedClock
from fakes.faults import Fault, FaultScript
from fakes.gripper import FakeGripper
from fakes.moment import Layout
from fakes.plan import BenchPlan, CameraPlan, DigitPlan
from fakes.world import World
from protocols.watch import Operator
from rig.config import BenchConfig

TOOL_DOWN = Rotation.from_euler("x", 180, degrees=True)


def build_bench(
    config: BenchConfig, seed: int = 0, lift: str = "", attempt: int = 0, realtime: bool = False
) -> tuple[Bench, Operator]:
    """Make the devices of a bench file, and the operator who goes with them.

    seed: of the simulated world. lift, attempt: choose the scripted faults that apply.
    Raises `InputError` for drivers that are not part of this version.
    """
    _require_simulated(config)
    plan = _plan(config)
    world = World(plan.layout, seed)
    clock = SimulatedClock(realtime)
    faults = FaultScript(tuple(f for f in map(_fault, config.faults) if f.concerns(lift, attempt)))
    bench = Bench(
        name=config.name,
        simulated=True,
        clock=clock,
        arm=FakeArm(world, clock, faults),
        gripper=FakeGripper(world, clock, faults),
        fingertips=tuple(
            Fingertip(digit.make(world, clock, faults), tactile.finger, tactile.sign)
            for digit, tactile in zip(plan.digits, config.tactile, strict=True)
        ),
        camera=plan.camera.make(world, clock, faults),
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


def _plan(config: BenchConfig) -> BenchPlan:
    """What the simulated bench of a bench file is made of."""
    camera = config.camera
    return BenchPlan(
        Layout(Pose(config.table.position_m), Pose.from_rotation(config.arm.home_m, TOOL_DOWN)),
        tuple(DigitPlan(t.serial, t.sign, t.rate_hz, number) for number, t in enumerate(config.tactile)),
        CameraPlan(
            camera.serial,
            camera.rate_hz,
            camera.size_px,
            camera.focal_px,
            camera.marker_ids,
            camera.marker_side_m,
            camera.marker_dictionary,
            camera.base_T_camera(),
        ),
    )


def _fault(fault: object) -> Fault:
    return Fault(**fault.model_dump())  # type: ignore[attr-defined]
