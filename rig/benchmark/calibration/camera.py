"""Limits of camera calibration: rendered views, degenerate sets, real photos."""

from pathlib import Path

import numpy as np

from calibration.camera.checks import assess_camera, camera_difference_px
from calibration.camera.intrinsics import CameraFit, calibrate_camera, predict
from calibration.targets.boards import Chessboard, Target, View, parse_target
from calibration.verdict import Verdict
from drivers.images import read_image
from rig.benchmark.calibration.board_scenes import BOARD, CAMERA, board_pose, render_target
from rig.benchmark.measured import Measured, at_most, informative, not_there

_PUBLISHED_CHESSBOARD = (535.92, 342.28, 235.57)
"""Focal length and centre, px, as OpenCV publishes them for its left photos."""
_PUBLISHED_CHARUCO = (452.51, 456.77)


def camera_limits(seed: int, data: Path | None) -> list[Measured]:
    """1280 x 720, ChArUco 8 x 6, 25 and 18 mm, blur 0.8 px, noise 3 grey: 20 views fitted, 10 held out."""
    views = rendered_views(seed, 30)
    result = calibrate_camera(views[:20])
    off = np.linalg.norm(camera_difference_px(CAMERA, result.fit.camera), axis=-1)
    return [
        at_most("intrinsics, 20 rendered views: held-out, px", predict(result.fit.camera, views[20:]), 0.1),
        informative("intrinsics, 20 rendered views: projection error, rms px", np.sqrt((off**2).mean())),
        *real_photos(data),
    ]


def rendered_views(seed: int, count: int) -> list[View]:
    """Views of the standard board that show a dozen corners at least."""
    rng = np.random.default_rng((seed, 20))
    views: list[View] = []
    while len(views) < count:
        name = f"{len(views):02d}"
        found = BOARD.find(render_target(BOARD, CAMERA, board_pose(rng), rng), name)
        if isinstance(found, View) and len(found.ids) >= 12:
            views.append(found)
    return views


def real_photos(data: Path | None) -> list[Measured]:
    """OpenCV's chessboard and ChArUco photos against what it publishes for them."""
    if data is None:
        return [not_there("real chessboard and ChArUco photos")]
    left = sorted((data / "opencv_chessboard").glob("left*.jpg"))
    recipe = calibrate_camera(_found(Chessboard((9, 6), 0.025, window_px=11), left), keep_all=True)
    ours = calibrate_camera(_found(Chessboard((9, 6), 0.025), left))
    board = parse_target("charuco:5x7:40:20:DICT_6X6_250")
    four = calibrate_camera(_found(board, sorted((data / "opencv_photos").glob("charuco_img*.jpg"))))
    sigmas = np.abs(np.diag(four.fit.camera.matrix)[:2] - _PUBLISHED_CHARUCO) / four.sigma[:2]
    recipe_off = f"{_FROM_PUBLISHED} (OpenCV's recipe: 11 px windows, all views kept), px"
    return [
        at_most(recipe_off, _from_published(recipe), 1.0),
        informative(f"{_FROM_PUBLISHED} (our windows), px", _from_published(ours)),
        informative("chessboard photos: held-out with OpenCV's recipe, px", recipe.held_out_rms_px),
        informative("chessboard photos: held-out with our windows, px", ours.held_out_rms_px),
        at_most(
            "four ChArUco photos: not judged weak",
            float(assess_camera(four).verdict is not Verdict.WEAK),
            0.0,
        ),
        at_most("four ChArUco photos: published f, in our sigmas", sigmas.max(), 3.0),
    ]


_FROM_PUBLISHED = "chessboard photos: f and c from the published"


def _from_published(result: CameraFit) -> float:
    """The largest difference of fx, fy, cx, cy from the published numbers, px."""
    m = result.fit.camera.matrix
    f, cx, cy = _PUBLISHED_CHESSBOARD
    return float(np.abs([m[0, 0] - f, m[1, 1] - f, m[0, 2] - cx, m[1, 2] - cy]).max())


def _found(target: Target, photos: list[Path]) -> list[View]:
    views = [target.find(read_image(photo, grey=True), photo.name) for photo in photos]
    return [view for view in views if isinstance(view, View)]
