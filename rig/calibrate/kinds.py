"""The kinds of calibrations, and the difference between two files of one kind."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from calibration.camera.files import camera_from, read_camera
from calibration.camera.intrinsics import camera_difference_px
from calibration.poses import pose_from_quaternion
from calibration.store import read_yaml
from drivers.errors import CalibrationError
from rig.calibrate.camera import camera_from_folder, collect_camera, collect_markers, markers_from_folder
from rig.calibrate.clocks import collect_streams, sync_from_folder
from rig.calibrate.gripper import collect_openings, collect_tip, gripper_from_folder, tip_from_folder
from rig.calibrate.hand_eye import collect_hand_eye, hand_eye_from_folder
from rig.calibrate.result import CalibrationResult
from rig.calibrate.tactile import collect_tactile, tactile_from_folder

Content = Mapping[str, Any]
Figures = dict[str, float | None]
WORKSPACE_M = 0.15
"""Half the side of the cube around the target in which hand-eye answers are compared."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of calibration.

    solve: reads the samples of a folder, solves and assesses them, and draws the figures of the page.
    collect: takes the samples on a bench first. compare: returns how far two files differ, in px over the
    picture or in mm; None if only their pages can be compared.
    """

    solve: Callable[..., CalibrationResult]
    collect: Callable[..., CalibrationResult | list[CalibrationResult]]
    compare: Callable[[Content, Content], Figures] | None = None


def compare_files(one: Path, other: Path) -> dict[str, float | str | None]:
    """Compare two files of one kind. Raises `CalibrationError` for different or unknown kinds."""
    contents, kinds = [], []
    for path in (one, other):
        contents.append(read_yaml(path))
        about = contents[-1].get("calibration")
        if not isinstance(about, Mapping):  # a camera file of another program
            camera_from(contents[-1], str(path))
        kinds.append(str(about.get("kind")) if isinstance(about, Mapping) else "camera")
    if kinds[0] != kinds[1]:
        raise CalibrationError(
            f"{one} is a calibration of {kinds[0]}, {other} of {kinds[1]}: nothing to compare"
        )
    if kinds[0] == "camera":
        return {"kind": "camera", **_cameras(one, other)}
    kind = KINDS.get(kinds[0])
    if kind is None or kind.compare is None:
        raise CalibrationError(f"calibrations of {kinds[0]} cannot be compared; open their pages instead")
    try:
        return {"kind": kinds[0], **kind.compare(*contents)}
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{one} or {other}: damaged ({error!r})") from error


def _cameras(one: Path, other: Path) -> Figures:
    """Compare cameras, also those of other programs. Raises `CalibrationError` for a refused calibration."""
    lengths = np.linalg.norm(camera_difference_px(read_camera(one), read_camera(other)), axis=-1)
    rows, columns = lengths.shape
    middle = lengths[rows // 3 : -rows // 3, columns // 3 : -columns // 3]
    return {
        "rms_px": round(float(np.sqrt((lengths**2).mean())), 4),
        "middle_rms_px": round(float(np.sqrt((middle**2).mean())), 4),
        "worst_px": round(float(lengths.max()), 4),
    }


def _hand_eye(one: Content, other: Content) -> Figures:
    """Compare the positions that the two answers give to points in the workspace.

    Raises `CalibrationError` for a fixed camera and one on the tool.
    """
    if one.get("setup") != other.get("setup"):
        raise CalibrationError(
            f"one is {one.get('setup')}, the other {other.get('setup')}: nothing to compare"
        )
    nodes = [one, other, *([one["target"]] if one.get("setup") == "eye-in-hand" else [])]
    x, y, *target = (
        pose_from_quaternion(node["translation_m"], node["quaternion_xyzw"], "calibration file")
        for node in nodes
    )
    ahead = (x.inverse() @ target[0]).position_m if target else (0.0, 0.0, 0.7)
    corners = ahead + WORKSPACE_M * np.array(list(product((-1, 1), repeat=3)))
    apart = x.rotation.apply(corners) + x.position_m - (y.rotation.apply(corners) + y.position_m)
    return {
        "turn_deg": round(float(np.degrees((x.rotation.inv() * y.rotation).magnitude())), 4),
        "move_mm": _move_mm(one, other),
        "worst_in_workspace_mm": round(1e3 * float(np.linalg.norm(apart, axis=1).max()), 3),
    }


def _gripper(one: Content, other: Content) -> Figures:
    """Return the largest difference of the tables of closing fingers; None without counts in common."""
    tables = [file["closing"] for file in (one, other) if "closing" in file]
    if len(tables) < 2:
        return {"closing_worst_mm": None}
    at = np.intersect1d(*(np.arange(min(t["counts"]), max(t["counts"]) + 1) for t in tables))
    gaps = np.subtract(*(np.interp(at, t["counts"], t["opening_m"]) for t in tables))
    return {"closing_worst_mm": round(1e3 * float(np.abs(gaps).max()), 3) if len(at) else None}


def _move_mm(one: Content, other: Content) -> float:
    apart = np.subtract(one["translation_m"], other["translation_m"])
    return round(1e3 * float(np.linalg.norm(apart)), 3)


KINDS = {
    "camera": Kind(camera_from_folder, collect_camera),
    "hand-eye": Kind(hand_eye_from_folder, collect_hand_eye, _hand_eye),
    "markers": Kind(markers_from_folder, collect_markers),
    "tactile": Kind(tactile_from_folder, collect_tactile),
    "gripper": Kind(gripper_from_folder, collect_openings, _gripper),
    "tcp": Kind(tip_from_folder, collect_tip, lambda *files: {"move_mm": _move_mm(*files)}),
    "sync": Kind(
        sync_from_folder,
        collect_streams,
        lambda one, other: {"offset_ms": round(1e3 * (other["add_to_stream_s"] - one["add_to_stream_s"]), 4)},
    ),
}
"""The kinds by their name in files and commands."""
