"""From a bench file to a bench: the one module that names concrete devices."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

from scipy.spatial.transform import Rotation

from calibration.targets.sheets import target_picture
from drivers.bench import Bench, Fingertip, Hand
from drivers.clock import SystemClock, to_ns
from drivers.interfaces import Arm, Camera, Gripper, TactileSensor
from drivers.named_classes import is_class_name
from drivers.types import HandState, Holding, Image, Pose
from fakes.clock import SimulatedClock
from fakes.devices.arm import FakeArm
from fakes.devices.digit import FakeDigit
from fakes.devices.gripper import FakeGripper
from fakes.devices.plan import BenchPlan, CameraPlan, DigitPlan
from fakes.faults import FaultScript, ScriptedFault
from fakes.world.fixture import Sheet
from fakes.world.state import BenchLayout
from fakes.world.world import World
from protocols.operator import Operator
from rig.bench.operators import SimulatedOperator
from rig.bench.own_devices import own_arm, own_gripper, own_source
from rig.bench.twins import laid_as
from rig.config import BenchConfig, CameraConfig, TactileConfig

LED_S = 3.0
"""How long a simulated person takes to lead the arm to a place."""
TOOL_DOWN = Rotation.from_euler("x", 180, degrees=True)


def build_bench(
    config: BenchConfig,
    seed: int = 0,
    lift: str = "",
    attempt: int = 0,
    realtime: bool = False,
    variation_seed: int | None = None,
    watch: Callable[[World], None] | None = None,
) -> tuple[Bench, Operator]:
    """Make a bench of simulated devices in this process, and the operator who goes with it.

    seed: of the simulated world. lift, attempt: choose the scripted faults that apply.
    variation_seed: draws tactile sensors unlike those of a bench, None for the bench's own. watch: is given
    the world, as a benchmark needs that asks what truly happened.
    """
    plan = simulated_bench_plan(config)
    world = World(plan.layout, seed)
    if watch is not None:
        watch(world)
    clock = SimulatedClock(realtime)
    scripted = [ScriptedFault(**fault.model_dump()) for fault in config.faults]
    faults = FaultScript(tuple(fault for fault in scripted if fault.concerns(lift, attempt)))
    arm = simulated_arm(config, world, clock, faults)
    bench = Bench(
        name=config.name,
        simulated=True,
        clock=clock,
        arm=arm,
        gripper=FakeGripper(world, clock, faults, config.gripper_spec(), config.gripper.period_s),
        fingertips=tuple(
            Fingertip(
                replace(digit.slowed(seed), variation_seed=variation_seed).make(world, clock, faults),
                tactile.finger,
                tactile.sign,
            )
            for digit, tactile in zip(plan.digits, config.tactile, strict=True)
        ),
        camera=plan.camera.make(world, clock, faults),
        base_T_camera=config.base_T_camera(),
        base_T_table=world.layout.base_T_table,
        base_T_home=world.layout.home,
        hand=Hand(HandState(Holding.FREE)),
    )

    def lay(object_id: str) -> None:
        world.lay(laid_as(config.objects, object_id))

    def lead(to: Pose) -> Callable[[], bool]:
        there_ns = clock.now_ns() + to_ns(LED_S)
        arm.lead(to, LED_S)
        return lambda: clock.now_ns() >= there_ns

    return bench, SimulatedOperator(lay, lambda: world.gap_at(clock.now_ns()), seed, lead=lead)


def simulated_arm(config: BenchConfig, world: World, clock: SimulatedClock, faults: FaultScript) -> FakeArm:
    """Make the arm of a simulated bench, with the limits of its bench file."""
    joints = config.arm.limits.joint_limits_rad()
    return FakeArm(world, clock, faults, config.arm_limits(), joints)


def home_pose(config: BenchConfig) -> Pose:
    """`base_T_tcp` of the arm at home: where the bench file says, the tool pointing down."""
    return Pose.from_rotation(config.arm.home_m, TOOL_DOWN)


def true_masks(bench: Bench) -> dict[str, Callable[[int], Image]]:
    """Return, by serial, what simulated fingertips truly touch at a time in ns: (H, W) uint8, 0 or 255.

    Empty for a bench that is not in this process. For labels of simulated images alone.
    """
    sensors = [tip.sensor for tip in bench.fingertips]
    return {sensor.serial: sensor.true_mask for sensor in sensors if isinstance(sensor, FakeDigit)}


def build_real_bench(config: BenchConfig, hand: Hand | None = None) -> Bench:
    """Make the real drivers of a bench file; nothing is connected yet, and nothing moves.

    hand: what is known of it, by default nothing. The makers' libraries are imported here at the
    earliest, each by the driver that needs it, and so are drivers that are somebody's own. Raises
    `InputError` where one of those cannot be made.
    """
    clock = SystemClock()
    return Bench(
        name=config.name,
        simulated=config.simulated,
        clock=clock,
        arm=_arm(config, clock),
        gripper=_gripper(config, clock),
        fingertips=tuple(Fingertip(_digit(t, clock), t.finger, t.sign) for t in config.tactile),
        camera=_camera(config.camera, clock),
        base_T_camera=config.base_T_camera(),
        base_T_table=Pose(config.table.position_m),
        base_T_home=home_pose(config),
        hand=hand or Hand(),
    )


def _arm(config: BenchConfig, clock: SystemClock) -> Arm:
    if is_class_name(config.arm.driver):
        return own_arm(config, clock)
    from drivers.ur5e.arm import UR5e

    arm = config.arm
    return UR5e(
        host=arm.host or "",
        limits=config.arm_limits(),
        flange_T_tcp=arm.flange_T_tcp(),
        payload_kg=arm.payload_kg,
        payload_cog_m=arm.payload_cog_m,
        joint_limits_rad=arm.limits.joint_limits_rad(),
        frequency_hz=arm.frequency_hz,
        clock=clock,
    )


def _gripper(config: BenchConfig, clock: SystemClock) -> Gripper:
    if is_class_name(config.gripper.driver):
        return own_gripper(config, clock)
    from drivers.robotiq_3f.gripper import Robotiq3F, rtu_link, tcp_link

    gripper = config.gripper
    if gripper.transport == "rtu":
        link = rtu_link(gripper.device or "")
    else:
        link = tcp_link(gripper.host or "", gripper.port, gripper.preset or "tcp")
    return Robotiq3F(
        link, gripper.fingers, config.gripper_spec(), clock, open_counts=gripper.limits.min_counts
    )


def _digit(tactile: TactileConfig, clock: SystemClock) -> TactileSensor:
    if is_class_name(tactile.driver):
        return own_source(tactile, clock)
    from drivers.video.digit import Digit

    return Digit(tactile.serial, tactile.rate_hz, tactile.size_px, address=tactile.address, clock=clock)


def _camera(camera: CameraConfig, clock: SystemClock) -> Camera:
    if is_class_name(camera.driver):
        return own_source(camera, clock)
    from drivers.video.external_camera import ExternalCamera

    return ExternalCamera(camera.serial, camera.address or "", camera.rate_hz, camera.size_px, clock=clock)


def simulated_bench_plan(config: BenchConfig) -> BenchPlan:
    """What the simulated bench of a bench file is made of."""
    camera, fingers = config.camera, config.gripper.limits
    return BenchPlan(
        BenchLayout(
            Pose(config.table.position_m),
            home_pose(config),
            open_counts=fingers.min_counts,
            max_opening_m=fingers.max_opening_m,
            opening_per_count_m=fingers.opening_per_count_m,
            closed_counts=fingers.max_counts,
        ),
        tuple(
            DigitPlan(t.serial, t.sign, t.rate_hz, number, markers=t.markers, difficulty=config.difficulty)
            for number, t in enumerate(config.tactile)
        ),
        CameraPlan(
            camera.serial,
            camera.rate_hz,
            camera.size_px,
            camera.focal_px,
            camera.marker_ids,
            camera.marker_side_m,
            camera.marker_dictionary,
            camera.base_T_camera(),
            printed_target,
        ),
    )


@cache
def printed_target(spec: str) -> Sheet:
    """The sheet of a calibration target, for the simulated camera. Raises `InputError`."""
    picture = target_picture(spec)
    return Sheet(picture.grey, picture.origin_m, picture.px_per_m)
