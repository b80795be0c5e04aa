"""The tool tip on a bench: in one hole at many tilts, guided by a person."""

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_tip import FEWEST, calibrate_pivot
from drivers.types import Pose, Vector3
from protocols.capture_pivot import FIRST_ABOVE_M, SPEED_M_S, PivotCapture, capture_pivot
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.plan import PlannedMotion
from rig.calibrate.bench import Station
from rig.calibrate.bench_hand_eye import pose_row, write_poses
from rig.calibrate.clamped_tip import FLANGE, tip_from_folder
from rig.calibrate.result import CalibrationResult
from rig.config import BenchConfig

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
        return _tip(seated)

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
    """The tilts above the mark, as far as they are known: the tool as it stands, taken to point down."""
    above = Pose(config.table.position_m).translated(z_m=FIRST_ABOVE_M).position_m
    poses = [Pose.from_rotation(above, turn * TOOL_DOWN) for turn in tilts(count)]
    return [
        PlannedMotion(f"{i:02d} tilted above the hole", pose, (pose,), SPEED_M_S)
        for i, pose in enumerate(poses, start=1)
    ]


def tilts(count: int) -> list[Rotation]:
    """Turns about level axes all round, the first one none, then alternately half and fully tilted."""
    turns = [Rotation.identity()]
    for i in range(1, count):
        size = np.radians(_LARGEST_TILT_DEG) * (0.5 if i % 2 else 1.0)
        turns.append(Rotation.from_rotvec(size * np.array([np.cos(i * _GOLDEN), np.sin(i * _GOLDEN), 0.0])))
    return turns


def _tip(seated: list[tuple[str, Pose]]) -> Vector3 | None:
    """The tip in the TCP's frame, m, from `base_T_tcp` by id; None if these poses do not determine it."""
    found = calibrate_pivot(seated).tip_m if len(seated) >= FEWEST else None
    if found is None:
        return None
    x, y, z = (float(v) for v in found)
    return x, y, z
