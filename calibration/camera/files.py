"""Camera files: write and read ROS `camera_info`, read OpenCV's YAML."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.camera.model import LEAST_FOCAL, Array, CameraModel, CameraUncertainty
from calibration.store import CalibrationFile, check_serials, load, read_yaml, why_damaged
from drivers.errors import CalibrationError
from drivers.formats import quote, reason

_LENSES = ("plumb_bob", "rational_polynomial")
"""ROS's names of the pinhole lens with OpenCV's terms."""
_MODEL_KEYS = ("camera_model", "model_type", "projection_model", "lens_model")
"""Keys in which Kalibr, camodocal and others name the camera; pinhole is the only supported one."""
_MOST_TERMS = 8
TERMS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Terms of the lens model, in OpenCV's order."""


def camera_info(model: CameraModel, name: str) -> dict[str, Any]:
    """Return a camera file's content in ROS `camera_info` layout (image_proc, camera_calibration_parsers)."""
    width, height = model.size
    projection = np.column_stack([model.matrix, np.zeros(3)])
    return {
        "image_width": width, "image_height": height, "camera_name": name,
        "camera_matrix": _matrix(model.matrix),
        "distortion_model": "rational_polynomial" if len(model.distortion) == 8 else "plumb_bob",
        "distortion_coefficients": _matrix(model.distortion.reshape(1, -1)),
        "rectification_matrix": _matrix(np.eye(3)), "projection_matrix": _matrix(projection),
    }  # fmt: skip


def read_camera(path: Path, serial: str | None = None) -> CameraModel:
    """Read a camera from a file of this product, ROS `camera_info` or OpenCV YAML.

    serial: of the connected camera; a file of this product for another camera, or with the verdict refused,
    is rejected. Raises `CalibrationError`.
    """
    content = read_yaml(path)
    if "calibration" in content:
        return camera_of(load(path, "camera", None if serial is None else {"camera": serial}), str(path))
    if serial is not None and content.get("camera_name") not in (None, serial):
        check_serials(path, {"camera": str(content["camera_name"])}, {"camera": serial})
    return replace(camera_from(content, str(path)), uncertainty=unknown_uncertainty(path.name))


def camera_of(file: CalibrationFile, where: str) -> CameraModel:
    """Return a calibration's camera with its uncertainty. Raises `CalibrationError` if it is damaged."""
    quality = file.quality
    if "covariance" not in quality:
        return replace(camera_from(file.value, where), uncertainty=unknown_uncertainty(where))
    try:
        terms = tuple(TERMS.index(name) for name in quality["terms"])
        covariance = np.asarray(quality["covariance"], np.float64).reshape(len(terms), len(terms))
        if not np.isfinite(covariance).all() or (np.linalg.eigvalsh(covariance) < -1e-9).any():
            raise ValueError("no covariance")
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{where}: its covariance is damaged ({reason(error)})") from error
    known = CameraUncertainty(terms, covariance, file.assessment.doubts)
    return replace(camera_from(file.value, where), uncertainty=known)


def unknown_uncertainty(where: str) -> CameraUncertainty:
    """Return the uncertainty of a camera whose file states none."""
    return CameraUncertainty(doubts=(f"{where} states no uncertainty: rig calibrate camera measures it",))


def camera_from(content: Mapping[str, Any], where: str) -> CameraModel:
    """Create a camera from a file's content. Raises `CalibrationError` naming the invalid key."""
    try:
        size = int(content["image_width"]), int(content["image_height"])
        matrix = np.asarray(content["camera_matrix"]["data"], np.float64).reshape(3, 3)
        distortion = np.asarray(content["distortion_coefficients"]["data"], np.float64).reshape(-1)
    except KeyError as error:
        why = why_damaged(Path(where), error)
        raise CalibrationError(f"{where}: {why}; neither camera_info nor OpenCV layout") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{where}: a matrix is damaged ({reason(error)})") from error
    distortion = _supported_terms(content, distortion, where)
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all()):
        raise CalibrationError(f"{where}: contains NaN or infinite values")
    focal, (cx, cy) = (matrix[0, 0], matrix[1, 1]), matrix[:2, 2]
    if min(size) < 1 or min(focal) < LEAST_FOCAL * max(size):
        raise CalibrationError(
            f"{where}: size {size} and focal length {matrix[0, 0]:.6g} are not valid: both are in px"
        )
    if not np.allclose(matrix, [[focal[0], 0.0, cx], [0.0, focal[1], cy], [0.0, 0.0, 1.0]], atol=1e-6):
        raise CalibrationError(
            f"{where}: camera_matrix is {matrix.tolist()}, not fx 0 cx, 0 fy cy, 0 0 1: is it transposed, as "
            "MATLAB writes it, or has it a skew, which is not supported?"
        )
    if not (0.0 <= cx < size[0] and 0.0 <= cy < size[1]):
        raise CalibrationError(
            f"{where}: the principal point ({cx:.6g}, {cy:.6g}) is outside the picture of {size} px: is the "
            "matrix of pictures of another size?"
        )
    terms = 5 if len(distortion) <= 5 else 8
    return CameraModel(size, matrix, np.pad(distortion, (0, terms - len(distortion))))


def _supported_terms(content: Mapping[str, Any], distortion: Array, where: str) -> Array:
    """Return the terms without a tail of zeros. Raises `CalibrationError` for another lens than a pinhole.

    OpenCV writes a fisheye lens with the same keys and four terms; its sample adds `fisheye_model: 1`.
    """
    used = distortion[: int(np.flatnonzero(distortion)[-1]) + 1] if distortion.any() else distortion[:0]
    lens = str(content.get("distortion_model", "plumb_bob"))
    for key in _MODEL_KEYS:
        if "pinhole" not in str(content.get(key, "pinhole")).lower():
            lens = f"{key}: {content[key]}"
    if str(content.get("fisheye_model", 0)).lower() not in ("0", "false", "none", ""):
        lens = "fisheye (fisheye_model is set)"
    if lens not in _LENSES or len(used) > _MOST_TERMS:
        raise CalibrationError(
            f"{where}: lens model {quote(lens)} with {len(distortion)} terms is not supported: calibrate the "
            f"camera as a pinhole (plumb_bob or rational_polynomial, zeros after term {_MOST_TERMS})"
        )
    return used


def _matrix(values: Array) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": [float(v) for v in values.ravel()]}
