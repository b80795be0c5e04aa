"""Calibration files: written, read back, and rejected if they do not fit; camera files of other programs."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from calibration.camera.files import camera_info, read_camera
from calibration.camera.model import CameraModel
from calibration.store import CalibrationFile, age_days, age_text, load, plain, save
from calibration.verdict import Assessment, Rejected, Verdict, limits
from drivers.errors import CalibrationError, RecordingError

NOW = datetime(2026, 3, 4, 5, 6, tzinfo=UTC)
CAMERA = CameraModel(
    (640, 480), np.array([[600.0, 0, 320], [0, 601, 240], [0, 0, 1]]), np.array([-0.2, 0.1, 0, 0, 0.0])
)


def camera_file(*refusals: str) -> CalibrationFile:
    assessment = Assessment(refusals, doubts=("few views",))
    return CalibrationFile(
        "camera", {"camera": "C1"}, camera_info(CAMERA, "C1"), assessment, NOW.isoformat(),
        quality={"held_out_px": np.float64(0.07)}, rejected=(Rejected("a.png", "same view as b.png"),),
    )  # fmt: skip


def test_calibration_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    save(camera_file(), tmp_path / "camera.yaml")
    back = load(tmp_path / "camera.yaml", "camera", {"camera": "C1"})
    assert back.assessment.verdict is Verdict.WEAK
    assert back.rejected == (Rejected("a.png", "same view as b.png"),)
    assert back.quality["held_out_px"] == 0.07
    days = age_days(back.created, NOW + timedelta(days=3))
    assert days == pytest.approx(3.0)
    assert age_text(days) == "3 days"
    read = read_camera(tmp_path / "camera.yaml", "C1")
    assert np.array_equal(read.matrix, CAMERA.matrix)
    assert np.array_equal(read.distortion, CAMERA.distortion)


def test_stored_camera_is_read_with_its_uncertainty(tmp_path: Path) -> None:
    quality = {"terms": ["fx", "fy", "k1"], "covariance": np.diag([4.0, 4.0, 1e-4])}
    save(replace(camera_file(), quality=quality), tmp_path / "camera.yaml")
    known = read_camera(tmp_path / "camera.yaml").uncertainty
    assert known is not None
    assert known.terms == (0, 1, 4)
    assert known.doubts == ("few views",)
    off = [model.matrix[0, 0] - 600.0 for model in read_camera(tmp_path / "camera.yaml").off_by_one_sigma()]
    assert np.hypot.reduce(off) == pytest.approx(2.0)


def test_damaged_covariance_is_rejected(tmp_path: Path) -> None:
    for terms, covariance in (
        (["fx", "fy"], np.eye(3)),
        (["focal"], np.eye(1)),
        (["fx", "fy"], np.array([[1.0, 3.0], [3.0, 1.0]])),
        (3, "none"),
    ):
        damaged = {"terms": terms, "covariance": covariance}
        save(replace(camera_file(), quality=damaged), tmp_path / "camera.yaml")
        with pytest.raises(CalibrationError, match="its covariance is damaged"):
            read_camera(tmp_path / "camera.yaml")


def test_time_without_a_zone_is_read_as_utc() -> None:
    assert age_days(NOW.replace(tzinfo=None).isoformat(), NOW + timedelta(days=3)) == pytest.approx(3.0)


def test_calibration_of_another_kind_or_with_refused_verdict_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    save(camera_file("all views are square-on"), path)
    with pytest.raises(CalibrationError, match="'tcp' is needed"):
        load(path, "tcp")
    with pytest.raises(CalibrationError, match="square-on"):
        read_camera(path)
    assert load(path, "camera", allow_refused=True).assessment.refusals


WITHOUT_INPUTS = """calibration: {schema: 1, kind: camera, serials: {camera: C}, refusals: [], doubts: [],
  created: '2026-01-01T00:00:00+00:00', inputs: here}"""


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("", "no mapping"), ("{", "not valid YAML"), ("a: 1", "schema"), ("- 1", "no mapping"),
        ("calibratoin:\n  schema: 1\n", r"schema 1 \(line 1, column 1 has 'calibratoin'\)"),
        (
            "calibration:\n  schema: 1\n  kind: camera\n  serial: {camera: C}\n",
            r"no 'serials' \(line 4, column 3 has 'serial'\)",
        ),
        ("calibration: {schema: 9}", "schema"), ("calibration: {schema: 1, kind: camera}", "damaged"),
        (WITHOUT_INPUTS, "'inputs' is not a mapping"),
    ],
)  # fmt: skip
def test_damaged_calibration_files_are_rejected(tmp_path: Path, text: str, seen: str) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=seen):
        load(path, "camera")


def test_nan_is_refused_by_every_limit() -> None:
    for compared in (limits((np.nan, 1.0, 2.0, "{value}")), limits((np.nan, 2.0, 1.0, "{value}"))):
        assert compared.verdict is Verdict.REFUSED


def test_nan_and_unwritable_folder_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="NaN or an infinite"):
        plain({"a": np.array([1.0, np.nan])}, "file")
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        save(camera_file(), tmp_path / "file" / "camera.yaml")


ROS = (
    "image_width: 640\nimage_height: 480\ncamera_name: C7\ncamera_matrix: {rows: 3, cols: 3, data: "
    "[500, 0, 320, 0, 500, 240, 0, 0, 1]}\ndistortion_model: plumb_bob\n"
    "distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}\n"
)


def test_opencv_and_ros_files_are_read(tmp_path: Path, real_data: Path) -> None:
    published = read_camera(real_data / "opencv_photos" / "tutorial_camera_charuco.yml")
    assert published.matrix[0, 0] == pytest.approx(452.51, abs=0.01)
    assert published.distortion == pytest.approx(
        [0.12137, -1.08547, 1.17868e-4, -4.624e-4, 2.95425], rel=1e-3
    )
    (tmp_path / "ros.yaml").write_text(ROS)
    assert read_camera(tmp_path / "ros.yaml").matrix[1, 1] == 500
    with pytest.raises(CalibrationError, match="C7"):
        read_camera(tmp_path / "ros.yaml", "C8")


@pytest.mark.parametrize(
    ("old", "new", "seen"),
    [("plumb_bob", "equidistant", "equidistant"), ("500, 0, 320", ".nan, 0, 320", "NaN or infinite"),
     ("image_width", "width", "image_width"), ("500, 0, 320", "-5, 0, 320", "are not valid"),
     ("1]}", "1, 4]}", "damaged"),
     ("0, 320, 0, 500, 240, 0, 0, 1", "0, 0, 0, 500, 0, 320, 240, 1", "transposed, as MATLAB writes it"),
     ("500, 0, 320", "500, 2, 320", "has it a skew"), ("500, 0, 320", "500, 0, 960", "of another size"),
     ("500, 0, 320, 0, 500, 240", "0.8, 0, 0.5, 0, 0.8, 0.5", "both are in px")],
)  # fmt: skip
def test_camera_files_are_checked(tmp_path: Path, old: str, new: str, seen: str) -> None:
    (tmp_path / "ros.yaml").write_text(ROS.replace(old, new))
    with pytest.raises(CalibrationError, match=seen):
        read_camera(tmp_path / "ros.yaml")


OPENCV = (
    "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n{extra}\ncamera_matrix: !!opencv-matrix\n"
    "   rows: 3\n   cols: 3\n   dt: d\n   data: [ 400., 0., 319.5, 0., 400., 239.5, 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {count}\n   dt: d\n   data: {terms}\n"
)
FISHEYE = [-0.02, 0.01, -0.004, 0.001]
RATIONAL = [1.2, 0.4, 1e-4, -2e-4, 0.02, 1.5, 0.6, 0.05]


def camera_with(folder: Path, terms: list[float], extra: str = "") -> Path:
    path = folder / "camera.yml"
    path.write_text(OPENCV.format(extra=extra, count=len(terms), terms=terms))
    return path


@pytest.mark.parametrize(
    ("extra", "said"),
    [("fisheye_model: true", "fisheye"), ("distortion_model: equidistant", "equidistant"),
     ("distortion_model: plumb_bob\nfisheye_model: 1", "fisheye"), ("camera_model: omni", "omni"),
     ("model_type: KANNALA_BRANDT", "KANNALA_BRANDT"),
     ("lens_model: LENSMODEL_OPENCV_FISHEYE", "LENSMODEL_OPENCV_FISHEYE")],
)  # fmt: skip
def test_lens_that_is_no_pinhole_is_refused_by_name(extra: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=rf"lens model .*{said}.*is not supported"):
        read_camera(camera_with(tmp_path, FISHEYE, extra))


def test_pinhole_is_accepted(tmp_path: Path) -> None:
    for extra in ("", "fisheye_model: 0", "camera_model: pinhole", "distortion_model: plumb_bob"):
        assert read_camera(camera_with(tmp_path, FISHEYE, extra)).distortion.tolist() == [*FISHEYE, 0.0]


@pytest.mark.parametrize(
    ("used", "count"), [(8, 8), (8, 14), (5, 5), (5, 12), (2, 8), (0, 5), (0, 14)],
)  # fmt: skip
def test_zeros_at_the_end_are_no_terms(used: int, count: int, tmp_path: Path) -> None:
    padded = RATIONAL[:used] + [0.0] * (count - used)
    camera = read_camera(camera_with(tmp_path, padded, "distortion_model: rational_polynomial"))
    assert camera.distortion.tolist() == padded[: 8 if used > 5 else 5]
    written = camera_info(camera, "C1")["distortion_model"]
    assert written == ("rational_polynomial" if used > 5 else "plumb_bob")


def test_thin_prism_and_tilt_terms_are_refused(tmp_path: Path) -> None:
    for place in (8, 13):
        terms = RATIONAL + [0.0] * 6
        terms[place] = 1e-3
        with pytest.raises(CalibrationError, match="14 terms is not supported"):
            read_camera(camera_with(tmp_path, terms))
