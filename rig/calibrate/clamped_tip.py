"""`rig calibrate tcp`: the point of a tip clamped in the fingers, seen from the flange.

The clamped tip stands out of the gels, so its point is not the bench file's `tcp_m`, the point between the
gels. The difference of both, along the tool's axes, is what a calliper measures from the gels to the point.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.tool_tip import Array, PivotResult, calibrate_pivot
from calibration.verdict import Assessment, Rejected
from drivers.errors import InputError
from drivers.formats import read_csv_rows
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture
from rig.calibrate.sources import read_poses
from rig.config.calibrations import LARGEST_TIP_M

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
    """`base_T_flange` by id, and the invalid rows. Raises `InputError` if their frame is unknown."""
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
