"""`rig benchmark calibration`: the limits of the calibrations, measured with fixed seeds.

The two-marker angle is measured in images with varied size, tilt, noise, blur, JPEG and hidden edges. Real
photographs are measured too, if they are available.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.intrinsics import (
    CameraFit,
    assess_camera,
    calibrate_camera,
    camera_difference_px,
    predict,
)
from calibration.camera.model import CameraModel
from calibration.gel.balls import Press, calibrate_gel, find_press
from calibration.hand_eye.solve import HandEyeResult, Setup, calibrate_hand_eye
from calibration.markers.angle import MarkerAngle, wrapped_deg
from calibration.markers.tracker import MarkerTracker, Refine
from calibration.targets import aruco
from calibration.targets.aruco import Refusal
from calibration.targets.boards import Chessboard, Target, View, parse_target
from calibration.time_offset import time_offset
from calibration.verdict import Verdict
from drivers.formats import number_in, read_csv_rows
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.calibration import board_scenes
from rig.benchmark.calibration.board_scenes import BOARD, board_pose, render_target
from rig.benchmark.calibration.motion_scenes import CAMERA, Truth, general_scene, wiggle_scene
from rig.benchmark.harness import Report, Run, Study, column, table_of
from rig.benchmark.measured import Measured, at_most, between, data_folder, informative, not_there
from rig.declared import option

_FRAMES, _AT_REST, _REFERENCE = 120, 40, 12
_FURTHEST_DEG = 25.0


@dataclass(frozen=True, slots=True)
class AngleScene:
    side_px: float = 40.0
    tilt_deg: float = 15.0
    noise_grey: float = 4.0
    blur_px: float = 1.0
    jpeg: int | None = None  # quality of the compression, None for no compression
    hidden: float = 0.0  # share of a marker's side that is covered at an edge, in every other image

    def __str__(self) -> str:
        parts = [f"{self.side_px:g} px, tilt {self.tilt_deg:g}, noise {self.noise_grey:g}"]
        parts += [f"blur {self.blur_px:g}"] if self.blur_px != AngleScene.blur_px else []
        parts += [f"JPEG {self.jpeg}"] if self.jpeg else []
        parts += [f"{self.hidden:.0%} hidden"] if self.hidden else []
        return ", ".join(parts)


SCENES = (
    *(AngleScene(side, tilt) for side in (24.0, 40.0, 64.0) for tilt in (0.0, 15.0, 30.0)),
    AngleScene(noise_grey=1.5),
    AngleScene(noise_grey=8.0),
    AngleScene(blur_px=0.7),
    AngleScene(blur_px=2.2),
    *(AngleScene(jpeg=quality) for quality in (95, 80, 50)),
    AngleScene(24.0, jpeg=80),
    *(AngleScene(hidden=share) for share in (0.03, 0.06, 0.12)),
)


@dataclass(frozen=True, slots=True)
class AngleRow:
    scene: str = column("two-marker angle, SIMULATED")
    rms_deg: float = column("rms, deg", ".4f", "of the answers")
    worst_deg: float = column("worst, deg", ".3f", "of the answers")
    rest_deg: float = column("mean at rest, deg", "+.4f")
    answered: float = column("answered", ".0%", "share of the pictures")
    ms: float = column("ms per picture", ".2f", "median of processor time")


def score_scene(scene: AngleScene, seed: tuple[int, ...]) -> AngleRow:
    pictures = MarkerPictures(scene.side_px, scene.tilt_deg, scene.blur_px, scene.noise_grey)
    rng = np.random.default_rng(seed)
    camera = CameraModel(pictures.scene.size, pictures.scene.camera_matrix, pictures.scene.distortion)
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), camera)
    angle.take_reference([_compressed(pictures.draw(0.0, rng), scene) for _ in range(_REFERENCE)])
    share = np.clip(np.arange(_FRAMES) - _AT_REST, 0, None) / (_FRAMES - _AT_REST)
    truth = _FURTHEST_DEG * (1.0 - np.cos(np.pi * share)) / 2.0
    shown = []
    for number, turn_deg in enumerate(truth.tolist()):
        move = (0.005 * float(np.sin(number / 20.0)), 0.0)
        picture = pictures.draw(turn_deg, rng, move)
        if scene.hidden and number % 2:
            marker = pictures.exact_corners(turn_deg, move)[number // 2 % 2]
            _cover(picture, marker, scene.hidden, rng)
        shown.append(_compressed(picture, scene))
    off, spent_s = np.full(_FRAMES, np.nan), np.empty(_FRAMES)
    for i, picture in enumerate(shown):
        began = time.thread_time()
        turn = angle.measure(picture)
        spent_s[i] = time.thread_time() - began
        if not isinstance(turn, Refusal):
            off[i] = wrapped_deg(turn.angle_deg - truth[i])
    rms_deg, worst_deg = float(np.sqrt(np.nanmean(off**2))), float(np.nanmax(np.abs(off)))
    rest_deg, answered = float(np.nanmean(off[:_AT_REST])), float(np.isfinite(off).mean())
    return AngleRow(str(scene), rms_deg, worst_deg, rest_deg, answered, 1e3 * float(np.median(spent_s)))


def _cover(picture: Image, marker: NDArray[np.floating], share: float, rng: np.random.Generator) -> None:
    """Cover a part of one edge of a marker with uniform grey, in place. marker: its corners, (4, 2) px."""
    side = int(rng.integers(4))
    corner, along = marker[side], marker[(side + 1) % 4] - marker[side]
    inward = marker[(side + 2) % 4] - marker[(side + 1) % 4]
    start = rng.uniform(-0.3, 0.7)
    a, b = corner + along * start, corner + along * (start + rng.uniform(0.2, 0.6))
    outline = [a - 0.35 * inward, b - 0.35 * inward, b + share * inward, a + share * inward]
    grey = int(rng.integers(20, 200))
    cv2.fillConvexPoly(picture, np.rint(np.array(outline) * 16).astype(np.int32), grey, cv2.LINE_AA, 4)


def _compressed(picture: Image, scene: AngleScene) -> Image:
    if scene.jpeg is None:
        return picture
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.jpeg])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


Array = NDArray[np.floating]

_FOUND = ("real photos: marker ids not found", "real photos: worst distance from a gold corner, px")
_TURNS = ("real photos: angle of two printed markers, rms, deg", "real photos: the same by corners, deg")
_BOARD = cv2.aruco.CharucoBoard((5, 7), 2.0, 1.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250))
"""Board in OpenCV's four calibration photographs; the ratio of squares to markers, 2, fits all of them."""
_FARTHEST_SIDES = 4.5


def marker_limits(rows: Sequence[AngleRow], data: Path | None) -> list[Measured]:
    """Return the limits on the default `AngleScene`, and those on real photographs."""
    usual = next(row for row in rows if row.scene == str(AngleScene()))
    answered = usual.answered == 1.0
    return [
        at_most("angle, 40 px, noise 4, tilt 15: rms, deg", usual.rms_deg if answered else None, 0.03),
        at_most("angle, the same at rest: bias, deg", abs(usual.rest_deg), 0.01),
        informative("angle: median per frame, ms of processor time", usual.ms),
        *real_marker_limits(data),
    ]


def real_marker_limits(data: Path | None) -> list[Measured]:
    """Return the limits on OpenCV's photographs, or rows without values if they are missing."""
    if data is None:
        return [not_there(name) for name in (*_FOUND, *_TURNS)]
    folder = data / "opencv_photos"
    ours, corners = (printed_turns(folder, refine) for refine in (aruco.refine_quick, aruco.refine_corners))
    return [*_gold(folder), at_most(_TURNS[0], ours, 0.2), informative(_TURNS[1], corners)]


def printed_turns(folder: Path, refine: Refine) -> float:
    """Return the apparent rotation between pairs of parallel markers of a printed board: rms, deg.

    The plane is fitted to the board's other markers; markers are about 24 px wide, up to 4.5 sides apart. The
    camera is that which OpenCV calibrated from the same photographs.
    """
    stored = cv2.FileStorage(str(folder / "tutorial_camera_charuco.yml"), cv2.FILE_STORAGE_READ)
    matrix, lens = (stored.getNode(f"{name}").mat() for name in ("camera_matrix", "distortion_coefficients"))
    camera = CameraModel((640, 480), np.asarray(matrix, np.float64), np.asarray(lens.ravel(), np.float64))
    board = zip(np.ravel(_BOARD.getIds()), _BOARD.getObjPoints(), strict=True)
    printed = {int(i): np.asarray(corners)[:, :2] for i, corners in board}
    turns = []
    for path in sorted(folder.glob("charuco_img_*.jpg")):
        grey, seen = read_image(path, grey=True), {}
        for marker_id, quads in aruco.detect_all(aruco.detector("DICT_6X6_250"), grey).items():
            fine = refine(grey, quads[0][None])
            if len(quads) == 1 and not isinstance(fine, Refusal):
                seen[marker_id] = camera.undistorted(fine)[0]
        for pair in combinations(sorted(printed.keys() & seen.keys()), 2):
            middles = [printed[i].mean(axis=0) for i in pair]
            if np.linalg.norm(middles[0] - middles[1]) < _FARTHEST_SIDES:
                turns.append(_turn(printed, seen, pair))
    return float(np.sqrt(np.mean(np.square(turns))))


def _turn(printed: dict[int, Array], seen: dict[int, Array], pair: tuple[int, int]) -> float:
    others = [i for i in printed if i in seen and i not in pair]
    plane_T_image, _ = cv2.findHomography(  # noqa: N806
        np.vstack([seen[i] for i in others]), np.vstack([printed[i] for i in others])
    )
    points = cv2.perspectiveTransform(np.vstack([seen[i] for i in pair])[None], plane_T_image)[0] @ (1, 1j)
    template = np.vstack([printed[i] for i in pair]) @ (1, 1j)
    turn = ((template - template.mean()).conj() * (points - points.mean())).sum()
    return float(np.degrees(np.angle(turn)))


def find_corners(gray: Image, dictionary: str) -> dict[int, aruco.Corners]:
    """Return the corners, (4, 2) px, of each id that is detected exactly once in an (H, W) uint8 image.

    dictionary: OpenCV's name, or the path of a dictionary file. Corners are refined with the marker's edges.
    If the edges are not clean, the detected corners are returned, which are accurate to about half a pixel.
    Raises `InputError`.
    """
    found = {}
    for marker_id, quads in aruco.detect_all(aruco.detector(dictionary), gray).items():
        if len(quads) == 1:
            fine = aruco.refine_edges(gray, quads[0][None])
            found[marker_id] = quads[0] if isinstance(fine, Refusal) else fine[0]
    return found


def _gold(folder: Path) -> list[Measured]:
    """Compare with the marker corners in OpenCV's test data, which are rounded and not refined."""
    gold = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    missing, worst = 0, 0.0
    for name in np.unique(gold["image"]):
        dictionary = str(folder / "tutorial_dict.yml") if name.startswith("gb") else "DICT_6X6_250"
        found = find_corners(read_image(folder / name, grey=True), dictionary)
        for row in gold[gold["image"] == name]:
            corners = np.array([[row[f"x{i}"], row[f"y{i}"]] for i in range(4)], np.float64)
            seen = found.get(int(row["marker_id"]))
            missing += seen is None
            if seen is not None:
                worst = max(worst, float(np.linalg.norm(seen - corners, axis=1).max()))
    return [at_most(_FOUND[0], missing, 0.0), at_most(_FOUND[1], worst, 2.0)]


_FURTHER_TRIALS = 60  # number of trials with flipped views, and with the camera on the hand
_SYNC_TRIALS, _OFFSET_S = 40, 0.0473
_PUBLISHED_CHESSBOARD = (535.92, 342.28, 235.57)
"""Focal length and centre, px, as OpenCV publishes them for its left photos."""
_PUBLISHED_CHARUCO = (452.51, 456.77)
GELSIGHT_MINI_MM_PER_PX = (0.0634, 0.0634)
"""GelSight's published scale at 320 x 240 px; its error nearly cancels in the radius of a ball."""


def hand_eye_limits(seed: int, trials: int) -> list[Measured]:
    """Calibrate hand-eye from 20 views; noise 0.2 px, and of the robot 0.1 mm and 0.02 degrees."""
    errors, held = [], []
    for truth, result in _trials((seed, 1), trials):
        pose = result.pose
        errors.append(truth.error(pose) if pose else (np.inf, np.inf))
        held.append(pose is not None and result.holds(truth.error_vector(pose)))
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
    """Calibrate a camera from 20 rendered views of a ChArUco board, and test it on 10 held-out views."""
    rng, views = np.random.default_rng((seed, 20)), list[View]()
    while len(views) < 30:
        picture = render_target(BOARD, board_scenes.CAMERA, board_pose(rng), rng)
        found = BOARD.find(picture, f"{len(views):02d}")
        if isinstance(found, View) and len(found.ids) >= 12:
            views.append(found)
    result = calibrate_camera(views[:20])
    off = np.linalg.norm(camera_difference_px(board_scenes.CAMERA, result.fit.camera), axis=-1)
    return [
        at_most("intrinsics, 20 rendered views: held-out, px", predict(result.fit.camera, views[20:]), 0.1),
        informative("intrinsics, 20 rendered views: projection error, rms px", np.sqrt((off**2).mean())),
        *real_photos(data),
    ]


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
    weak, what = assess_camera(four).verdict is Verdict.WEAK, "chessboard photos: f and c from the published"
    recipe_off = f"{what} (OpenCV's recipe: 11 px windows, all views kept), px"
    return [
        at_most(recipe_off, _from_published(recipe), 1.0),
        informative(f"{what} (our windows), px", _from_published(ours)),
        informative("chessboard photos: held-out with OpenCV's recipe, px", recipe.held_out_rms_px),
        informative("chessboard photos: held-out with our windows, px", ours.held_out_rms_px),
        at_most("four ChArUco photos: not judged weak", not weak, 0.0),
        at_most("four ChArUco photos: published f, in our sigmas", sigmas.max(), 3.0),
    ]


def _from_published(result: CameraFit) -> float:
    m = result.fit.camera.matrix
    f, cx, cy = _PUBLISHED_CHESSBOARD
    return float(np.abs([m[0, 0] - f, m[1, 1] - f, m[0, 2] - cx, m[1, 2] - cy]).max())


def _found(target: Target, photos: list[Path]) -> list[View]:
    views = [target.find(read_image(photo, grey=True), photo.name) for photo in photos]
    return [view for view in views if isinstance(view, View)]


def gel_limits(data: Path | None) -> list[Measured]:
    if data is None:
        return [not_there("tactile map: radius of held-out balls")]
    presses = gelsight_presses(data / "gelsight_ball")
    result = calibrate_gel(presses, GELSIGHT_MINI_MM_PER_PX)
    single = np.array([abs(result.held_out_mm[i] / true - 1.0) for i, true in result.true_mm.items()])
    balls, one = "tactile map: held-out balls of", "tactile map: single held-out presses"
    return [
        *(
            at_most(f"{balls} {2 * radius:.2f} mm, median radius off by, %", 100 * abs(error), 5.0)
            for radius, error in result.radius_error().items()
        ),
        informative(f"{one} ({len(single)}), median off by, %", 100 * np.median(single)),
        informative(f"{one}, nine in ten within, %", 100 * np.percentile(single, 90)),
        informative(f"{one} within 5 %, share", np.mean(single < 0.05)),
        at_most("tactile map: presses not found", 67 - len(presses), 0.0),
    ]


def gelsight_presses(folder: Path) -> list[Press]:
    """Return the presses in a folder with background.png and catalog.csv (image, diameter(mm))."""
    reference = read_image(folder / "background.png").astype(np.float32)
    presses = []
    path = folder / "catalog.csv"
    for line, row in read_csv_rows(path, ("image", "diameter(mm)")):
        radius_mm = number_in(row, "diameter(mm)", f"{path}: line {line}") / 2.0
        found = find_press(read_image(folder / row["image"]), reference, row["image"], radius_mm)
        if not isinstance(found, str):
            presses.append(found)
    return presses


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
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
    angles = [score_scene(scene, (seed, 11, number)) for number, scene in enumerate(SCENES)]
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
        tables=(table_of("SIMULATED pictures: error of the two-marker angle", angles),),
        limits=limits,
        limits_of="the calibrations: simulated data unless 'real' or 'photos'",
    )


STUDY = Study("calibration", CalibrationOptions, measure, "calibrations", ("out", "seed"))
