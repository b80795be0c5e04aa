"""`rig calibrate hand-eye`: the pose of a camera, from pictures or poses of a target at known robot poses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.hand_eye.closed_form import LEAST_GAP, LEAST_RATIO, LEAST_TURN_DEG
from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.pose_solve import calibrate_pose_pairs
from calibration.hand_eye.samples import HandEyeSample, Setup
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.targets.boards import Target, View
from calibration.verdict import Rejected
from drivers.images import read_image
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import picture_files, read_poses

FRAMES = {Setup.EYE_TO_HAND: ("base", "camera", "tcp"), Setup.EYE_IN_HAND: ("tcp", "camera", "base")}
"""Parent and child frame of the answer, and the parent of the target, by setup."""
TARGETS = "targets.csv"
_NOISE = ("robot_turn_rad", "robot_m", "tilt_rad", "turn_rad", "across_m", "depth_m")
"""Of the robot's poses, then of the target's."""
_ORDER = "rotation vector about the child's axes (rad), translation in the parent (m)"


def hand_eye_from_folder(
    folder: Path, target: Target, camera: CameraModel, serial: str, setup: Setup
) -> CalibrationResult:
    """Pair pictures `<id>.png` with the rows of poses.csv by id, and solve. Raises `InputError`."""
    files = picture_files(folder)
    poses, rejected = read_poses(folder / "poses.csv")
    samples: list[HandEyeSample] = []
    views: dict[str, View | str] = {}
    for path in files:
        name = path.stem
        if name not in poses:
            if name not in {r.id for r in rejected}:
                rejected.append(Rejected(name, "no pose of this id in poses.csv"))
            continue
        view = views[name] = target.find(read_image(path, grey=True), name)
        if isinstance(view, str):
            rejected.append(Rejected(name, view))
        else:
            samples.append(HandEyeSample(name, poses[name], view))
    pictures = {path.stem: path for path in files}
    rejected += [Rejected(name, "no picture of this id") for name in poses.keys() - pictures.keys()]
    result = hand_eye_result(samples, camera, serial, setup, str(folder), rejected, target, pictures)
    thumbs = [Thumbnail.of(r, pictures.get(r.id), views.get(r.id)) for r in result.rejected]
    return replace(result, files=[*files, folder / "poses.csv"], thumbnails=thumbs)


def hand_eye_from_poses(folder: Path, serial: str, setup: Setup) -> CalibrationResult:
    """Pair `poses.csv` (base_T_tcp) and `targets.csv` (camera_T_target) by id, and solve.

    Raises `InputError`.
    """
    files = [folder / "poses.csv", folder / TARGETS]
    (robot, rejected), (seen, also) = (read_poses(path) for path in files)
    rejected = rejected + also
    rejected += [Rejected(name, "no pose of the target of this id") for name in robot.keys() - seen.keys()]
    rejected += [Rejected(name, "no robot pose of this id") for name in seen.keys() - robot.keys()]
    samples = [PoseSample(name, robot[name], seen[name]) for name in robot if name in seen]
    result = calibrate_pose_pairs(samples, setup)
    quality, numbers = _pair_figures(result)
    return replace(_filed(result, serial, str(folder), rejected, robot, quality, numbers), files=files)


def hand_eye_result(
    samples: Sequence[HandEyeSample],
    camera: CameraModel,
    serial: str,
    setup: Setup,
    source: str,
    rejected: Sequence[Rejected],
    target: Target,
    files: Mapping[str, Path],
) -> CalibrationResult:
    """Solve, and make the figures of the page. files: the pictures by the id of their sample."""
    result = calibrate_hand_eye(samples, camera, setup)
    robot = {sample.id: sample.base_T_tcp for sample in samples}
    filed = _filed(result, serial, source, rejected, robot, _quality(result, target), _numbers(result))
    views = [sample.view for sample in samples]
    more = [*_residuals(result, camera, files), *_pictures(result, views, camera)]
    return replace(filed, pictures=[*filed.pictures, *more])


def _filed(
    result: HandEyeResult,
    serial: str,
    source: str,
    rejected: Sequence[Rejected],
    robot: Mapping[str, Pose],
    quality: Mapping[str, object],
    numbers: Mapping[str, str],
) -> CalibrationResult:
    """Return the calibration with the poses in 3D. robot: base_T_tcp by sample."""
    return CalibrationResult(
        "hand-eye",
        {"camera": serial},
        result.assessment,
        source,
        _value(result),
        quality,
        numbers,
        len(result.used),
        [*rejected, *result.rejected],
        pictures=_poses_picture(result, [robot[name] for name in result.used]),
    )


def _transform(parent: str, child: str, pose: Pose) -> dict[str, object]:
    return {
        "parent_frame": parent,
        "child_frame": child,
        "translation_m": pose.position_m,
        "quaternion_xyzw": pose.quaternion_xyzw,
    }


def _value(result: HandEyeResult) -> dict[str, object]:
    """Return the value of a hand-eye file; nothing without an answer."""
    setup, pose, target = result.setup, result.pose, result.target
    if pose is None or target is None:
        return {}
    parent, child, holder = FRAMES[setup]
    return {
        "setup": str(setup),
        **_transform(parent, child, pose),
        "target": _transform(holder, "target", target),
    }


def _poses_picture(result: HandEyeResult, robot: Sequence[Pose]) -> list[Picture]:
    """Draw robot, camera and target of all samples in the base frame; nothing without an answer."""
    pose, target = result.pose, result.target
    if pose is None or target is None:
        return []
    moving = result.setup is Setup.EYE_IN_HAND
    cameras = [at @ pose for at in robot] if moving else [pose]
    targets = [target] if moving else [at @ target for at in robot]
    groups = {"TCP": robot, "camera": cameras, "target": targets, "base": [Pose((0.0, 0.0, 0.0))]}
    text = "Axes of each frame, in the robot's base frame; the longest is z: the camera looks along it."
    return [Picture("Poses in 3D", text, figures.poses(groups))]


def _quality(result: HandEyeResult, target: Target) -> dict[str, object]:
    quality: dict[str, object] = {"target": target.spec}
    if result.motion is not None:
        quality["observability"] = {
            "max_angle_deg": result.motion.max_angle_deg,
            "translation_ratio": result.motion.translation_ratio,
            "rotation_gap": result.motion.rotation_gap,
        }
    if result.spread is not None:
        quality |= {
            "covariance_order": _ORDER,
            "covariance": result.spread.covariance,
            "covariance_from_camera": result.spread.camera,
            "rms_px": result.rms_px,
            "held_out_rms_px": result.spread.held_out_rms_px,
        }
    return quality


def _numbers(result: HandEyeResult) -> dict[str, str]:
    if result.pose is None or result.spread is None or result.motion is None:
        return {}
    parent, child, _ = FRAMES[result.setup]
    spread = result.spread
    mm, deg = 1e3 * spread.sigma_m, np.degrees(spread.sigma_rad)
    camera_mm, camera_deg = 1e3 * spread.camera_sigma_m, np.degrees(spread.camera_sigma_rad)
    return {
        **_pose_numbers(result.pose, f"{parent}_T_{child}, position"),
        "one sigma of the position": f"{_axes(mm, 2)} mm",
        "one sigma of the orientation": f"{_axes(deg, 3)} degrees",
        "of that from the camera": f"{np.linalg.norm(camera_mm):.2f} mm, "
        f"{np.linalg.norm(camera_deg):.3f} degrees",
        "samples used are missed by": f"{result.rms_px:.2f} px, left out by {spread.held_out_rms_px:.2f} px",
        "rotation of the poses": f"{result.motion.max_angle_deg:.0f} degrees (limit {LEAST_TURN_DEG:g}), "
        f"about different axes {result.motion.translation_ratio:.2f} (limit {LEAST_RATIO:g}), "
        f"gap {result.motion.rotation_gap:.2g} (limit {LEAST_GAP:g})",
    }


def _pair_figures(result: HandEyeResult) -> tuple[dict[str, object], dict[str, str]]:
    """Return quality and numbers of an answer from pairs of poses; nothing without one."""
    if result.pose is None or result.covariance is None or result.sigmas is None:
        return {}, {}
    quality = {
        "covariance_order": _ORDER,
        "covariance": result.covariance,
        "noise_found": dict(zip(_NOISE, result.sigmas.tolist(), strict=True)),
    }
    sigma = np.sqrt(np.diag(result.covariance))
    robot, seen = result.sigmas[:2], result.sigmas[2:]
    return quality, {
        **_pose_numbers(result.pose, "position"),
        "one sigma of the position": f"{_axes(1e3 * sigma[3:], 2)} mm",
        "one sigma of the orientation": f"{_axes(np.degrees(sigma[:3]), 3)} degrees",
        "noise found, robot": f"{np.degrees(robot[0]):.3f} degrees, {1e3 * robot[1]:.2f} mm",
        "noise found, target's pose": f"tilt {np.degrees(seen[0]):.3f}, turn {np.degrees(seen[1]):.3f} "
        f"degrees, across {1e3 * seen[2]:.2f}, depth {1e3 * seen[3]:.2f} mm",
    }


def _axes(values: NDArray[np.floating], digits: int) -> str:
    """Return three values by axis as text. digits: decimals."""
    return ", ".join(f"{axis} {value:.{digits}f}" for axis, value in zip("xyz", values, strict=True))


def _pose_numbers(pose: Pose, name: str) -> dict[str, str]:
    return {
        name: ", ".join(f"{axis} {v:.5f}" for axis, v in zip("xyz", pose.position_m, strict=True)) + " m",
        "orientation, quaternion x, y, z, w": ", ".join(f"{v:.6f}" for v in pose.quaternion_xyzw),
    }


def _residuals(result: HandEyeResult, camera: CameraModel, files: Mapping[str, Path]) -> list[Picture]:
    """Draw residuals: the worst sample's on its picture, and all; nothing without an answer."""
    problem, refined = result.problem, result.refined
    if problem is None or refined is None:
        return []
    worst = int(np.argmax(refined.sample_rms_px(problem)))
    name, own = problem.ids[worst], problem.owner == worst
    text = "each arrow points from the projection of a target point, as calibrated, to its detection."
    of_all = "Arrows of one sample that agree show a robot pose or a picture that does not fit the others."
    shown = figures.arrows(
        problem.seen_px[own], -refined.missed_px[own], camera.size, "residuals",
        read_image(files[name], grey=True),
    )  # fmt: skip
    everywhere = figures.arrows(problem.seen_px, -refined.missed_px, camera.size, "residuals")
    return [
        Picture("Residuals of the worst sample", f"{name}: {text}", shown),
        Picture("Residuals of all samples", of_all, everywhere),
    ]


def _pictures(result: HandEyeResult, views: list[View], camera: CameraModel) -> list[Picture]:
    pictures = []
    if result.sample_px:
        limit = 3.0 * float(np.median(list(result.sample_px.values())))
        text = "Rms residual of each sample. Dashed: three times the median."
        pictures.append(Picture("Error per sample", text, figures.bars(result.sample_px, "rms, px", limit)))
    if result.spread is not None:
        held = dict(zip(result.used, result.spread.held_out_px.tolist(), strict=True))
        text = "Rms residual of each sample for the answer from all others."
        pictures.append(Picture("Error of samples left out", text, figures.bars(held, "rms, px")))
    if views and result.motion is not None:
        points = np.vstack([v.image_px for v in views])
        places = {"points": (points[:, 0], camera.size[1] - points[:, 1])}
        shown = figures.curves(places, "x, px", "up, px", ".")
        pictures.append(Picture("Where the target was seen", "Its points in all samples.", shown))
    return pictures
