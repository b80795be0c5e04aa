"""Error of the two-marker angle in images with varied size, tilt, noise, blur, JPEG and hidden edges; limits.

Real photographs are measured too, if they are available.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle
from calibration.markers.planar import wrapped_deg
from calibration.markers.tracker import MarkerTracker, Refine
from calibration.targets.aruco import (
    Corners,
    Refusal,
    detect_all,
    detector,
    refine_corners,
    refine_edges,
    refine_quick,
)
from drivers.images import read_image
from drivers.types import Image
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.harness import Measured, at_most, column, informative, not_there

_FRAMES, _AT_REST, _REFERENCE = 120, 40, 12
_FURTHEST_DEG = 25.0


@dataclass(frozen=True, slots=True)
class AngleScene:
    """Conditions of a scene's images.

    jpeg: quality of the compression, None for no compression. hidden: in every other image, this fraction of
    the marker's side is covered at an edge of one marker.
    """

    side_px: float = 40.0
    tilt_deg: float = 15.0
    noise_grey: float = 4.0
    blur_px: float = 1.0
    jpeg: int | None = None
    hidden: float = 0.0

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
    """The errors in one scene."""

    scene: str = column("two-marker angle, SIMULATED")
    rms_deg: float = column("rms, deg", ".4f", "of the answers")
    worst_deg: float = column("worst, deg", ".3f", "of the answers")
    rest_deg: float = column("mean at rest, deg", "+.4f")
    answered: float = column("answered", ".0%", "share of the pictures")
    ms: float = column("ms per picture", ".2f", "median of processor time")


def angle_rows(seed: int) -> list[AngleRow]:
    """Return the errors in every scene."""
    return [score_scene(scene, (seed, 11, number)) for number, scene in enumerate(SCENES)]


def score_scene(scene: AngleScene, seed: tuple[int, ...]) -> AngleRow:
    """Measure the angle in the images of one scene."""
    pictures = MarkerPictures(scene.side_px, scene.tilt_deg, scene.blur_px, scene.noise_grey)
    rng = np.random.default_rng(seed)
    camera = CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), camera)
    angle.take_reference([_compressed(pictures.draw(0.0, rng), scene) for _ in range(_REFERENCE)])
    share = np.clip(np.arange(_FRAMES) - _AT_REST, 0, None) / (_FRAMES - _AT_REST)
    truth = _FURTHEST_DEG * (1.0 - np.cos(np.pi * share)) / 2.0
    shown = [_draw(pictures, scene, number, float(deg), rng) for number, deg in enumerate(truth)]
    off, spent_s = np.full(_FRAMES, np.nan), np.empty(_FRAMES)
    for i, picture in enumerate(shown):
        began = time.thread_time()
        turn = angle.measure(picture)
        spent_s[i] = time.thread_time() - began
        if not isinstance(turn, Refusal):
            off[i] = wrapped_deg(turn.angle_deg - truth[i])
    return AngleRow(
        scene=str(scene),
        rms_deg=float(np.sqrt(np.nanmean(off**2))),
        worst_deg=float(np.nanmax(np.abs(off))),
        rest_deg=float(np.nanmean(off[:_AT_REST])),
        answered=float(np.isfinite(off).mean()),
        ms=1e3 * float(np.median(spent_s)),
    )


def _draw(
    pictures: MarkerPictures, scene: AngleScene, number: int, turn_deg: float, rng: np.random.Generator
) -> Image:
    move = (0.005 * float(np.sin(number / 20.0)), 0.0)
    picture = pictures.draw(turn_deg, rng, move)
    if scene.hidden and number % 2:
        marker = pictures.exact_corners(turn_deg, move)[number // 2 % 2]
        _cover(picture, marker, scene.hidden, rng)
    return _compressed(picture, scene)


def _cover(picture: Image, marker: NDArray[np.floating], share: float, rng: np.random.Generator) -> None:
    """Cover a part of one edge of a marker with uniform grey, in place. marker: its corners, (4, 2) px."""
    side = int(rng.integers(4))
    corner, along = marker[side], marker[(side + 1) % 4] - marker[side]
    inward = marker[(side + 2) % 4] - marker[(side + 1) % 4]
    start = rng.uniform(-0.3, 0.7)
    ends = [corner + along * start, corner + along * (start + rng.uniform(0.2, 0.6))]
    outline = [
        ends[0] - 0.35 * inward,
        ends[1] - 0.35 * inward,
        ends[1] + share * inward,
        ends[0] + share * inward,
    ]
    grey = int(rng.integers(20, 200))
    cv2.fillConvexPoly(picture, np.rint(np.array(outline) * 16).astype(np.int32), grey, cv2.LINE_AA, 4)


def _compressed(picture: Image, scene: AngleScene) -> Image:
    """Return the image after JPEG compression with the scene's quality."""
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
    """Return the limits on the usual scene of `angle_rows`, and those on real photographs."""
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
    ours, corners = (printed_turns(folder, refine) for refine in (refine_quick, refine_corners))
    return [
        *_gold(folder),
        at_most(_TURNS[0], ours, 0.2),
        informative(_TURNS[1], corners),
    ]


def printed_turns(folder: Path, refine: Refine) -> float:
    """Return the apparent rotation between pairs of parallel markers of a printed board: rms, deg.

    The plane is fitted to the board's other markers; markers are about 24 px wide, up to 4.5 sides apart.
    """
    camera = _camera(folder)
    found = [_board_markers(path, camera, refine) for path in sorted(folder.glob("charuco_img_*.jpg"))]
    turns = [turn for seen in found for turn in _turns(seen)]
    return float(np.sqrt(np.mean(np.square(turns))))


def _board_markers(path: Path, camera: CameraModel, refine: Refine) -> dict[int, Array]:
    grey = read_image(path, grey=True)
    seen = {}
    for marker_id, quads in detect_all(detector("DICT_6X6_250"), grey).items():
        fine = refine(grey, quads[0][None])
        if len(quads) == 1 and not isinstance(fine, Refusal):
            seen[marker_id] = camera.undistorted(fine)[0]
    return seen


def _turns(seen: dict[int, Array]) -> list[float]:
    printed = {
        int(i): np.asarray(corners)[:, :2]
        for i, corners in zip(np.ravel(_BOARD.getIds()), _BOARD.getObjPoints(), strict=True)
        if int(i) in seen
    }
    pairs = [
        pair
        for pair in combinations(sorted(printed), 2)
        if np.linalg.norm(printed[pair[0]].mean(axis=0) - printed[pair[1]].mean(axis=0)) < _FARTHEST_SIDES
    ]
    return [_turn(printed, seen, pair) for pair in pairs]


def _turn(printed: dict[int, Array], seen: dict[int, Array], pair: tuple[int, int]) -> float:
    others = [i for i in printed if i not in pair]
    plane_T_image, _ = cv2.findHomography(  # noqa: N806
        np.vstack([seen[i] for i in others]), np.vstack([printed[i] for i in others])
    )
    points = cv2.perspectiveTransform(np.vstack([seen[i] for i in pair])[None], plane_T_image)[0] @ (1, 1j)
    template = np.vstack([printed[i] for i in pair]) @ (1, 1j)
    turn = ((template - template.mean()).conj() * (points - points.mean())).sum()
    return float(np.degrees(np.angle(turn)))


def _camera(folder: Path) -> CameraModel:
    """Return the camera as OpenCV calibrated it from the same photographs."""
    stored = cv2.FileStorage(str(folder / "tutorial_camera_charuco.yml"), cv2.FILE_STORAGE_READ)
    matrix = stored.getNode("camera_matrix").mat()
    lens = stored.getNode("distortion_coefficients").mat().ravel()
    return CameraModel((640, 480), np.asarray(matrix, np.float64), np.asarray(lens, np.float64))


def find_corners(gray: Image, dictionary: str) -> dict[int, Corners]:
    """Return the corners, (4, 2) px, of each id that is detected exactly once in an (H, W) uint8 image.

    dictionary: OpenCV's name, or the path of a dictionary file. Corners are refined with the marker's edges.
    If the edges are not clean, the detected corners are returned, which are accurate to about half a pixel.
    Raises `InputError`.
    """
    found = {}
    for marker_id, quads in detect_all(detector(dictionary), gray).items():
        if len(quads) == 1:
            fine = refine_edges(gray, quads[0][None])
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
