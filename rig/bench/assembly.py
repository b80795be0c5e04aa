"""Create a bench from a bench file: the only module that names concrete devices."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from scipy.spatial.transform import Rotation

from calibration.targets.sheets import target_picture
from drivers.bench import Bench, Fingertip, Hand, missing_device
from drivers.clock import Clock, SystemClock, to_ns
from drivers.interfaces import Arm, Camera, Gripper, TactileSensor
from drivers.types import HandState, Holding, Image, Pose
from fakes.clock import SimulatedClock
from fakes.devices.arm import FakeArm
from fakes.devices.camera import CameraPlan
from fakes.devices.digit import BenchPlan, DigitPlan, FakeDigit
from fakes.devices.gripper import FakeGripper
from fakes.faults import FaultScript, ScriptedFault
from fakes.world.fixture import Sheet
from fakes.world.state import BenchLayout
from fakes.world.world import World
from protocols.operator import Operator
from rig.bench.operators import SimulatedOperator
from rig.bench.own_devices import own_arm, own_gripper, own_source
from rig.bench.twins import laid_as, look_of
from rig.config import BenchConfig
from rig.config.devices import (
    DrawnTactileSection,
    FakeArmConfig,
    FakeCameraConfig,
    FakeGripperConfig,
    FakeTactileConfig,
    GripperLimitsConfig,
    OwnArmConfig,
    OwnCameraConfig,
    OwnGripperConfig,
    OwnTactileConfig,
    RobotiqRtuConfig,
)

LED_S = 3.0
"""Time that a simulated person takes to lead the arm to a place."""
TOOL_DOWN = Rotation.from_euler("x", 180, degrees=True)
TABLE_M, HOME_M = (0.45, 0.0, 0.06), (0.45, 0.0, 0.30)
"""Position of objects and home position of the tool on the bench `fake`, base frame."""


def build_bench(
    config: BenchConfig,
    seed: int = 0,
    lift: str = "",
    attempt: int = 0,
    realtime: bool = False,
    variation_seed: int | None = None,
    watch: Callable[[World], None] | None = None,
) -> tuple[Bench, Operator]:
    """Create a bench of devices simulated in this process, and its simulated operator.

    seed: of the simulated world. lift, attempt: select the scripted faults that apply. realtime: run at real
    time. variation_seed: draws tactile sensors that differ from the bench's own; None for the bench's own.
    watch: called with the world, for benchmarks that need the ground truth.
    """
    world = World(simulated_layout(config), seed)
    if watch is not None:
        watch(world)
    clock = SimulatedClock(realtime)
    scripted = [ScriptedFault(**fault.model_dump()) for fault in config.faults]
    faults = FaultScript(tuple(fault for fault in scripted if fault.concerns(lift, attempt)))
    devices = _Devices(config, clock, world, faults, variation_seed)
    bench = devices.bench(Hand(HandState(Holding.FREE)))

    def lead(to: Pose) -> Callable[[], bool]:
        there_ns = clock.now_ns() + to_ns(LED_S)
        if isinstance(bench.arm, FakeArm):
            bench.arm.lead(to, LED_S)
        return lambda: clock.now_ns() >= there_ns

    def hold(object_id: str, pose: Pose, opening_m: float | None, turning: bool) -> None:
        world.hold(laid_as(config.objects, object_id), pose, opening_m, turning)

    person = SimulatedOperator(
        lambda object_id: world.lay(laid_as(config.objects, object_id)),
        lambda: world.gap_at(clock.now_ns()),
        lead,
        seed,
        hold=hold,
    )
    return bench, person


def simulated_arm(config: BenchConfig, world: World, clock: Clock, faults: FaultScript) -> FakeArm:
    return FakeArm(world, clock, faults, config.arm_limits(), config.require("arm").limits.joint_limits_rad())


def home_pose(config: BenchConfig) -> Pose:
    """Return `base_T_tcp` of the home pose: position from the bench file, tool pointing down."""
    return Pose.from_rotation(config.require("arm").home_m, TOOL_DOWN)


def true_masks(bench: Bench) -> dict[str, Callable[[int], Image]]:
    """Return functions, by serial, that give the true contact mask of simulated fingertips at a time in ns.

    Masks are (H, W) uint8, 0 or 255. Empty for a bench that is not simulated in this process. Only for labels
    of simulated images.
    """
    sensors = [tip.sensor for tip in bench.fingertips]
    return {sensor.serial: sensor.true_mask for sensor in sensors if isinstance(sensor, FakeDigit)}


def build_real_bench(config: BenchConfig, hand: Hand | None = None, clock: Clock | None = None) -> Bench:
    """Create the drivers of a bench file that are not all simulated in this process; none is connected yet.

    hand: known state of the hand, unknown by default. clock: the computer's by default; tests give a slowed
    one, which the drivers accept for simulated devices only. Each driver imports its manufacturer's library,
    or the user-defined class, only here. Simulated devices beside real ones share a separate simulated world.
    Raises `InputError` if a user-defined driver cannot be created.
    """
    clock = clock or SystemClock()
    world = None
    if "fake" in config.drivers:
        world = World(simulated_layout(config), seed=0, start_ns=clock.now_ns())
    return _Devices(config, clock, world, FaultScript()).bench(hand or Hand())


@dataclass(frozen=True, slots=True)
class _Devices:
    """Creates the devices of a bench file. world: of the simulated ones; None if there are none."""

    config: BenchConfig
    clock: Clock
    world: World | None
    faults: FaultScript
    variation_seed: int | None = None

    @property
    def _world(self) -> World:
        if self.world is None:
            raise ValueError("simulated devices need a world")
        return self.world

    def bench(self, hand: Hand) -> Bench:
        config, layout = self.config, simulated_layout(self.config)
        has_camera = config.has("camera")
        return Bench(
            name=config.name,
            simulated=config.simulated,
            clock=self.clock,
            arm=self._arm() if config.has("arm") else missing_device("arm"),
            gripper=self._gripper() if config.has("gripper") else missing_device("gripper"),
            fingertips=tuple(
                Fingertip(self._tactile(number), t.finger, t.sign) for number, t in enumerate(config.tactile)
            ),
            camera=self._camera() if has_camera else missing_device("camera"),
            base_T_camera=config.base_T_camera() if has_camera else Pose((0.0, 0.0, 0.0)),
            base_T_table=layout.base_T_table,
            base_T_home=layout.home,
            hand=hand,
        )

    def _arm(self) -> Arm:
        config, arm = self.config, self.config.require("arm")
        if isinstance(arm, FakeArmConfig):
            return simulated_arm(config, self._world, self.clock, self.faults)
        if isinstance(arm, OwnArmConfig):
            return own_arm(arm, config.arm_limits(), self.clock)
        from drivers.ur5e.arm import UR5e

        return UR5e(
            host=arm.host or "",
            limits=config.arm_limits(),
            flange_T_tcp=arm.flange_T_tcp(),
            payload_kg=arm.payload_kg,
            payload_cog_m=arm.payload_cog_m,
            joint_limits_rad=arm.limits.joint_limits_rad(),
            frequency_hz=arm.frequency_hz,
            clock=self.clock,
        )

    def _gripper(self) -> Gripper:
        gripper, spec = self.config.require("gripper"), self.config.gripper_spec()
        if isinstance(gripper, FakeGripperConfig):
            return FakeGripper(self._world, self.clock, self.faults, spec, gripper.period_s)
        if isinstance(gripper, OwnGripperConfig):
            return own_gripper(gripper, spec, self.clock)
        from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link

        if isinstance(gripper, RobotiqRtuConfig):
            link = rtu_link(gripper.device or "")
        else:
            link = tcp_link(gripper.host or "", gripper.port, gripper.preset)
        return Robotiq3F(link, gripper.fingers, spec, self.clock, open_counts=gripper.limits.min_counts)

    def _tactile(self, number: int) -> TactileSensor:
        tactile = self.config.tactile[number]
        if isinstance(tactile, FakeTactileConfig):
            world, plan = self._world, _digit_plans(self.config)[number]
            plan = replace(plan.for_lift(world.seed), variation_seed=self.variation_seed)
            return plan.make(world, self.clock, self.faults)
        if isinstance(tactile, OwnTactileConfig):
            return own_source(tactile, self.clock)
        from drivers.video.digit import Digit

        return Digit(
            tactile.serial, tactile.rate_hz, tactile.size_px, address=tactile.address, clock=self.clock
        )

    def _camera(self) -> Camera:
        camera = self.config.require("camera")
        if isinstance(camera, FakeCameraConfig):
            return _camera_plan(self.config).make(self._world, self.clock, self.faults)
        if isinstance(camera, OwnCameraConfig):
            return own_source(camera, self.clock)
        from drivers.video.external_camera import ExternalCamera

        return ExternalCamera(
            camera.serial, camera.address or "", camera.rate_hz, camera.size_px, clock=self.clock
        )


def simulated_bench_plan(config: BenchConfig) -> BenchPlan:
    return BenchPlan(simulated_layout(config), _digit_plans(config), _camera_plan(config))


def simulated_layout(config: BenchConfig) -> BenchLayout:
    """Return the layout of a bench; values that its file lacks are those of the bench `fake`."""
    limits = None if config.gripper is None else config.gripper.limits
    fingers = limits if isinstance(limits, GripperLimitsConfig) else GripperLimitsConfig()
    return BenchLayout(
        Pose(TABLE_M if config.table is None else config.table.position_m),
        home_pose(config) if config.has("arm") else Pose.from_rotation(HOME_M, TOOL_DOWN),
        open_counts=fingers.min_counts,
        max_opening_m=fingers.max_opening_m,
        opening_per_count_m=fingers.opening_per_count_m,
        closed_counts=fingers.max_counts,
    )


def _digit_plans(config: BenchConfig) -> tuple[DigitPlan, ...]:
    return tuple(
        DigitPlan(
            t.serial,
            t.sign,
            t.rate_hz,
            number,
            markers=t.markers,
            difficulty=config.difficulty,
            look=look_of(t),
        )
        for number, t in enumerate(config.tactile)
        if isinstance(t, DrawnTactileSection)
    )


def _camera_plan(config: BenchConfig) -> CameraPlan:
    camera = config.require("camera")
    return CameraPlan(
        camera.serial,
        camera.rate_hz,
        camera.size_px,
        camera.focal_px,
        camera.marker_ids,
        camera.marker_side_m,
        camera.marker_dictionary,
        camera.base_T_camera(),
        printed_target,
    )


@cache
def printed_target(spec: str) -> Sheet:
    """Return the sheet of a calibration target, for the simulated camera. Raises `InputError`."""
    picture = target_picture(spec)
    return Sheet(picture.grey, picture.origin_m, picture.px_per_m)
