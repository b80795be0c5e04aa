"""`rig calibrate gripper, tcp`: the opening over counts, and the tip of a tool, from tables or on a bench.

The tip clamped for `tcp` stands out of the gels, so its point is not the bench file's `tcp_m`, the point
between the gels. A calliper checks the difference: measure from the gels to the point along the tool's axes.
On a bench a person guides the tip into one hole at many tilts.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.gripper import (
    FEWEST,
    STEP_M,
    Direction,
    OpeningSample,
    calibrate_opening,
    calibrate_pivot,
)
from calibration.store import read_yaml
from calibration.verdict import Assessment, Rejected
from drivers.errors import InputError, plural
from drivers.formats import number_in, read_csv_rows
from drivers.types import Pose, Vector3
from protocols.capture_pivot import FIRST_ABOVE_M, SPEED_M_S, capture_pivot
from protocols.capture_touch import Touch, capture_openings
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.plan import PlannedMotion
from rig.calibrate import charts
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions
from rig.calibrate.kind import Differences, Kind, Samples, SerialOption, distance_mm
from rig.calibrate.result import MM, CalibrationResult, Figure
from rig.calibrate.samples import pose_row, read_poses, write_poses, write_table
from rig.config.calibrations import LARGEST_TIP_M
from rig.declared import option

FLANGE, TCP = "flange", "tcp"
"""Values of the column `child_frame` in poses.csv: its rows are base_T_flange or base_T_tcp."""
_BLOCKS_MM = [8.0, 15.0, 25.0, 35.0, 50.0, 65.0, 80.0, 95.0]
"""Default widths of the blocks on a bench."""
_SLACK_M = 0.006
"""How much wider than a block the fingers come down around it, on top of the usual margin."""
_LARGEST_TILT_DEG = 30.0
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
"""The golden angle: any number of directions spread evenly."""


@dataclass(frozen=True)
class GripperOptions:
    """Calibrate the gripper's opening in mm as a monotone function of its counts, and its hysteresis.

    On a bench the fingers close on blocks of known width (8 to 95 mm, or --block-mm) until both gels detect
    contact, then open until the contact is lost.

    The folder of --from holds gripper.csv with the columns counts, opening_mm and direction (closing or
    opening). Openings in another unit than mm are refused: they are compared with the range of the gripper
    of --bench.

    Examples:
      rig calibrate gripper --bench fake
      rig calibrate gripper --from measured --serial R3F-1
    """

    blocks_mm: list[float] | None = option(
        None, "On a bench: width in mm of a block to grasp; repeat for more.", "--block-mm"
    )
    serial: SerialOption = "unknown"


def solve_openings(samples: Samples, options: GripperOptions) -> CalibrationResult:
    """Calibrate the opening from gripper.csv: counts, opening_mm, direction (closing, opening).

    The unit of the table is checked against the bench's gripper, by default a Robotiq 3-Finger.
    """
    path, bench = samples.folder / "gripper.csv", samples.bench
    step_m = STEP_M if bench is None else bench.require("gripper").limits.spec().resolution_m
    measured = []
    for line, row in read_csv_rows(path, ("counts", "opening_mm", "direction")):
        where, way = f"{path} line {line}", row["direction"]
        if way not in list(Direction):
            raise InputError(f"{where}: direction '{way}' is neither closing nor opening")
        counts, opening_m = number_in(row, "counts", where), number_in(row, "opening_mm", where) / 1e3
        measured.append(OpeningSample(f"line {line}", counts, opening_m, Direction(way)))
    result = calibrate_opening(measured, step_m)
    curves = {str(way): (counts, 1e3 * opening_m) for way, (counts, opening_m) in result.tables.items()}
    ranges = {
        way: f"{counts[0]:g} to {counts[-1]:g} counts, {opening_mm[-1]:.1f} to {opening_mm[0]:.1f} mm"
        for way, (counts, opening_mm) in curves.items()
    }
    text = (
        "As measured, monotone in each direction, not extrapolated. The bench uses that of closing fingers."
    )
    labels = "gripper position, counts", "opening, mm", "o-"
    used = result.tables.get(Direction.CLOSING)
    return CalibrationResult(
        "gripper", {"gripper": options.serial},
        {"closing": dict(zip(("counts", "opening_m"), used, strict=True))} if used else {}, result.assessment,
        [
            *(Figure("", text, f"table of {way} fingers") for way, text in ranges.items()),
            Figure("hysteresis_m", result.hysteresis_m, "hysteresis", *MM),
        ],
        source=str(samples.folder), used=len(measured) - len(result.rejected),
        rejected=result.rejected, files=[path],
        pictures=[charts.curves("Opening over counts", text, curves, *labels)] if curves else [],
    )  # fmt: skip


def collect_openings(station: Station, options: GripperOptions) -> list[CalibrationResult]:
    """Close on each block until both gels feel it, open until they do not, and make the tables.

    Raises `InputError` for blocks the fingers cannot take, `OperatorStopError`, `DeviceError`.
    """
    config, blocks_mm = station.config, options.blocks_mm or _BLOCKS_MM
    widest_mm = 1e3 * config.require("gripper").limits.max_opening_m - 10.0
    if min(blocks_mm) < 3.0 or max(blocks_mm) > widest_mm:
        raise InputError(f"blocks of {list(blocks_mm)} mm: between the fingers fit 3 to {widest_mm:.0f} mm")
    raw = station.raw("gripper")
    open_counts = config.require("gripper").limits.min_counts
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
    with station.connection(
        f"The fingers will close gently on {plural(len(touches), 'block')}, one by one, until "
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
    result = solve_openings(Samples(raw, config), replace(options, serial=config.name))
    return [replace(result, simulated=config.simulated)]


@dataclass(frozen=True)
class TipOptions:
    """Calibrate the position of a clamped pointed tip in the flange frame, by pivoting it in a small hole.

    On a bench the fingers hold a pointed tip. The arm tilts it above the hole. You then step it into the hole
    by typing the remaining distance (x y z in mm, base axes), and press Enter alone when it sits.

    The tip is not the bench file's tcp_m, the point between the gels, because it sticks out of the fingers.
    The result gives both, and the vector from tcp_m to the tip along the tool's axes. Measure the same vector
    with a calliper, from the middle of the gels to the tip. If the two differ, correct tcp_m by the
    difference. The calibration does not use tcp_m; it is refused if the tip is more than 50 mm from it.

    The folder of --from holds poses.csv with a row per seated pose. The columns are id, x_m, y_m, z_m; qx,
    qy, qz, qw (or rx_rad, ry_rad, rz_rad, as a UR shows them); and child_frame, which is flange, or tcp for
    poses of the tool centre point of the --bench file. With --bench the tip is compared with its tcp_m.

    Examples:
      rig calibrate tcp --bench fake
      rig calibrate tcp --from pivot
    """

    poses: int = option(12, "On a bench: number of tilts.", min=4, max=60)
    serial: SerialOption = "unknown"
    accept_change: bool = option(
        False, "Accept a tip more than 50 mm from the bench file's tcp_m (--yes alone does not accept it)."
    )


def solve_tip(samples: Samples, options: TipOptions) -> CalibrationResult:
    """Solve poses.csv for the tip in the flange's frame.

    With a bench the tip is compared with its tcp_m, and poses of the TCP are converted to the flange. Raises
    `InputError`.
    """
    path = samples.folder / "poses.csv"
    flange_T_tcp = samples.bench and samples.bench.require("arm").flange_T_tcp()  # noqa: N806 - frame names keep their case
    poses, rejected = _flange_poses(path, flange_T_tcp)
    found = calibrate_pivot(list(poses.items()))
    assessment, layout, pictures = found.assessment, {}, []
    figures = []
    if found.tip_m is not None and found.covariance is not None:
        sigma_m = np.sqrt(np.diag(found.covariance))
        layout = {"parent_frame": FLANGE, "child_frame": "tip"}
        figures += [
            Figure("translation_m", found.tip_m, "clamped tip from the flange, x, y, z", *MM, sigma_m, True),
            Figure("covariance", found.covariance),
        ]
        tips = [pose.translated(*pose.rotation.apply(found.tip_m)) for pose in poses.values()]
        in_3d = "The flange in each pose and the tip that follows from it, in the robot's base frame."
        missed_mm = {name: 1e3 * v for name, v in (found.residual_m or {}).items()}
        of_error = "Distance from the common point to where each pose puts the tip."
        pictures = [
            charts.poses(in_3d, {"flange": list(poses.values()), "tip": tips}),
            charts.bars("Error per pose", of_error, missed_mm, "distance, mm"),
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
                assessment += Assessment(doubts=(text,)) if options.accept_change else refused
            figures += [
                Figure("bench_file_tcp_m", tcp_m, "tcp_m of the bench file, x, y, z", *MM, top=True),
                Figure("tip_from_tcp_m", out_m, "from tcp_m to the tip, tool axes x, y, z", *MM, top=True),
            ]
    figures.append(Figure("cone_deg", found.cone_deg, "largest rotation between poses", ".0f", "degrees"))
    return CalibrationResult(
        "tcp", {"tool": options.serial}, layout, assessment, figures, source=str(samples.folder),
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


def collect_tip(station: Station, options: TipOptions) -> list[CalibrationResult]:
    """Seat the tip in its hole at several tilts and solve for its position in the flange's frame.

    The result does not depend on the configured TCP: poses are stored as base_T_flange. Raises
    `OperatorStopError` unless the operator agrees, `DeviceError`, `InputError`.
    """
    config, count = station.config, options.poses
    flange_T_tcp = config.require("arm").flange_T_tcp()  # noqa: N806 - frame names keep their case
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
    above = Pose(config.require("table").position_m).translated(z_m=FIRST_ABOVE_M).position_m
    planned = [Pose.from_rotation(above, turn * TOOL_DOWN) for turn in tilts(count)]
    motions = [
        PlannedMotion(f"{i:02d} tilted above the hole", pose, (pose,), SPEED_M_S)
        for i, pose in enumerate(planned, start=1)
    ]
    with station.connection(
        f"The arm will take the steps that you choose until a tip in the hand sits in a small hole on the "
        f"table, rise, tilt by up to {_LARGEST_TILT_DEG:.0f} degrees, and come back, {count} times, "
        f"at {SPEED_M_S} m/s.",
        motions=motions,
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        capture_pivot(bench, tilts(count), operator.nudge, keep, station.leave_out)
    tcp_T_flange = flange_T_tcp.inverse()  # noqa: N806
    write_poses(raw, [pose_row(name, pose @ tcp_T_flange) for name, pose in seated], FLANGE)
    result = solve_tip(Samples(raw, config), replace(options, serial=config.name))
    return [replace(result, simulated=config.simulated)]


def tilts(count: int) -> list[Rotation]:
    """Return rotations about horizontal axes: none, then half and full tilt in turn."""
    turns = [Rotation.identity()]
    for i in range(1, count):
        size = np.radians(_LARGEST_TILT_DEG) * (0.5 if i % 2 else 1.0)
        turns.append(Rotation.from_rotvec(size * np.array([np.cos(i * _GOLDEN), np.sin(i * _GOLDEN), 0.0])))
    return turns


def compare_openings(one: Path, other: Path) -> Differences:
    """Return the largest difference of the tables of closing fingers; None without counts in common."""
    tables = [file["closing"] for file in (read_yaml(one), read_yaml(other)) if "closing" in file]
    if len(tables) < 2:
        return {"closing_worst_mm": None}
    at = np.intersect1d(*(np.arange(min(t["counts"]), max(t["counts"]) + 1) for t in tables))
    gaps = np.subtract(*(np.interp(at, t["counts"], t["opening_m"]) for t in tables))
    return {"closing_worst_mm": round(1e3 * float(np.abs(gaps).max()), 3) if len(at) else None}


def compare_tips(one: Path, other: Path) -> Differences:
    return {"move_mm": distance_mm(read_yaml(one), read_yaml(other))}


GRIPPER = Kind("gripper", GripperOptions, "contacts", solve_openings, collect_openings, compare_openings)
TIP = Kind("tcp", TipOptions, "tilts", solve_tip, collect_tip, compare_tips)
