"""The steps that experiments are made of, each a few driver calls."""

from drivers.bench import Bench
from drivers.errors import DeviceError, GraspError, GripperFaultError, ProtectiveStopError
from drivers.interfaces import Motion
from drivers.types import Pose
from protocols.observer import LiftObserver, Phase
from protocols.operator import Operator
from protocols.pump import Pump

TRAVEL_SPEED_M_S = 0.25
LOWER_SPEED_M_S = 0.10
ACCELERATION_M_S2 = 1.0
MOTION_TIMEOUT_S = 15.0
CLEARANCE_M = 0.10
"""Height above the grasp from which it is approached and to which the hand retreats."""
MARGIN_M = 0.003
"""How much wider than the object the fingers stand before the careful closing begins."""
STEP_SETTLE_S = 0.05
MAX_STEPS = 24


def make_ready(bench: Bench, operator: Operator, after_fault: bool = False) -> None:
    """Release a protective stop, activate the gripper, let go of a leftover object: each where needed.

    Each is asked for first: what follows a fault by somebody who looks at the bench, and the
    activation because the fingers sweep their range.
    """
    bench.arm.recover(operator.look)
    _activate(bench, operator)
    if after_fault:
        operator.look(
            "The last lift ended in a fault. Hold the object if it is still between the fingers: "
            "shall they open now, and the arm rise?"
        )
        _let_go(bench)


def _activate(bench: Bench, operator: Operator) -> None:
    try:
        if bench.gripper.state().activated:
            return
        operator.confirm("The gripper is not activated. Activate it now? Its fingers sweep their range.")
    except GripperFaultError as error:
        operator.look(f"{error}. Activate it now? Its fingers sweep their range and drop what they hold.")
    bench.gripper.activate()


def _let_go(bench: Bench) -> None:
    """Open the fingers where they are, and rise straight up to where nothing stands in the way."""
    bench.gripper.move_to(bench.gripper.limits.min_counts).wait(MOTION_TIMEOUT_S)
    pose = bench.arm.state().base_T_tcp
    rise = bench.base_T_table.position_m[2] + CLEARANCE_M - pose.position_m[2]
    if rise > 0.0:
        move(bench, pose.translated(z_m=rise), LOWER_SPEED_M_S).wait(MOTION_TIMEOUT_S)


def approach(bench: Bench, base_T_grasp: Pose, width_m: float) -> None:  # noqa: N803
    """Open the fingers a little wider than the object and come down around it."""
    limits = bench.gripper.limits
    bench.gripper.move_to(limits.counts_for_opening(width_m + 2 * MARGIN_M)).wait(MOTION_TIMEOUT_S)
    for pose in (base_T_grasp.translated(z_m=CLEARANCE_M), base_T_grasp):
        move(bench, pose, TRAVEL_SPEED_M_S).wait(MOTION_TIMEOUT_S)


def start_watching(bench: Bench, watch: LiftObserver, reference_s: float) -> Pump:
    """Begin to deliver frames: of the untouched gels for so long, then of the grasp."""
    pump = Pump(bench, watch)
    pump.start()
    watch.phase(Phase.REFERENCE, pump.seen_ns)
    pump.run_for(reference_s)
    watch.phase(Phase.GRASP, pump.seen_ns)
    return pump


def close_to_contact(bench: Bench, pump: Pump, watch: LiftObserver) -> int:
    """Close in one-count steps until both fingertips touch; return the counts at that point.

    The gripper pushes with 15 N at the least when told a force (manual, rFR), ten times too
    much: position steps with the tactile image as the stop are the light grip.
    Raises `GraspError` when the fingers meet nothing.
    """
    counts = bench.gripper.state().position_counts
    for _ in range(min(MAX_STEPS, bench.gripper.limits.max_counts - counts)):
        if all(watch.touching(tip.sensor.serial) for tip in bench.fingertips):
            return counts
        counts += 1
        step_fingers(bench, pump, watch, counts)
    raise GraspError(
        f"gripper: no contact on both fingertips, closed step by step to {counts} counts; "
        "check that the object lies in its place and that its width in the object file is right"
    )


def tighten(bench: Bench, pump: Pump, watch: LiftObserver, from_counts: int, by_counts: int) -> int:
    """Close by so many counts, one at a time; return the counts then."""
    for counts in range(from_counts + 1, from_counts + by_counts + 1):
        step_fingers(bench, pump, watch, counts)
    return from_counts + by_counts


def step_fingers(bench: Bench, pump: Pump, watch: LiftObserver, counts: int) -> None:
    """Move the fingers to `counts` while frames keep coming, and let the gel settle."""
    pump.run_until(bench.gripper.move_to(counts).done, MOTION_TIMEOUT_S)
    watch.gripper(bench.gripper.state())
    pump.run_for(STEP_SETTLE_S)


def lift(bench: Bench, base_T_grasp: Pose, height_m: float, duration_s: float) -> Motion:  # noqa: N803
    """Start lifting straight up; return the motion."""
    speed = height_m / (0.8 * duration_s)  # a fifth of the time each for speeding up and slowing down
    acceleration = speed / (0.2 * duration_s)
    return bench.arm.move_linear(base_T_grasp.translated(z_m=height_m), speed, acceleration)


def lower_and_release(bench: Bench, base_T_grasp: Pose, width_m: float) -> None:  # noqa: N803
    """Set the object down, open the fingers, and retreat upwards."""
    limits = bench.gripper.limits
    move(bench, base_T_grasp, LOWER_SPEED_M_S).wait(MOTION_TIMEOUT_S)
    bench.gripper.move_to(limits.counts_for_opening(width_m + 2 * MARGIN_M)).wait(MOTION_TIMEOUT_S)
    move(bench, base_T_grasp.translated(z_m=CLEARANCE_M), TRAVEL_SPEED_M_S).wait(MOTION_TIMEOUT_S)


def make_safe(bench: Bench, base_T_grasp: Pose, width_m: float) -> str:  # noqa: N803
    """End whatever was going on: stop, then set the object down. Returns what was reached.

    Where the arm or the gripper refuse, the grip stays closed: holding is safer than dropping.
    """
    bench.arm.stop()
    try:
        lower_and_release(bench, base_T_grasp, width_m)
    except ProtectiveStopError:
        return "arm in protective stop, fingers left closed"
    except DeviceError as error:
        return f"stopped, fingers left as they are ({error})"
    return "object set down, fingers open, arm retreated"


def move(bench: Bench, target: Pose, speed_m_s: float) -> Motion:
    """Start a straight motion at the steps' acceleration; return it."""
    return bench.arm.move_linear(target, speed_m_s, ACCELERATION_M_S2)
