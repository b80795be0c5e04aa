"""The difference between two calibrations, in px over the picture or mm in the workspace."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.camera.files import camera_from, read_camera
from calibration.camera.projection_sigma import camera_difference_px
from calibration.poses import pose_from_quaternion
from calibration.store import read_yaml
from drivers.errors import CalibrationError
from drivers.types import Pose

Figures = dict[str, float | None]
WORKSPACE_M = 0.15
"""Half the side of the cube around the target in which hand-eye answers are compared."""


def compare_files(one: Path, other: Path) -> dict[str, float | str | None]:
    """Differences of two files of one kind. Raises `CalibrationError` for different or unknown kinds."""
    contents = [read_yaml(path) for path in (one, other)]
    kinds = [_kind(content, path) for content, path in zip(contents, (one, other), strict=True)]
    if kinds[0] != kinds[1]:
        raise CalibrationError(
            f"{one} is a calibration of {kinds[0]}, {other} of {kinds[1]}: nothing to compare"
        )
    compared: dict[str, Callable[[Mapping[str, Any], Mapping[str, Any]], Figures]] = {
        "hand-eye": _hand_eye,
        "gripper": _gripper,
        "tcp": _place,
        "sync": _sync,
    }
    if kinds[0] == "camera":
        return {"kind": "camera", **_cameras(one, other)}
    if kinds[0] not in compared:
        raise CalibrationError(f"calibrations of {kinds[0]} cannot be compared; look at their pages")
    try:
        return {"kind": kinds[0], **compared[kinds[0]](*contents)}
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{one} or {other}: damaged ({error!r})") from error


def _kind(content: Mapping[str, Any], path: Path) -> str:
    about = content.get("calibration")
    if isinstance(about, Mapping):
        return str(about.get("kind"))
    camera_from(content, str(path))
    return "camera"


def _cameras(one: Path, other: Path) -> Figures:
    lengths = np.linalg.norm(camera_difference_px(read_camera(one), read_camera(other)), axis=-1)
    middle = lengths[
        lengths.shape[0] // 3 : -lengths.shape[0] // 3, lengths.shape[1] // 3 : -lengths.shape[1] // 3
    ]
    return {
        "rms_px": round(float(np.sqrt((lengths**2).mean())), 4),
        "middle_rms_px": round(float(np.sqrt((middle**2).mean())), 4),
        "worst_px": round(float(lengths.max()), 4),
    }


def _hand_eye(one: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    """Distance between the places that the two answers give to points in the workspace."""
    x, y = _pose(one), _pose(other)
    centre = x.inverse() @ _pose(one["target"]) if one.get("setup") == "eye-in-hand" else None
    ahead = np.asarray([0.0, 0.0, 0.7]) if centre is None else np.asarray(centre.position_m)
    corners = ahead + WORKSPACE_M * np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    apart = [np.subtract(_carried(x, p), _carried(y, p)) for p in corners]
    return {
        "turn_deg": round(float(np.degrees((x.rotation.inv() * y.rotation).magnitude())), 4),
        "move_mm": round(1e3 * float(np.linalg.norm(np.subtract(x.position_m, y.position_m))), 3),
        "worst_in_workspace_mm": round(1e3 * float(np.linalg.norm(apart, axis=1).max()), 3),
    }


def _gripper(one: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    found: Figures = {}
    for way in ("closing", "opening"):
        if way in one and way in other:
            a, b = one[way], other[way]
            at = np.intersect1d(*(np.arange(min(t["counts"]), max(t["counts"]) + 1) for t in (a, b)))
            gaps = [np.interp(at, t["counts"], t["opening_m"]) for t in (a, b)]
            found[f"{way}_worst_mm"] = (
                round(1e3 * float(np.abs(gaps[0] - gaps[1]).max()), 3) if len(at) else None
            )
    return found


def _place(one: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    apart = np.subtract(one["translation_m"], other["translation_m"])
    return {"move_mm": round(1e3 * float(np.linalg.norm(apart)), 3)}


def _sync(one: Mapping[str, Any], other: Mapping[str, Any]) -> Figures:
    return {"offset_ms": round(1e3 * (other["add_to_stream_s"] - one["add_to_stream_s"]), 4)}


def _pose(node: Mapping[str, Any]) -> Pose:
    return pose_from_quaternion(node["translation_m"], node["quaternion_xyzw"], "calibration file")


def _carried(pose: Pose, point: np.ndarray) -> np.ndarray:
    return pose.rotation.apply(point) + np.asarray(pose.position_m)
