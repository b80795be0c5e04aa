"""`rig calibrate gripper, tcp`: the opening over counts, and the tip of a tool, from tables or on a bench.

The tip clamped for `tcp` stands out of the gels, so its point is not the bench file's `tcp_m`, the point
between the gels. A calliper checks the difference: measure from the gels to the point along the tool's axes.
On a bench a person guides the tip into one hole at many tilts.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.gripper import (
    FEWEST,
    STEP_M,
    Array,
    Direction,
    OpeningSample,
    calibrate_opening,
    calibrate_pivot,
)
from calibration.verdict import Assessment, Rejected
from drivers.errors import InputError, counted
from drivers.formats import number_in, read_csv_rows
from drivers.types import Pose, Vector3
from protocols.capture_pivot import FIRST_ABOVE_M, SPEED_M_S, capture_pivot
from protocols.capture_touch import Touch, capture_openings
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.plan import PlannedMotion
from rig.calibrate import figures
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions
from rig.calibrate.result import CalibrationResult
from rig.calibrate.samples import pose_row, read_poses, write_poses, write_table
from rig.config.calibrations import LARGEST_TIP_M

FLANGE, TCP = "flange", "tcp"
"""Values of the column `child_frame` in poses.csv: its rows are base_T_flange or base_T_tcp."""
_SLACK_M = 0.006
"""How much wider than a block the fingers come down around it, on top of the usual margin."""
_LARGEST_TILT_DEG = 30.0
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""The golden angle: any number of directions spread evenly."""


def gripper_from_folder(folder: Path, serial: str, step_m: float = STEP_M) -> CalibrationResult:
    """Calibrate the opening from gripper.csv: counts, opening_mm, direction (closing, opening).

    step_m: change of this gripper's opening per count, against which the unit of the table is checked.
    """
    path = folder / "gripper.csv"
    samples = []
    for line, row in read_csv_rows(path, ("counts", "opening_mm", "direction")):
        where, way = f"{path} line {line}", row["direction"]
        if way not in list(Direction):
            raise InputError(f"{where}: direction '{way}' is neither closing nor opening")
        counts, opening_m = number_in(row, "counts", where), number_in(row, "opening_mm", where) / 1e3
        samples.append(OpeningSample(f"line {line}", counts, opening_m, Direction(way)))
    result = calibrate_opening(samples, step_m)
    curves = {str(way): (counts, 1e3 * opening_m) for way, (counts, opening_m) in result.tables.items()}
    numbers = {
        way: f"{counts[0]:g} to {counts[-1]:g} counts, {opening_mm[-1]:.1f} to {opening_mm[0]:.1f} mm"
        for way, (counts, opening_mm) in curves.items()
    }
    if result.hysteresis_m is not None:
        numbers["hysteresis"] = f"{1e3 * result.hysteresis_m:.2f} mm"
    text = (
        "As measured, monotone in each direction, not extrapolated. The bench uses that of closing fingers."
    )
    labels = "gripper position, counts", "opening, mm", "o-"
    used = result.tables.get(Direction.CLOSING)
    return CalibrationResult(
        "gripper", {"gripper": serial},
        {"closing": dict(zip(("counts", "opening_m"), used, strict=True))} if used else {}, result.assessment,
        quality={} if result.hysteresis_m is None else {"hysteresis_m": result.hysteresis_m},
        source=str(folder), numbers=numbers, used=len(samples) - len(result.rejected),
        rejected=result.rejected, files=[path],
        pictures=[figures.curves("Opening over counts", text, curves, *labels)] if curves else [],
    )  # fmt: skip


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


def tip_from_folder(
    folder: Path,
    serial: str,
    flange_T_tcp: Pose | None = None,  # noqa: N803 - frame names keep their case
    accept_change: bool = False,
) -> CalibrationResult:
    """Solve poses.csv for the tip in the flange's frame.

    flange_T_tcp: the configured tool, None without a bench file; the tip is compared with it, and poses of
    the TCP are converted with it. accept_change: accept a tip beyond `LARGEST_TIP_M`. Raises `InputError`.
    """
    path = folder / "poses.csv"
    poses, rejected = _flange_poses(path, flange_T_tcp)
    found = calibrate_pivot(list(poses.items()))
    assessment, quality, value = found.assessment, {"cone_deg": found.cone_deg}, {}
    numbers, pictures = {}, []
    if found.tip_m is not None and found.covariance is not None:
        sigma = np.sqrt(np.diag(found.covariance))
        value = {"parent_frame": FLANGE, "child_frame": "tip", "translation_m": found.tip_m}
        quality |= {"covariance": found.covariance, "sigma_m": sigma}
        numbers = {
            "point of the clamped tip, from the flange": _mm(found.tip_m),
            "one sigma": _mm(sigma),
            "largest turn": f"{found.cone_deg:.0f} degrees",
        }
        tips = [pose.translated(*pose.rotation.apply(found.tip_m)) for pose in poses.values()]
        in_3d = "The flange in each pose and the tip that follows from it, in the robot's base frame."
        missed_mm = {name: 1e3 * v for name, v in (found.residual_m or {}).items()}
        of_error = "Distance from the common point to where each pose puts the tip."
        pictures = [
            figures.poses(in_3d, {"flange": list(poses.values()), "tip": tips}),
            figures.bars("Error per pose", of_error, missed_mm, "distance, mm"),
        ]
        if flange_T_tcp is not None:
            tcp_m = np.asarray(flange_T_tcp.position_m)
            out_m = flange_T_tcp.rotation.inv().apply(found.tip_m - tcp_m)
            apart_m = float(np.linalg.norm(out_m))
            if apart_m > LARGEST_TIP_M:
                text = (
                    f"the tip is {1e3 * apart_m:.0f} mm from the bench file's tcp_m, and a clamped tip is "
                    f"within {1e3 * LARGEST_TIP_M:.0f} mm of it: check tcp_m and the mounted hand"
                )
                cure = "if the tip is right, solve its samples with --from and --accept-change"
                refused = Assessment((f"{text}; {cure}",))
                assessment += Assessment(doubts=(text,)) if accept_change else refused
            value |= {"bench_file_tcp_m": tcp_m, "tip_from_tcp_m": out_m}
            numbers |= {
                "tcp_m of the bench file, from the flange": _mm(tcp_m),
                "from tcp_m to the tip, along the tool's axes": _mm(out_m),
            }
    return CalibrationResult(
        "tcp", {"tool": serial}, value, assessment, quality=quality, source=str(folder), numbers=numbers,
        used=len(found.residual_m or ()), rejected=[*rejected, *found.rejected], files=[path],
        pictures=pictures,
    )  # fmt: skip


def _flange_poses(path: Path, flange_T_tcp: Pose | None) -> tuple[dict[str, Pose], list[Rejected]]:  # noqa: N803
    """Return `base_T_flange` by id, and the invalid rows. Raises `InputError` if their frame is unknown."""
    frames = {row.get("child_frame", "") for _, row in read_csv_rows(path)}
    poses, rejected = read_poses(path)
    if frames <= {FLANGE}:
        return poses, rejected
    if frames != {TCP}:
        raise InputError(
            f"{path}: the frame of its poses is not stated: add a column child_frame with 'flange' in each "
            "row, or with 'tcp' for poses of the tool centre point"
        )
    if flange_T_tcp is None:
        raise InputError(
            f"{path}: holds poses of the tool centre point: give --bench with the bench file of the "
            "recording, whose tcp_m converts them to the flange"
        )
    tcp_T_flange = flange_T_tcp.inverse()  # noqa: N806
    return {name: pose @ tcp_T_flange for name, pose in poses.items()}, rejected


def _mm(point_m: Array) -> str:
    return ", ".join(f"{axis} {1e3 * v:.2f}" for axis, v in zip("xyz", point_m, strict=True)) + " mm"


def collect_tip(station: Station, count: int, accept_change: bool = False) -> CalibrationResult:
    """Seat the tip in its hole at `count` tilts and solve for its position in the flange's frame.

    The result does not depend on the configured TCP: poses are stored as base_T_flange. accept_change: see
    `tip_from_folder`. Raises `OperatorStopError` unless the operator agrees, `DeviceError`, `InputError`.
    """
    config = station.config
    flange_T_tcp = config.arm.flange_T_tcp()  # noqa: N806 - frame names keep their case
    raw = station.raw("tcp")
    seated: list[tuple[str, Pose]] = []

    def keep(name: str, base_T_tcp: Pose) -> Vector3 | None:  # noqa: N803
        seated.append((name, base_T_tcp))
        station.note(f"{name}: seated, {len(seated)} of {count}", len(seated), count)
        found = calibrate_pivot(seated).tip_m if len(seated) >= FEWEST else None
        if found is None:
            return None
        x, y, z = (float(v) for v in found)
        return x, y, z

    # assuming that the tool now points down
    above = Pose(config.table.position_m).translated(z_m=FIRST_ABOVE_M).position_m
    planned = [Pose.from_rotation(above, turn * TOOL_DOWN) for turn in tilts(count)]
    motions = [
        PlannedMotion(f"{i:02d} tilted above the hole", pose, (pose,), SPEED_M_S)
        for i, pose in enumerate(planned, start=1)
    ]
    with station.connected(
        f"The arm will take the steps that you choose until a tip in the hand sits in a small hole on the "
        f"table, rise, tilt by up to {_LARGEST_TILT_DEG:.0f} degrees, and come back, {count} times, "
        f"at {SPEED_M_S} m/s.",
        motions=motions,
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        capture_pivot(bench, tilts(count), operator.nudge, keep, station.left_out)
    tcp_T_flange = flange_T_tcp.inverse()  # noqa: N806
    write_poses(raw, [pose_row(name, pose @ tcp_T_flange) for name, pose in seated], FLANGE)
    return tip_from_folder(raw, config.name, flange_T_tcp, accept_change).marked(config.simulated)


def tilts(count: int) -> list[Rotation]:
    """Return rotations about horizontal axes: none, then half and full tilt in turn."""
    turns = [Rotation.identity()]
    for i in range(1, count):
        size = np.radians(_LARGEST_TILT_DEG) * (0.5 if i % 2 else 1.0)
        turns.append(Rotation.from_rotvec(size * np.array([np.cos(i * _GOLDEN), np.sin(i * _GOLDEN), 0.0])))
    return turns
