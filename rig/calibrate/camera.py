"""`rig calibrate camera`: a camera file from pictures of a board."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.checks import assess_camera, board_tilts_deg, tilt_spread_deg
from calibration.camera.files import TERMS, camera_info
from calibration.camera.intrinsics import CameraFit, calibrate_camera
from calibration.camera.projection_sigma import projection_sigma_px
from calibration.targets.boards import Target
from calibration.targets.views import View, coverage
from calibration.verdict import Assessment, Rejected
from drivers.errors import CalibrationError
from drivers.images import read_image
from drivers.types import Pose
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import picture_files


def camera_from_folder(
    folder: Path, pattern: str, target: Target, serial: str, keep_all: bool
) -> CalibrationResult:
    """Find the target in a folder's pictures and fit the camera. Raises `InputError`."""
    files = picture_files(folder, pattern)
    found = {path.name: target.find(read_image(path, grey=True), path.name) for path in files}
    views = [view for view in found.values() if isinstance(view, View)]
    unseen = [Rejected(name, reason) for name, reason in found.items() if isinstance(reason, str)]
    by_name = {path.name: path for path in files}
    try:
        result = calibrate_camera(views, keep_all=keep_all)
    except CalibrationError as error:
        return _refused(folder, files, serial, unseen, str(error))
    rejected = [*unseen, *result.rejected]
    projected = projection_sigma_px(result)
    return CalibrationResult(
        "camera",
        {"camera": serial},
        camera_info(result.fit.camera, serial),
        _quality(result, target, projected),
        assess_camera(result),
        _numbers(result, projected),
        str(folder),
        len(result.fit.views),
        rejected,
        files,
        _pictures(result, projected),
        [_thumbnail(r, by_name[r.id], found[r.id]) for r in rejected],
    )


def _refused(
    folder: Path, files: list[Path], serial: str, unseen: list[Rejected], reason: str
) -> CalibrationResult:
    thumbs = [
        Thumbnail(r.id, r.reason, figures.thumbnail(read_image(folder / r.id, grey=True)))
        for r in unseen[:12]
    ]
    assessment = Assessment(refusals=(reason,))
    return CalibrationResult(
        "camera", {"camera": serial}, {}, {}, assessment, {}, str(folder), 0, unseen, files, (), thumbs
    )


def _quality(result: CameraFit, target: Target, projected: figures.Array) -> dict[str, object]:
    return {
        "target": target.spec,
        "lens_model": result.fit.lens.name,
        "terms": [TERMS[i] for i in result.fit.lens.free],
        "sigma": result.sigma,
        "covariance": result.covariance,
        "fit_rms_px": result.fit.rms_px,
        "held_out_rms_px": result.held_out_px,
        "corner_noise_px": result.noise_px,
        "projection_sigma_px": {
            "grid": list(projected.shape[::-1]),
            "worst": float(projected.max()),
            "values": projected,
        },
        "tilt_spread_deg": tilt_spread_deg(result),
        "largest_tilt_deg": float(board_tilts_deg(result).max()),
        "covered": float((coverage(result.fit.views) > 0).mean()),
        "view_rms_px": _view_rms_px(result),
    }


def _view_rms_px(result: CameraFit) -> dict[str, float]:
    return {v.id: float(e) for v, e in zip(result.fit.views, result.fit.view_rms_px, strict=True)}


def _numbers(result: CameraFit, projected: figures.Array) -> dict[str, str]:
    matrix, sigma = result.fit.camera.matrix, result.sigma
    return {
        "focal length": f"{matrix[0, 0]:.2f} ± {sigma[0]:.2f}, {matrix[1, 1]:.2f} ± {sigma[1]:.2f} px",
        "principal point": f"{matrix[0, 2]:.2f} ± {sigma[2]:.2f}, {matrix[1, 2]:.2f} ± {sigma[3]:.2f} px",
        "distortion": ", ".join(f"{v:.5g}" for v in result.fit.camera.distortion),
        "lens model": f"{result.fit.lens.name}, best of {', '.join(result.held_out_px)} on views held out",
        "views held out are missed by": f"{result.held_out_rms_px:.3f} px (fitted: {result.fit.rms_px:.3f})",
        "projection uncertain by": f"{np.median(projected):.2f} px (median), {projected.max():.2f} at worst",
    }


def _pictures(result: CameraFit, projected: figures.Array) -> list[Picture]:
    fit, size = result.fit, result.fit.camera.size
    points = np.vstack([view.image_px for view in fit.views])
    missed = []
    for view, turn, move in zip(fit.views, fit.rotations, fit.translations, strict=True):
        missed.append(view.image_px - fit.camera.project_from(view.board_m, turn, move)[0])
    limit = 3.0 * float(np.median(fit.view_rms_px))
    boards = [
        Pose.from_rotation(move, Rotation.from_rotvec(turn))
        for turn, move in zip(fit.rotations, fit.translations, strict=True)
    ]
    return [
        Picture(
            "Poses in 3D",
            "The board in each view, in the camera's frame. The longest axis is z, the line of sight.",
            figures.poses({"board": boards, "camera": [Pose((0.0, 0.0, 0.0))]}),
        ),
        Picture(
            "Uncertainty over the picture",
            "One sigma of where a distant point is projected, the best turn of "
            "the camera taken out; dots: corners seen.",
            figures.field(projected, size, "px", points),
        ),
        Picture(
            "Residuals over the picture",
            "Noise points anywhere; arrows that agree show a lens the model does not follow.",
            figures.arrows(points, np.vstack(missed), size, "residuals"),
        ),
        Picture(
            "Coverage",
            "Corners per cell of the picture.",
            figures.field(coverage(fit.views), size, "corners", points),
        ),
        Picture(
            "Error per view", "Rms px of each view used.", figures.bars(_view_rms_px(result), "px", limit)
        ),
        Picture(
            "Lens models",
            "Rms px of views held out: the simplest model within 1 % of the best is taken.",
            figures.bars(
                {k: v for k, v in result.held_out_px.items() if v < 5 * result.held_out_rms_px}, "px"
            ),
        ),
    ]


def _thumbnail(rejected: Rejected, path: Path, view: View | str) -> Thumbnail:
    marks = [view.image_px] if isinstance(view, View) else []
    return Thumbnail(rejected.id, rejected.reason, figures.thumbnail(read_image(path, grey=True), marks))
