"""`rig benchmark calibration`: the limits of the calibrations, measured with fixed seeds."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calibration.camera.checks import assess_camera, camera_difference_px
from calibration.camera.intrinsics import CameraFit, calibrate_camera, predict
from calibration.gel.balls import BallPress, calibrate_gel
from calibration.gel.presses import find_press
from calibration.hand_eye.samples import Setup
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.targets.boards import Chessboard, Target, View, parse_target
from calibration.time_offset import time_offset
from calibration.verdict import Verdict
from drivers.formats import number_in, read_csv_rows
from drivers.images import read_image
from rig.benchmark.calibration import board_scenes
from rig.benchmark.calibration.board_scenes import BOARD, board_pose, render_target
from rig.benchmark.calibration.markers import AngleRow, angle_rows, marker_limits
from rig.benchmark.calibration.motion_scenes import CAMERA, Truth, general_scene, wiggle_scene
from rig.benchmark.harness import (
    Measured,
    Report,
    Run,
    Study,
    at_most,
    between,
    data_folder,
    informative,
    not_there,
    table_of,
)
from rig.declared import option

_FURTHER_TRIALS = 60
"""Number of trials with flipped views, and with the camera on the hand."""
_SYNC_TRIALS, _OFFSET_S = 40, 0.0473
_PUBLISHED_CHESSBOARD = (535.92, 342.28, 235.57)
"""Focal length and centre, px, as OpenCV publishes them for its left photos."""
_PUBLISHED_CHARUCO = (452.51, 456.77)
_FROM_PUBLISHED = "chessboard photos: f and c from the published"
GELSIGHT_MINI_MM_PER_PX = (0.0634, 0.0634)
"""GelSight's published scale at 320 x 240 px; its error nearly cancels in the radius of a ball."""


def hand_eye_limits(seed: int, trials: int) -> list[Measured]:
    """Calibrate hand-eye from 20 views of a 60 mm marker at 0.5 to 0.9 m.

    Noise: 0.2 px in the image, 0.1 mm and 0.02 degrees in the robot's poses.
    """
    errors, held = [], []
    for truth, result in _trials((seed, 1), trials):
        if result.pose is None or result.spread is None:
            errors.append((np.inf, np.inf))
            held.append(False)
        else:
            errors.append(truth.error(result.pose))
            held.append(result.spread.holds(truth.error_vector(result.pose)))
    mm, deg = np.array(errors).T
    flipped = [_off_mm(*of) for of in _trials((seed, 2), _FURTHER_TRIALS, flipped=2)]
    in_hand = [_off_mm(*of) for of in _trials((seed, 3), _FURTHER_TRIALS, Setup.EYE_IN_HAND)]
    what = f"hand-eye, {trials} trials"
    few = f"hand-eye, 2 of 20 flipped, {_FURTHER_TRIALS} trials"
    hand = f"eye-in-hand, same noise, {_FURTHER_TRIALS} trials"
    return [
        at_most(f"{what}: median position, mm", np.median(mm), 0.5),
        at_most(f"{what}: 95 % position, mm", np.percentile(mm, 95), 1.0),
        at_most(f"{what}: median orientation, deg", np.median(deg), 0.05),
        at_most(f"{what}: 95 % orientation, deg", np.percentile(deg, 95), 0.1),
        between(f"{what}: 95 % region holds the truth", np.mean(held), 0.90, 0.98),
        at_most(f"{few}: 95 % position, mm", np.percentile(flipped, 95), 1.0),
        informative(f"{few}: worst position, mm", np.max(flipped)),
        informative(f"{hand}: median position, mm", np.median(in_hand)),
    ]


def _trials(
    seed: tuple[int, int], trials: int, setup: Setup = Setup.EYE_TO_HAND, flipped: int = 0
) -> Iterator[tuple[Truth, HandEyeResult]]:
    for trial in range(trials):
        truth, samples = general_scene(np.random.default_rng((*seed, trial)), setup=setup, flipped=flipped)
        yield truth, calibrate_hand_eye(samples, CAMERA, setup)


def _off_mm(truth: Truth, result: HandEyeResult) -> float:
    return np.inf if result.pose is None else truth.error(result.pose)[0]


def sync_limits(seed: int) -> list[Measured]:
    """Estimate the time offset of a camera from a robot at 500 Hz.

    The camera has 30 Hz, 0.2 degrees of noise, 2 ms of jitter and 5 % dropped frames.
    """

    def offsets(number: int, motion: str) -> list[float | None]:
        scenes = (
            wiggle_scene(np.random.default_rng((seed, number, trial)), motion, _OFFSET_S)
            for trial in range(_SYNC_TRIALS)
        )
        return [time_offset(*scene).offset_s for scene in scenes]

    off = [np.inf if found is None else abs(found - _OFFSET_S) for found in offsets(4, "chirp")]
    answered = sum(found is not None for found in offsets(5, "static"))
    return [
        at_most(f"sync, {_SYNC_TRIALS} wiggles: 95 % error, ms", 1e3 * np.percentile(off, 95), 1.0),
        at_most(f"sync, {_SYNC_TRIALS} static recordings: answered", answered, 0.0),
    ]


def camera_limits(seed: int, data: Path | None) -> list[Measured]:
    """Calibrate a camera from 20 rendered views of a ChArUco board, and test it on 10 held-out views.

    Images of 1280 x 720 px; board of 8 x 6 squares, 25 mm, with markers of 18 mm; blur 0.8 px, noise 3 grey
    levels.
    """
    views = rendered_views(seed, 30)
    result = calibrate_camera(views[:20])
    off = np.linalg.norm(camera_difference_px(board_scenes.CAMERA, result.fit.camera), axis=-1)
    return [
        at_most("intrinsics, 20 rendered views: held-out, px", predict(result.fit.camera, views[20:]), 0.1),
        informative("intrinsics, 20 rendered views: projection error, rms px", np.sqrt((off**2).mean())),
        *real_photos(data),
    ]


def rendered_views(seed: int, count: int) -> list[View]:
    """Return rendered views of the standard board with at least 12 corners."""
    rng = np.random.default_rng((seed, 20))
    views: list[View] = []
    while len(views) < count:
        name = f"{len(views):02d}"
        found = BOARD.find(render_target(BOARD, board_scenes.CAMERA, board_pose(rng), rng), name)
        if isinstance(found, View) and len(found.ids) >= 12:
            views.append(found)
    return views


def real_photos(data: Path | None) -> list[Measured]:
    """Calibrate from OpenCV's chessboard and ChArUco photos; compare with its published results."""
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


def _from_published(result: CameraFit) -> float:
    """Return the largest difference of fx, fy, cx, cy from the published values, px."""
    m = result.fit.camera.matrix
    f, cx, cy = _PUBLISHED_CHESSBOARD
    return float(np.abs([m[0, 0] - f, m[1, 1] - f, m[0, 2] - cx, m[1, 2] - cy]).max())


def _found(target: Target, photos: list[Path]) -> list[View]:
    views = [target.find(read_image(photo, grey=True), photo.name) for photo in photos]
    return [view for view in views if isinstance(view, View)]


def gel_limits(data: Path | None) -> list[Measured]:
    """Fit the colour map by cross-validation, and measure the ball's radius in the held-out presses."""
    if data is None:
        return [not_there("tactile map: radius of held-out balls")]
    presses = gelsight_presses(data / "gelsight_ball")
    result = calibrate_gel(presses, GELSIGHT_MINI_MM_PER_PX)
    single = np.array([abs(result.held_out_mm[i] / true - 1.0) for i, true in result.true_mm.items()])
    rows = [
        at_most(
            f"tactile map: held-out balls of {2 * radius:.2f} mm, median radius off by, %",
            100 * abs(error),
            5.0,
        )
        for radius, error in result.radius_error().items()
    ]
    return [
        *rows,
        informative(
            f"tactile map: single held-out presses ({len(single)}), median off by, %", 100 * np.median(single)
        ),
        informative(
            "tactile map: single held-out presses, nine in ten within, %", 100 * np.percentile(single, 90)
        ),
        informative("tactile map: single held-out presses within 5 %, share", np.mean(single < 0.05)),
        at_most("tactile map: presses not found", 67 - len(presses), 0.0),
    ]


def gelsight_presses(folder: Path) -> list[BallPress]:
    """Return the presses in a folder with background.png and catalog.csv (image, diameter(mm))."""
    reference = read_image(folder / "background.png").astype(np.float32)
    presses = []
    path = folder / "catalog.csv"
    for line, row in read_csv_rows(path, ("image", "diameter(mm)")):
        found = find_press(read_image(folder / row["image"]), reference, row["image"])
        if not isinstance(found, str):
            presses.append(BallPress(found, number_in(row, "diameter(mm)", f"{path}: line {line}") / 2.0))
    return presses


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `rig benchmark calibration`."""

    trials: int = option(200, "Hand-eye trials.", min=20)


def measure(options: CalibrationOptions, run: Run) -> Report:
    """Compare the errors of the calibrations with their limits, on simulated and real data.

    Real data are used if they are available. The exit code is 4 if a limit is missed.

    Examples:
      rig benchmark calibration

      rig benchmark calibration --trials 50 --json

    """
    cv2.setNumThreads(1)
    seed, data = run.seed, data_folder()
    run.say("measuring: two-marker angle")
    angles = angle_rows(seed)
    parts = {
        "two-marker angle": lambda: marker_limits(angles, data),
        "hand-eye": lambda: hand_eye_limits(seed, options.trials),
        "intrinsics": lambda: camera_limits(seed, data),
        "time offset": lambda: sync_limits(seed),
        "tactile map": lambda: gel_limits(data),
    }
    # one after the other: some of them measure time
    limits = [row for rows in run.each(lambda part: parts[part](), list(parts), workers=1) for row in rows]
    return Report(
        tables=(table_of("SIMULATED pictures: error of the two-marker angle", AngleRow, angles),),
        limits=limits,
        limits_of="the calibrations: simulated data unless 'real' or 'photos'",
    )


STUDY = Study(
    name="calibration",
    options=CalibrationOptions,
    measure=measure,
    cases="calibrations",
    shared=("out", "seed"),
)
