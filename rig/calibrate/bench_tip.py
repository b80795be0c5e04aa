"""The gripper on a bench: its opening over counts, from blocks of known width; and its tool tip.

The tip is put into one hole at many tilts, guided by a person.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_tip import FEWEST, calibrate_pivot
from drivers.errors import InputError, counted
from drivers.types import Pose, Vector3
from protocols.capture_pivot import FIRST_ABOVE_M, SPEED_M_S, PivotCapture, capture_pivot
from protocols.capture_touch import Touch, capture_openings
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.plan import PlannedMotion
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions, write_table
from rig.calibrate.bench_hand_eye import pose_row, write_poses
from rig.calibrate.from_tables import FLANGE, gripper_from_folder, tip_from_folder
from rig.calibrate.result import CalibrationResult
from rig.config import BenchConfig

_SLACK_M = 0.006
"""How much wider than a block the fingers come down around it, on top of the usual margin."""


def collect_openings(station: Station, blocks_mm: Sequence[float]) -> CalibrationResult:
    """Close on each block until both gels feel it, open until they do not, and make the tables.

    Raises `InputError` for blocks the fingers cannot take, `OperatorStopError`, `DeviceError`.
    """
    config = station.config
    widest_mm = 1e3 * config.gripper.limits.max_opening_m - 10.0
    if not blocks_mm or min(blocks_mm) < 3.0 or max(blocks_mm) > widest_mm:
        raise InputError(f"blocks of {list(blocks_mm)} mm: between the fingers fit 3 to {widest_mm:.0f} mm")
    raw = station.raw("gripper")
    open_counts = config.gripper.limits.min_counts
    rows: list[str] = []

    def note(touch: Touch, steps: float, direction: str) -> None:
        counts = open_counts + steps
        rows.append(f"{counts:g},{1e3 * touch.width_m:g},{direction}")
        station.note(f"{touch.name}: {counts:g} counts {direction}", len(rows), 2 * len(touches))

    touches = [
        Touch(
            f"{mm:g}", f"gauge:{mm:g}", f"block {mm:g} mm wide", grasp_at(config), mm / 1e3, slack_m=_SLACK_M
        )
        for mm in sorted(blocks_mm)
    ]
    with station.connected(
        f"The fingers will close gently on {counted(len(touches), 'block')}, one by one, until "
        "both gels feel them.",
        from_home=True,
        motions=touch_motions(config, touches),
    ) as (bench, operator):
        watch = TouchObserver(tuple(tip.sensor.serial for tip in bench.fingertips), shown=station.show)
        capture_openings(
            bench, operator, watch, touches,
            lambda touch, steps: note(touch, steps, "closing"),
            lambda touch, steps: note(touch, steps, "opening"),
        )  # fmt: skip
    write_table(raw / "gripper.csv", "counts,opening_mm,direction", rows)
    step_m = config.gripper.limits.spec().resolution_m
    return gripper_from_folder(raw, config.name, step_m).marked(config.simulated)


_LARGEST_TILT_DEG = 30.0
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""The golden angle: any number of directions spread evenly."""


def collect_tip(station: Station, count: int, accept_change: bool = False) -> CalibrationResult:
    """Seat the tip in its hole at `count` tilts and solve for its position in the flange's frame.

    The result does not depend on the configured TCP: poses are stored as base_T_flange. accept_change: see
    `tip_from_folder`. Raises `OperatorStopError` unless the operator agrees, `DeviceError`, `InputError`.
    """
    config = station.config
    flange_T_tcp = config.arm.flange_T_tcp()  # noqa: N806 - frame names keep their case
    raw = station.raw("tcp")
    seated: list[tuple[str, Pose]] = []

    def keep(capture: PivotCapture) -> Vector3 | None:
        seated.append((capture.id, capture.base_T_tcp))
        station.note(f"{capture.id}: seated, {len(seated)} of {count}", len(seated), count)
        found = calibrate_pivot(seated).tip_m if len(seated) >= FEWEST else None
        if found is None:
            return None
        x, y, z = (float(v) for v in found)
        return x, y, z

    with station.connected(
        f"The arm will take the steps that you choose until a tip in the hand sits in a small hole on the "
        f"table, rise, tilt by up to {_LARGEST_TILT_DEG:.0f} degrees, and come back, {count} times, "
        f"at {SPEED_M_S} m/s.",
        motions=_tilted(config, count),
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        capture_pivot(bench, tilts(count), operator.nudge, keep, station.left_out)
    tcp_T_flange = flange_T_tcp.inverse()  # noqa: N806
    write_poses(raw, [pose_row(name, pose @ tcp_T_flange) for name, pose in seated], FLANGE)
    return tip_from_folder(raw, config.name, flange_T_tcp, accept_change).marked(config.simulated)


def _tilted(config: BenchConfig, count: int) -> list[PlannedMotion]:
    """Return the tilted poses above the mark, assuming that the tool now points down."""
    above = Pose(config.table.position_m).translated(z_m=FIRST_ABOVE_M).position_m
    poses = [Pose.from_rotation(above, turn * TOOL_DOWN) for turn in tilts(count)]
    return [
        PlannedMotion(f"{i:02d} tilted above the hole", pose, (pose,), SPEED_M_S)
        for i, pose in enumerate(poses, start=1)
    ]


def tilts(count: int) -> list[Rotation]:
    """Return rotations about horizontal axes: none, then half and full tilt in turn."""
    turns = [Rotation.identity()]
    for i in range(1, count):
        size = np.radians(_LARGEST_TILT_DEG) * (0.5 if i % 2 else 1.0)
        turns.append(Rotation.from_rotvec(size * np.array([np.cos(i * _GOLDEN), np.sin(i * _GOLDEN), 0.0])))
    return turns
