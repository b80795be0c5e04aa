"""Points outside the stated size of a picture: the size is wrong, and the calibration is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.camera.intrinsics import calibrate_camera
from calibration.hand_eye.solve import Setup, calibrate_hand_eye
from calibration.targets.boards import outside
from drivers.errors import CalibrationError
from drivers.images import encode_png
from rig.benchmark.calibration.board_scenes import BOARD, CAMERA, board_pose
from rig.benchmark.calibration.motion_scenes import CAMERA as MOVING_CAMERA
from rig.benchmark.calibration.motion_scenes import general_scene
from rig.calibrate.tactile import read_press_folder
from support.board_views import exact_view
from support.simulated_gel import SimulatedGel

RNG = np.random.default_rng(0)
VIEWS = [exact_view(BOARD, CAMERA, board_pose(RNG), f"{i:02d}", RNG) for i in range(10)]


@pytest.mark.parametrize(
    ("size", "swapped"),
    [
        ((720, 1280), True),
        ((640, 480), False),
        ((1280, 500), False),
        ((900, 720), False),
        ((640, 360), False),
    ],
)
def test_points_outside_the_stated_size_are_refused(size: tuple[int, int], swapped: bool) -> None:
    with pytest.raises(CalibrationError, match=f"outside the picture of {size[0]} x {size[1]} px") as refused:
        calibrate_camera([replace(view, size=size) for view in VIEWS])
    assert ("are width and height swapped?" in str(refused.value)) is swapped


def test_one_view_with_a_point_outside_is_enough() -> None:
    seen = VIEWS[4].image_px.copy()
    seen[3] = (1290.0, 300.0)
    views = [*VIEWS[:4], replace(VIEWS[4], image_px=seen), *VIEWS[5:]]
    with pytest.raises(CalibrationError, match=r"view 04: 1 point outside .* as at \(1290, 300\)"):
        calibrate_camera(views)


@pytest.mark.parametrize(("point", "inside"), [(-0.9, True), (-1.5, False), (1279.9, True), (1281.0, False)])
def test_points_refined_at_the_border_are_inside(point: float, inside: bool) -> None:
    seen = VIEWS[0].image_px.copy()
    seen[0, 0] = point
    assert (outside(replace(VIEWS[0], image_px=seen)) is None) is inside


def test_hand_eye_sample_with_points_outside_is_rejected() -> None:
    _, samples = general_scene(np.random.default_rng(0), 10)
    beyond = replace(samples[2].view, image_px=np.add(samples[2].view.image_px, (2000.0, 0.0)))
    samples[2] = replace(samples[2], view=beyond)
    found = calibrate_hand_eye(samples, MOVING_CAMERA, Setup.EYE_TO_HAND)
    assert [r.id for r in found.rejected if "outside the picture" in r.reason] == [samples[2].id]


@pytest.mark.parametrize("centre", [(119, 500), (300, 100), (-4, 100)])
def test_circle_outside_its_picture_is_rejected(centre: tuple[int, int], tmp_path: Path) -> None:
    gel = SimulatedGel(seed=3)
    (tmp_path / "background.png").write_bytes(encode_png(np.rint(gel.reference).astype(np.uint8)))
    (tmp_path / "0.png").write_bytes(encode_png(gel.presses(1)[0].image))
    (tmp_path / "circles.csv").write_text(f"frame,center_x,center_y,radius\n0,{centre[0]},{centre[1]},40\n")
    presses = read_press_folder(tmp_path, ball_mm=8.8)
    assert presses.pressed == []
    assert "outside the picture of 240 x 320 px" in presses.rejected[0].reason
