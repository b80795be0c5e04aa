"""Edge refinement, and the two-marker angle from picture to degrees."""

import cv2
import numpy as np
import pytest

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle, PlanarAngle, assess_markers
from calibration.markers.tracker import MarkerTracker, Refine
from calibration.targets.aruco import Refusal, detector, refine_edges, refine_quick
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.calibration.study import find_corners
from support.markers import find_markers
from support.marks import long

NEAR = MarkerPictures(side_px=40.0, tilt_deg=15.0)


def angle_of(pictures: MarkerPictures, refine: Refine = refine_quick) -> MarkerAngle:
    camera = CameraModel(pictures.scene.size, pictures.scene.camera_matrix, pictures.scene.distortion)
    return MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary, refine=refine), camera)


def _still(pictures: MarkerPictures, count: int, seed: int = 0) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [pictures.draw(0.0, rng) for _ in range(count)]


@pytest.mark.slow
@pytest.mark.parametrize("refine", [refine_edges, refine_quick])
@pytest.mark.parametrize("side_px", [40.0, *long(24.0, 80.0)])
def test_edges_find_corners_better_than_windows(side_px: float, refine: Refine) -> None:
    pictures = MarkerPictures(side_px=side_px, tilt_deg=15.0)
    rng = np.random.default_rng(1)
    by_edges, by_windows = [], []
    for _ in range(6):
        picture = pictures.draw(12.0, rng)
        found = find_markers(picture, pictures.dictionary)
        corners = np.array([found[i] for i in pictures.ids])
        edges = refine(picture, corners)
        assert not isinstance(edges, Refusal)
        truth = pictures.exact_corners(12.0)
        by_edges.append(edges - truth)
        by_windows.append(corners - truth)
    assert np.std(by_edges) < 0.6 * np.std(by_windows)
    assert np.std(by_edges) < 0.12


@pytest.mark.slow
@pytest.mark.parametrize(
    "turn_deg",
    [
        0.1, -30.0, 179.9,
        *long(0.0, -0.1, 15.0, 90.0, -179.9, 180.0),
    ],
)  # fmt: skip
def test_rotation_is_measured_with_its_sign(turn_deg: float) -> None:
    angle = angle_of(NEAR)
    angle.take_reference(_still(NEAR, 12))
    angle.forget()
    rng = np.random.default_rng(3)
    seen = [angle.measure(NEAR.draw(turn_deg, rng)) for _ in range(4)]
    for answer in seen:
        assert isinstance(answer, PlanarAngle)
        off = (answer.angle_deg - turn_deg + 180.0) % 360.0 - 180.0
        assert abs(off) < 0.15
        assert abs(off) < 6 * max(answer.sigma_deg, 0.01)


def test_report_at_rest_assesses_size_and_scatter() -> None:
    good = assess_markers(_still(NEAR, 30), angle_of(NEAR))
    assert good.assessment.verdict is Verdict.GOOD, good.assessment
    small = MarkerPictures(side_px=20.0, tilt_deg=5.0)
    weak = assess_markers(_still(small, 30), angle_of(small))
    assert any("px wide" in reason for reason in weak.assessment.reasons)


def test_pictures_without_markers_and_too_few_are_refused() -> None:
    angle = MarkerAngle(MarkerTracker(NEAR.ids, NEAR.dictionary))
    with pytest.raises(CalibrationError, match="no reference"):
        angle.measure(_still(NEAR, 1)[0])
    with pytest.raises(CalibrationError, match="0 of 12"):
        angle.take_reference([np.full((480, 640), 128, np.uint8)] * 12)
    with pytest.raises(CalibrationError, match="at least 20 are needed"):
        assess_markers(_still(NEAR, 5), angle)


def test_every_reference_marker_is_detected_at_its_position(real_data) -> None:
    folder = real_data / "opencv_photos"
    gold = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    for name in np.unique(gold["image"]):
        rows = gold[gold["image"] == name]
        dictionary = str(folder / "tutorial_dict.yml") if name.startswith("gb") else "DICT_6X6_250"
        grey = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
        found = find_corners(grey, dictionary)
        for row in rows:
            corners = np.array([[row[f"x{i}"], row[f"y{i}"]] for i in range(4)], np.float64)
            assert int(row["marker_id"]) in found, (name, row["marker_id"])
            assert np.linalg.norm(found[int(row["marker_id"])] - corners, axis=1).max() <= 2.0, (name, row)


def test_dictionary_file_is_read_or_rejected(tmp_path) -> None:
    with pytest.raises(CalibrationError, match="dictionary"):
        detector(str(tmp_path / "none.yml"))
    (tmp_path / "bad.yml").write_text("%YAML:1.0\nnmarkers: 3\n")
    with pytest.raises(CalibrationError, match="dictionary"):
        detector(str(tmp_path / "bad.yml"))
