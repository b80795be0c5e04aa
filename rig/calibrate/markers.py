"""`rig calibrate markers`: the accuracy of the two-marker angle, from pictures at rest."""

from pathlib import Path

import numpy as np

from calibration.camera.model import CameraModel
from calibration.markers.angle import TURN_DEG, MarkerAngle, assess_markers
from calibration.markers.tracker import MarkerTracker
from drivers.images import read_image
from rig.calibrate import figures
from rig.calibrate.result import CalibrationResult, Picture, Thumbnail
from rig.calibrate.sources import picture_files


def markers_from_folder(
    folder: Path,
    pattern: str,
    ids: tuple[int, int],
    dictionary: str,
    camera: CameraModel | None,
    serial: str,
) -> CalibrationResult:
    """How well the angle is known, from twenty pictures of the markers at rest. Raises `CalibrationError`."""
    files = picture_files(folder, pattern)
    pictures = [read_image(path, grey=True) for path in files]
    report = assess_markers(pictures, MarkerAngle(MarkerTracker(ids, dictionary), camera))
    plane = report.plane
    value = {
        "dictionary": dictionary,
        "ids": ids,
        "side_px": plane.side_px,
        "tilt_deg": plane.tilt_deg,
        "angle_sigma_deg": report.sigma_deg,
        "turn_sigma_deg": float(np.hypot(report.plane_sigma_deg, report.camera_sigma_deg)),
    }
    quality = {
        "corner_scatter_px": plane.scatter_px,
        "square_fit_px": plane.fit_px,
        "drift_deg": report.drift_deg,
        "turn_sigma_plane_deg": report.plane_sigma_deg,
        "turn_sigma_camera_deg": report.camera_sigma_deg,
        "refused_pictures": report.refused,
        "plane_T_image": plane.plane_T_image[0],
    }
    numbers = {
        "side": f"{plane.side_px:.1f} px",
        "tilt to the camera": "unknown without intrinsics"
        if plane.tilt_deg is None
        else f"{plane.tilt_deg:.1f} degrees",
        "angle at rest, one sigma": f"{report.sigma_deg:.4f} degrees",
        f"a turn of {TURN_DEG:.0f} degrees, one sigma": f"{value['turn_sigma_deg']:.4f} degrees, "
        f"{report.camera_sigma_deg:.4f} of it by the camera",
        "drift": f"{report.drift_deg:+.4f} degrees",
    }
    shown = figures.lines(
        {"angle": (np.arange(float(len(report.rest_deg))), report.rest_deg)}, "picture", "degrees"
    )
    return CalibrationResult(
        "markers",
        {"camera": serial},
        value,
        quality,
        report.assessment,
        numbers,
        str(folder),
        len(files),
        (),
        files,
        [Picture("Angle at rest", "It should scatter round zero, without a trend.", shown)],
        [Thumbnail("first picture", "", figures.thumbnail(pictures[0]))],
    )
