"""`rig calibrate camera, markers`: a camera from pictures of a board, and how well it knows angles."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.checks import assess_camera, board_tilts_deg, covered, projection_sigma_px
from calibration.camera.files import TERMS, camera_info
from calibration.camera.intrinsics import CameraFit, calibrate_camera
from calibration.camera.model import CameraModel
from calibration.markers.angle import TURN_DEG, MarkerAngle, assess_markers
from calibration.markers.tracker import MarkerTracker
from calibration.targets.boards import Target, View, coverage
from calibration.verdict import Assessment, Rejected
from drivers.errors import CalibrationError
from drivers.images import read_image
from drivers.progress import steps
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import picture_files


def camera_from_folder(
    folder: Path, pattern: str, target: Target, serial: str, keep_all: bool
) -> CalibrationResult:
    """Find the target in a folder's pictures and fit the camera. Raises `InputError`."""
    files = picture_files(folder, pattern)
    found = {path.name: target.find(read_image(path, grey=True), path.name) for path in steps(files)}
    views = [view for view in found.values() if isinstance(view, View)]
    rejected = [Rejected(name, reason) for name, reason in found.items() if isinstance(reason, str)]
    serials, source = {"camera": serial}, str(folder)
    try:
        result = calibrate_camera(views, keep_all=keep_all)
    except CalibrationError as error:
        thumbs = [Thumbnail.of(r, folder / r.id) for r in rejected[:12]]
        refused = Assessment((str(error),))
        return CalibrationResult(
            "camera", serials, refused, source, rejected=rejected, files=files, thumbnails=thumbs
        )
    rejected += result.rejected
    projected_px = projection_sigma_px(result)
    return CalibrationResult(
        "camera",
        serials,
        assess_camera(result),
        source,
        camera_info(result.fit.camera, serial),
        _quality(result, target, float(projected_px.max())),
        _numbers(result, projected_px),
        len(result.fit.views),
        rejected,
        files,
        _pictures(result, projected_px, folder),
        [Thumbnail.of(r, folder / r.id, found[r.id]) for r in rejected],
    )


def _quality(result: CameraFit, target: Target, projected_px: float) -> dict[str, object]:
    spread_deg, largest_deg = board_tilts_deg(result)
    return {
        "target": target.spec,
        "lens_model": result.fit.lens.name,
        "terms": [TERMS[i] for i in result.fit.lens.free],
        "sigma": result.sigma,
        "covariance": result.covariance,
        "fit_rms_px": result.fit.rms_px,
        "held_out_rms_px": result.held_out_px,
        "corner_noise_px": result.noise_px,
        "projection_sigma_px": {"worst": projected_px},
        "tilt_spread_deg": spread_deg,
        "largest_tilt_deg": largest_deg,
        "covered": covered(result),
        "view_rms_px": _view_rms_px(result),
    }


def _view_rms_px(result: CameraFit) -> dict[str, float]:
    return {v.id: float(e) for v, e in zip(result.fit.views, result.fit.view_rms_px, strict=True)}


def _numbers(result: CameraFit, projected_px: figures.Array) -> dict[str, str]:
    matrix, sigma = result.fit.camera.matrix, result.sigma
    return {
        "focal length": f"{matrix[0, 0]:.2f} ± {sigma[0]:.2f}, {matrix[1, 1]:.2f} ± {sigma[1]:.2f} px",
        "principal point": f"{matrix[0, 2]:.2f} ± {sigma[2]:.2f}, {matrix[1, 2]:.2f} ± {sigma[3]:.2f} px",
        "distortion": ", ".join(
            f"{name} {v:.5g}" for name, v in zip(TERMS[4:], result.fit.camera.distortion, strict=False)
        ),
        "lens model": f"{result.fit.lens.name}, best of {', '.join(result.held_out_px)} on views held out",
        "views held out are missed by": f"{result.held_out_rms_px:.3f} px "
        f"(fitted: {result.fit.rms_px:.3f} px)",
        "projection uncertain by": f"{np.median(projected_px):.2f} px (median), "
        f"{projected_px.max():.2f} px at worst",
    }


def _pictures(result: CameraFit, projected_px: figures.Array, folder: Path) -> list[Picture]:
    fit, size = result.fit, result.fit.camera.size
    points = np.vstack([view.image_px for view in fit.views])
    fitted, boards = [], []
    for view, turn, move in zip(fit.views, fit.rotations, fit.translations, strict=True):
        fitted.append(fit.camera.project_from(view.board_m, turn, move)[0])
        boards.append(Pose.from_rotation(move, Rotation.from_rotvec(turn)))
    limit = 3.0 * float(np.median(fit.view_rms_px))
    by_lens = {k: v for k, v in result.held_out_px.items() if v < 5 * result.held_out_rms_px}
    worst = int(np.argmax(fit.view_rms_px))
    shown = fit.views[worst]
    return [
        Picture(
            "Poses in 3D",
            "The board in each view, in the camera's frame. The longest axis is z, the line of sight.",
            figures.poses({"board": boards, "camera": [Pose((0.0, 0.0, 0.0))]}),
        ),
        Picture(
            "Residuals of the worst view",
            f"{shown.id}: each arrow points from a corner projected with the calibrated camera to the "
            "detected one.",
            figures.arrows(
                fitted[worst],
                shown.image_px - fitted[worst],
                size,
                "residuals",
                read_image(folder / shown.id, grey=True),
            ),
        ),
        Picture(
            "Residuals of all views",
            "Noise points anywhere; arrows that agree show a lens that the model does not follow.",
            figures.arrows(np.vstack(fitted), points - np.vstack(fitted), size, "residuals"),
        ),
        Picture(
            "Uncertainty over the picture",
            "One sigma of where a distant point is projected, the best turn of "
            "the camera taken out; dots: corners seen.",
            figures.field(projected_px, size, "one sigma, px", points),
        ),
        Picture(
            "Coverage",
            "Corners per cell of the picture.",
            figures.field(coverage(fit.views), size, "corners", points),
        ),
        Picture(
            "Error per view",
            "Rms residual of each view used. Dashed: three times the median.",
            figures.bars(_view_rms_px(result), "rms, px", limit),
        ),
        Picture(
            "Lens models",
            "Rms residual of views held out: the simplest model within 1 % of the best is taken.",
            figures.bars(by_lens, "rms, px"),
        ),
    ]


def markers_from_folder(
    folder: Path,
    pattern: str,
    ids: tuple[int, int],
    dictionary: str,
    camera: CameraModel | None,
    serial: str,
) -> CalibrationResult:
    """Assess the angle from twenty pictures of the markers at rest. Raises `CalibrationError`."""
    files = picture_files(folder, pattern)
    pictures = [read_image(path, grey=True) for path in files]
    report = assess_markers(pictures, MarkerAngle(MarkerTracker(ids, dictionary), camera))
    plane = report.plane
    turn_sigma_deg = float(np.hypot(report.plane_sigma_deg, report.camera_sigma_deg))
    tilt = "unknown without intrinsics" if plane.tilt_deg is None else f"{plane.tilt_deg:.1f} degrees"
    numbers = {
        "side": f"{plane.side_px:.1f} px",
        "tilt to the camera": tilt,
        "angle at rest, one sigma": f"{report.sigma_deg:.4f} degrees",
        f"a turn of {TURN_DEG:.0f} degrees, one sigma": f"{turn_sigma_deg:.4f} degrees, "
        f"{report.camera_sigma_deg:.4f} of it by the camera",
        "drift": f"{report.drift_deg:+.4f} degrees",
    }
    if report.refused:
        reasons = (f"{count} ({reason})" for reason, count in report.refused.items())
        numbers["pictures without an angle"] = ", ".join(reasons)
    places = np.arange(float(len(report.rest_deg)))
    shown = figures.curves({"angle": (places, report.rest_deg)}, "picture", "angle, degrees")
    mean = np.broadcast_to(plane.corners_px, report.corners_px.shape)
    return CalibrationResult(
        "markers",
        {"camera": serial},
        report.assessment,
        str(folder),
        {
            "dictionary": dictionary,
            "ids": ids,
            "side_px": plane.side_px,
            "tilt_deg": plane.tilt_deg,
            "angle_sigma_deg": report.sigma_deg,
            "turn_sigma_deg": turn_sigma_deg,
        },
        {
            "square_fit_px": plane.fit_px,
            "drift_deg": report.drift_deg,
            "turn_sigma_camera_deg": report.camera_sigma_deg,
            "refused_pictures": report.refused,
        },
        numbers,
        len(files),
        files=files,
        pictures=[
            Picture(
                "Corners at rest",
                "Each arrow points from a corner's mean over the first half of the pictures to its place in "
                "one of the others. Scattered arrows are noise; arrows that agree show a marker that moved.",
                figures.arrows(
                    mean.reshape(-1, 2),
                    (report.corners_px - mean).reshape(-1, 2),
                    pictures[0].shape[::-1],
                    "residuals",
                    pictures[0],
                ),
            ),
            Picture("Angle at rest", "It should scatter around zero, without a trend.", shown),
        ],
    )
