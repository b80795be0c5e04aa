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
from rig.calibrate.result import CalibrationResult, file_result


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
