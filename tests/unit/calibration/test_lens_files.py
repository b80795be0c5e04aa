"""Camera files of other programs: a fisheye lens is refused by name, zeros at the end are no terms."""

from pathlib import Path

import numpy as np
import pytest

from calibration.camera.files import camera_info, read_camera
from drivers.errors import CalibrationError

OPENCV = (
    "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n{extra}\ncamera_matrix: !!opencv-matrix\n"
    "   rows: 3\n   cols: 3\n   dt: d\n   data: [ 400., 0., 319.5, 0., 400., 239.5, 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {count}\n   dt: d\n   data: {terms}\n"
)
RATIONAL = [1.2, 0.4, 1e-4, -2e-4, 0.02, 1.5, 0.6, 0.05]


def _file(folder: Path, terms: list[float], extra: str = "") -> Path:
    path = folder / "camera.yml"
    path.write_text(OPENCV.format(extra=extra, count=len(terms), terms=terms))
    return path


@pytest.mark.parametrize(
    "extra",
    [
        "fisheye_model: 1",
        "fisheye_model: true",
        "distortion_model: equidistant",
        "distortion_model: fisheye",
        "distortion_model: kannala_brandt",
        "distortion_model: plumb_bob\nfisheye_model: 1",
        "camera_model: omni",
        "model_type: KANNALA_BRANDT",
        "lens_model: LENSMODEL_OPENCV_FISHEYE",
    ],
)
def test_lens_that_is_no_pinhole_is_refused_by_name(extra: str, tmp_path: Path) -> None:
    path = _file(tmp_path, [-0.02, 0.01, -0.004, 0.001], extra)
    with pytest.raises(CalibrationError, match=r"lens model .*is not supported") as refused:
        read_camera(path)
    name = extra.split("\n")[-1].split(": ")[1]
    assert name in str(refused.value) or "fisheye" in str(refused.value)


@pytest.mark.parametrize(
    "extra", ["", "fisheye_model: 0", "camera_model: pinhole", "distortion_model: plumb_bob"]
)
def test_pinhole_is_accepted(extra: str, tmp_path: Path) -> None:
    camera = read_camera(_file(tmp_path, [-0.02, 0.01, -0.004, 0.001], extra))
    assert camera.distortion.tolist() == [-0.02, 0.01, -0.004, 0.001, 0.0]


@pytest.mark.parametrize("terms", [RATIONAL, RATIONAL[:5], RATIONAL[:4], RATIONAL[:2], [0.0], []], ids=len)
@pytest.mark.parametrize("count", [5, 8, 12, 14])
def test_zeros_at_the_end_are_no_terms(terms: list[float], count: int, tmp_path: Path) -> None:
    padded = terms + [0.0] * (count - len(terms))
    camera = read_camera(_file(tmp_path, padded, "distortion_model: rational_polynomial"))
    assert len(camera.distortion) == (8 if len(terms) > 5 else 5)
    assert np.array_equal(camera.distortion[: len(terms)], terms)
    assert not camera.distortion[len(terms) :].any()
    written = camera_info(camera, "C1")["distortion_model"]
    assert written == ("rational_polynomial" if len(terms) > 5 else "plumb_bob")


@pytest.mark.parametrize("place", [8, 11, 13])
def test_thin_prism_and_tilt_terms_are_refused(place: int, tmp_path: Path) -> None:
    terms = RATIONAL + [0.0] * 6
    terms[place] = 1e-3
    with pytest.raises(CalibrationError, match="14 terms is not supported"):
        read_camera(_file(tmp_path, terms))
