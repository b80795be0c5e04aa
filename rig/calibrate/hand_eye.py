"""`rig calibrate hand-eye`: the camera's pose from pictures at known robot poses."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.camera.model import CameraModel
from calibration.hand_eye.samples import HandEyeSample, Setup
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.targets.boards import Target
from calibration.targets.views import View
from calibration.verdict import Rejected
from drivers.images import read_image
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import picture_files, read_poses

FRAMES = {Setup.EYE_TO_HAND: ("base", "camera", "tcp"), Setup.EYE_IN_HAND: ("tcp", "camera", "base")}
"""Parent and child frame of the answer, and the parent of the target, by setup."""


def hand_eye_from_folder(
    folder: Path, target: Target, camera: CameraModel, serial: str, setup: Setup
) -> CalibrationResult:
    """Pair pictures `<id>.png` with the rows of poses.csv by id, and solve. Raises `InputError`."""
    files = picture_files(folder)
    poses, rejected = read_poses(folder / "poses.csv")
    samples: list[HandEyeSample] = []
    for path in files:
        if path.stem not in poses:
            if path.stem not in {r.id for r in rejected}:
                rejected.append(Rejected(path.stem, "no pose of this id in poses.csv"))
            continue
        view = target.find(read_image(path, grey=True), path.stem)
        if isinstance(view, str):
            rejected.append(Rejected(path.stem, view))
        else:
            samples.append(HandEyeSample(path.stem, poses[path.stem], view))
    rejected += [Rejected(name, "no picture of this id") for name in poses.keys() - {p.stem for p in files}]
    result = hand_eye_result(samples, camera, serial, setup, str(folder), rejected, target)
    pictures = {path.stem: path for path in files}
    thumbs = [Thumbnail(r.id, r.reason, _thumb(pictures.get(r.id), samples)) for r in result.rejected]
    return replace(result, files=[*files, folder / "poses.csv"], thumbnails=thumbs)


def hand_eye_result(
    samples: Sequence[HandEyeSample],
    camera: CameraModel,
    serial: str,
    setup: Setup,
    source: str,
    rejected: Sequence[Rejected] = (),
    target: Target | None = None,
) -> CalibrationResult:
    """Solve, and make the figures of the page."""
    result = calibrate_hand_eye(samples, camera, setup)
    views = [s.view for s in samples]
    return CalibrationResult(
        "hand-eye",
        {"camera": serial},
        place_value(result.setup, result.pose, result.target),
        _quality(result, target),
        result.assessment,
        _numbers(result),
        source,
        len(result.used),
        [*rejected, *result.rejected],
        pictures=[
            *poses_picture(
                setup, result.pose, result.target, [s.base_T_tcp for s in samples if s.id in result.used]
            ),
            *_pictures(result, views, camera),
        ],
    )


def _transform(parent: str, child: str, pose: Pose) -> dict[str, object]:
    return {
        "parent_frame": parent,
        "child_frame": child,
        "translation_m": pose.position_m,
        "quaternion_xyzw": pose.quaternion_xyzw,
    }


def place_value(setup: Setup, pose: Pose | None, target: Pose | None) -> dict[str, object]:
    """The value of a hand-eye file; nothing where there is no answer."""
    if pose is None or target is None:
        return {}
    parent, child, holder = FRAMES[setup]
    return {
        "setup": str(setup),
        **_transform(parent, child, pose),
        "target": _transform(holder, "target", target),
    }


def poses_picture(
    setup: Setup, pose: Pose | None, target: Pose | None, robot: Sequence[Pose]
) -> list[Picture]:
    """Draw robot, camera and target of all samples in the base frame; nothing without an answer."""
    if pose is None or target is None:
        return []
    moving = setup is Setup.EYE_IN_HAND
    cameras = [at @ pose for at in robot] if moving else [pose]
    targets = [target] if moving else [at @ target for at in robot]
    groups = {"TCP": robot, "camera": cameras, "target": targets, "base": [Pose((0.0, 0.0, 0.0))]}
    text = "Axes of each frame, in the robot's base frame; the longest is z: the camera looks along it."
    return [Picture("Poses in 3D", text, figures.poses(groups))]


def _quality(result: HandEyeResult, target: Target | None) -> dict[str, object]:
    quality: dict[str, object] = {"target": target.spec} if target else {}
    if result.motion is not None:
        quality["observability"] = {
            "max_angle_deg": result.motion.max_angle_deg,
            "translation_ratio": result.motion.translation_ratio,
            "rotation_gap": result.motion.rotation_gap,
        }
    if result.spread is not None:
        quality |= {
            "covariance_order": "rotation vector about the child's axes (rad), translation in the parent (m)",
            "covariance": result.spread.covariance,
            "covariance_of_fit": result.spread.fit,
            "covariance_leave_one_out": result.spread.jackknife,
            "covariance_from_camera": result.spread.camera,
            "covariance_of_target": result.spread.target,
            "rms_px": result.rms_px,
            "held_out_rms_px": float(np.sqrt((result.spread.held_out_px**2).mean())),
            "closed_form": result.closed_form,
        }
    return quality


def _numbers(result: HandEyeResult) -> dict[str, str]:
    if result.pose is None or result.spread is None or result.motion is None:
        return {}
    parent, child, _ = FRAMES[result.setup]
    spread = result.spread
    mm, deg = 1e3 * spread.sigma_m, np.degrees(spread.sigma_rad)
    camera_mm, camera_deg = 1e3 * spread.camera_sigma_m, np.degrees(spread.camera_sigma_rad)
    place = ", ".join(f"{v:.5f}" for v in result.pose.position_m)
    return {
        f"{parent}_T_{child}, position": f"{place} m",
        "orientation (xyzw)": ", ".join(f"{v:.6f}" for v in result.pose.quaternion_xyzw),
        "one sigma, position": " / ".join(f"{v:.2f}" for v in mm) + " mm",
        "one sigma, orientation": " / ".join(f"{v:.3f}" for v in deg) + " degrees",
        "of that from the camera": f"{np.linalg.norm(camera_mm):.2f} mm, "
        f"{np.linalg.norm(camera_deg):.3f} degrees",
        "samples used are missed by": f"{result.rms_px:.2f} px, left out by "
        f"{np.sqrt((spread.held_out_px**2).mean()):.2f} px",
        "observability": f"turns up to {result.motion.max_angle_deg:.0f} degrees, ratio "
        f"{result.motion.translation_ratio:.2f}, gap {result.motion.rotation_gap:.2g}",
    }


def _pictures(result: HandEyeResult, views: list[View], camera: CameraModel) -> list[Picture]:
    pictures = []
    if result.sample_px:
        limit = 3.0 * float(np.median(list(result.sample_px.values())))
        pictures.append(
            Picture(
                "Error per sample",
                "Rms px by which each sample is missed; orange ones stand out.",
                figures.bars(result.sample_px, "px", limit),
            )
        )
    if result.spread is not None:
        held = dict(zip(result.used, result.spread.held_out_px.tolist(), strict=True))
        pictures.append(
            Picture(
                "Error of samples left out",
                "Rms px by which the answer from all others misses each.",
                figures.bars(held, "px"),
            )
        )
    if views and result.motion is not None:
        points = np.vstack([v.image_px for v in views])
        pictures.append(
            Picture(
                "Where the target was seen",
                "Its points in all samples.",
                figures.scatter({"points": (points[:, 0], camera.size[1] - points[:, 1])}, "x, px", "up, px"),
            )
        )
    return pictures


def _thumb(path: Path | None, samples: Sequence[HandEyeSample]) -> bytes | None:
    if path is None:
        return None
    marks = [s.view.image_px for s in samples if s.id == path.stem]
    return figures.thumbnail(read_image(path, grey=True), marks)
