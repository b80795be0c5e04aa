"""`rig calibrate gripper, sync, tcp`: tables and streams from a folder.

The tip clamped for `tcp` stands out of the gels, so its point is not the bench file's `tcp_m`, the point
between the gels. A calliper checks the difference: measure from the gels to the point along the tool's axes.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.opening import STEP_M, Direction, OpeningSample, calibrate_opening
from calibration.time_offset import TimeOffset, time_offset
from calibration.timed_signal import TimedSignal
from calibration.tool_tip import Array, PivotResult, calibrate_pivot
from calibration.verdict import Assessment, Rejected
from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.formats import number_in, read_csv_rows
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture
from rig.calibrate.sources import read_poses, read_stream
from rig.config.calibrations import LARGEST_TIP_M


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
    numbers, curves = {}, {}
    for way, table in result.tables.items():
        counts, opening_mm = table.counts, 1e3 * table.opening_m
        curves[str(way)] = counts, opening_mm
        ends_mm = f"{opening_mm[-1]:.1f} to {opening_mm[0]:.1f} mm"
        numbers[str(way)] = f"{counts[0]:g} to {counts[-1]:g} counts, {ends_mm}"
    if result.hysteresis_m is not None:
        numbers["hysteresis"] = f"{1e3 * result.hysteresis_m:.2f} mm"
    text = (
        "As measured, monotone in each direction, not extrapolated. The bench uses that of closing fingers."
    )
    used = result.tables.get(Direction.CLOSING)
    return CalibrationResult(
        "gripper",
        {"gripper": serial},
        result.assessment,
        str(folder),
        {"closing": {"counts": used.counts, "opening_m": used.opening_m}} if used else {},
        {} if result.hysteresis_m is None else {"hysteresis_m": result.hysteresis_m},
        numbers,
        len(samples) - len(result.rejected),
        result.rejected,
        [path],
        [
            Picture(
                "Opening over counts",
                text,
                figures.curves(curves, "gripper position, counts", "opening, mm", "o-"),
            )
        ]
        if curves
        else [],
    )


def sync_from_folder(folder: Path, first: str, second: str, search_s: float) -> CalibrationResult:
    """Find the offset of two CSV files of one motion, `<name>.csv` with time_ns (or t_s) and value."""
    paths = [folder / f"{name}.csv" for name in (first, second)]
    one, other = (read_stream(path) for path in paths)
    found = time_offset(one, other, search_s)
    quality = {
        "sigma_s": found.sigma_s,
        "drift_sigma_ppm": found.drift_sigma_ppm,
        "explained": found.explained,
    }
    result = CalibrationResult(
        "sync",
        {"reference": first, "stream": second},
        found.assessment,
        str(folder),
        quality={name: value for name, value in quality.items() if value is not None},
        used=found.used,
        files=paths,
    )
    return result if found.offset_s is None else _with_offset(result, found, found.offset_s, one, other)


def _with_offset(
    result: CalibrationResult, found: TimeOffset, offset_s: float, one: TimedSignal, other: TimedSignal
) -> CalibrationResult:
    """Add the offset, its figures, and both streams on one time axis."""
    first, second = result.serials.values()
    numbers = {
        "to add to the stream": f"{1e3 * offset_s:.3f} ± {1e3 * (found.sigma_s or 0.0):.3f} ms",
        "motion explained": f"{found.explained:.1%}",
    }
    if found.drift_ppm is not None:
        numbers["drift of the clocks"] = (
            f"{found.drift_ppm:.2f} ± {found.drift_sigma_ppm:.2f} ppm; the bench uses the offset alone"
        )
    zero = one.time_ns[0]
    shown = {
        first: ((one.time_ns - zero) / NS_PER_S, one.values - one.values.mean()),
        f"{second}, moved": (
            (other.time_ns - zero) / NS_PER_S + offset_s,
            (other.values - other.values.mean()) / (found.gain or 1.0),
        ),
    }
    text = "The second is shifted by the offset and scaled; both should coincide."
    return replace(
        result,
        value={
            "reference": first,
            "stream": second,
            "add_to_stream_s": offset_s,
            "drift_ppm": found.drift_ppm,
        },
        numbers=numbers,
        pictures=[Picture("Both streams", text, figures.curves(shown, "time, s", "value without its mean"))],
    )


FLANGE, TCP = "flange", "tcp"
"""Values of the column `child_frame` in poses.csv: its rows are base_T_flange or base_T_tcp."""


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
    result = CalibrationResult(
        "tcp",
        {"tool": serial},
        found.assessment,
        str(folder),
        quality={"cone_deg": found.cone_deg},
        used=len(found.residual_m or ()),
        rejected=[*rejected, *found.rejected],
        files=[path],
    )
    if found.tip_m is None or found.covariance is None:
        return result
    result = _with_tip(result, found, found.tip_m, found.covariance)
    tips = [pose.translated(*pose.rotation.apply(found.tip_m)) for pose in poses.values()]
    text = "The flange in each pose and the tip that follows from it, in the robot's base frame."
    shown = Picture("Poses in 3D", text, figures.poses({"flange": list(poses.values()), "tip": tips}))
    result = replace(result, pictures=[shown, *result.pictures])
    return result if flange_T_tcp is None else _compared(result, found.tip_m, flange_T_tcp, accept_change)


def _with_tip(
    result: CalibrationResult, found: PivotResult, tip_m: Array, covariance: Array
) -> CalibrationResult:
    sigma = np.sqrt(np.diag(covariance))
    missed = {name: 1e3 * v for name, v in (found.residual_m or {}).items()}
    text = "Distance from the common point to where each pose puts the tip."
    return replace(
        result,
        value={"parent_frame": FLANGE, "child_frame": "tip", "translation_m": tip_m},
        quality={**result.quality, "covariance": covariance, "sigma_m": sigma},
        numbers={
            "point of the clamped tip, from the flange": _mm(tip_m),
            "one sigma": _mm(sigma),
            "largest turn": f"{found.cone_deg:.0f} degrees",
        },
        pictures=[Picture("Error per pose", text, figures.bars(missed, "distance, mm"))],
    )


def _compared(
    result: CalibrationResult,
    tip_m: Array,
    flange_T_tcp: Pose,  # noqa: N803
    accept_change: bool,
) -> CalibrationResult:
    """Add the configured TCP, and the way from it to the tip along the tool's axes."""
    tcp_m = np.asarray(flange_T_tcp.position_m)
    out_m = flange_T_tcp.rotation.inv().apply(tip_m - tcp_m)
    return replace(
        result,
        assessment=result.assessment + _change(float(np.linalg.norm(out_m)), accept_change),
        value={**result.value, "bench_file_tcp_m": tcp_m, "tip_from_tcp_m": out_m},
        numbers={
            **result.numbers,
            "tcp_m of the bench file, from the flange": _mm(tcp_m),
            "from tcp_m to the tip, along the tool's axes": _mm(out_m),
        },
    )


def _change(apart_m: float, accepted: bool) -> Assessment:
    if apart_m <= LARGEST_TIP_M:
        return Assessment()
    text = (
        f"the tip is {1e3 * apart_m:.0f} mm from the bench file's tcp_m, and a clamped tip is within "
        f"{1e3 * LARGEST_TIP_M:.0f} mm of it: check tcp_m and the mounted hand"
    )
    if accepted:
        return Assessment(doubts=(text,))
    return Assessment((f"{text}; if the tip is right, solve its samples with --from and --accept-change",))


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
