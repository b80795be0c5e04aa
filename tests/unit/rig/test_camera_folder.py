"""Pictures in a folder from which a camera is calibrated, and the files that are written."""

from pathlib import Path

import numpy as np
import PIL.Image as Pillow
import pytest

from calibration.store import load
from calibration.verdict import Assessment
from drivers.errors import CalibrationError
from rig.calibrate.camera import CameraOptions, solve_camera
from rig.calibrate.kind import Samples
from rig.calibrate.result import MM, CalibrationResult, Figure, file_result


def test_picture_with_another_orientation_than_the_others_is_left_out(tmp_path: Path) -> None:
    for name, orientation in (("1.jpg", 1), ("2.jpg", 3), ("3.jpg", None), ("4.jpg", 1)):
        facts = Pillow.Exif()
        if orientation is not None:
            facts[0x0112] = orientation
        Pillow.fromarray(np.full((48, 64), 200, np.uint8)).save(tmp_path / name, exif=facts)
    result = solve_camera(Samples(tmp_path), CameraOptions(target="chessboard:6x4:25"))
    assert [each.reason for each in result.rejected if "EXIF" in each.reason] == [
        "EXIF orientation 3 differs from the others' 1: keep one orientation"
    ]


@pytest.mark.heavy
def test_refused_calibration_does_not_replace_a_usable_one(tmp_path: Path) -> None:
    def filed(value: int, *refusals: str) -> None:
        file_result(CalibrationResult("sync", {"stream": "S1"}, {"n": value}, Assessment(refusals)), tmp_path)

    for value in (1, 2):
        with pytest.raises(CalibrationError, match=r"refused: noisy .page: .*sync-S1\.html"):
            filed(value, "noisy")
    filed(3)
    with pytest.raises(CalibrationError, match=r"refused: noisy .page: .*sync-S1-refused\.html"):
        filed(4, "noisy")
    assert load(tmp_path / "sync-S1.yaml", "sync").value == {"n": 3}
    filed(5)
    assert load(tmp_path / "sync-S1.yaml", "sync").value == {"n": 5}


def test_figures_are_the_values_of_the_file_and_the_lines_of_page_and_terminal(tmp_path: Path) -> None:
    figures = [
        Figure("tip_m", (0.001, 0.0025), "tip, x, y", *MM, sigma=(0.0001, 0.0002), top=True),
        Figure("share", {"left": 0.5, "right": 0.25}, "pressed", ".0f", "%", 100.0),
        Figure("covariance", [[1.0]]),
        Figure("", "pinhole", "lens"),
        Figure("drift", None, "drift", ".1f"),
    ]
    result = CalibrationResult("sync", {"stream": "S1"}, {"n": 1}, Assessment(), figures)
    filed = file_result(result, tmp_path)
    file = load(tmp_path / "sync-S1.yaml", "sync")
    assert file.value == filed["value"] == {"n": 1, "tip_m": [0.001, 0.0025]}
    assert file.quality == {
        "share": {"left": 0.5, "right": 0.25}, "covariance": [[1.0]], "tip_m_sigma": [0.0001, 0.0002],
    }  # fmt: skip
    lines = {"tip, x, y": "1.00 ± 0.10, 2.50 ± 0.20 mm", "pressed": "left 50, right 25 %", "lens": "pinhole"}
    assert filed["numbers"] == lines
    page = (tmp_path / "sync-S1.html").read_text()
    assert all(f"{name}</td>" in page and f"{text}</td>" in page for name, text in lines.items())
