"""The two-marker angle beside two other ways to find corners, on the same simulated pictures."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle
from calibration.markers.planar import PlaneReference, fit_plane, wrapped_deg
from calibration.markers.tracker import MarkerTracker, Refine
from calibration.targets.aruco import Corners, Refusal, mean_side, refine_corners
from calibration.targets.edges import refine_edges
from drivers.types import Image
from fakes.studio.marker_pictures import MarkerPictures

_FRAMES, _AT_REST, _REFERENCE = 120, 40, 12
_FURTHEST_DEG = 25.0
_EDGES_BELOW_PX = 32.0


@dataclass(frozen=True, slots=True)
class AngleScene:
    """What pictures look like. jpeg: quality, None for none. hidden: share of a marker's side.

    Something lies that deep over an edge of one of the markers, in every other picture.
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

Measure = Callable[[Image], float | None]


@dataclass(frozen=True, slots=True)
class AngleScore:
    """One way in one scene. rms_deg, worst_deg, rest_deg: of the answers; rest_deg the mean at rest.

    ms: median of processor time per picture.
    """

    way: str
    scene: str
    rms_deg: float
    worst_deg: float
    rest_deg: float
    answered: float
    ms: float


def angle_scores(seed: int) -> list[AngleScore]:
    """Every way in every scene, way by way in each."""
    return [score for number, scene in enumerate(SCENES) for score in scene_scores(scene, (seed, 11, number))]


def true_camera(pictures: MarkerPictures) -> CameraModel:
    """The camera that the pictures were drawn with."""
    return CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)


def scene_scores(scene: AngleScene, seed: tuple[int, ...]) -> list[AngleScore]:
    """Every way in one scene, all on the same pictures."""
    pictures = MarkerPictures(scene.side_px, scene.tilt_deg, scene.blur_px, scene.noise_grey)
    rng = np.random.default_rng(seed)
    still = [_packed(pictures.draw(0.0, rng), scene) for _ in range(_REFERENCE)]
    share = np.clip(np.arange(_FRAMES) - _AT_REST, 0, None) / (_FRAMES - _AT_REST)
    truth = _FURTHEST_DEG * (1.0 - np.cos(np.pi * share)) / 2.0
    shown = [_draw(pictures, scene, number, float(deg), rng) for number, deg in enumerate(truth)]
    ways = {name: make(pictures, still) for name, make in WAYS.items()}
    seen: dict[str, list[tuple[float | None, float]]] = {name: [] for name in ways}
    for picture in shown:  # in turn, so that all ways meet the same machine
        for name, measure in ways.items():
            began = time.thread_time()
            seen[name].append((measure(picture), time.thread_time() - began))
    return [_score(name, scene, found, truth) for name, found in seen.items()]


def _draw(
    pictures: MarkerPictures, scene: AngleScene, number: int, turn_deg: float, rng: np.random.Generator
) -> Image:
    move = (0.005 * float(np.sin(number / 20.0)), 0.0)
    picture = pictures.draw(turn_deg, rng, move)
    if scene.hidden and number % 2:
        marker = pictures.exact_corners(turn_deg, move)[number // 2 % 2]
        _cover(picture, marker, scene.hidden, rng)
    return _packed(picture, scene)


def _cover(picture: Image, marker: NDArray[np.floating], share: float, rng: np.random.Generator) -> None:
    """Lay something of one grey over a part of one edge of a (4, 2) px marker, in place."""
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


def _packed(picture: Image, scene: AngleScene) -> Image:
    """The picture as it comes back from a JPEG of the scene's quality."""
    if scene.jpeg is None:
        return picture
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.jpeg])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def _score(
    way: str, scene: AngleScene, found: list[tuple[float | None, float]], truth: NDArray[np.floating]
) -> AngleScore:
    """found: angle, or None, and time, s, of each picture."""
    answers = [angle for angle, _ in found]
    off = np.array([np.nan if a is None else wrapped_deg(a - t) for a, t in zip(answers, truth, strict=True)])
    there = off[np.isfinite(off)]
    return AngleScore(
        way,
        str(scene),
        float(np.sqrt(np.mean(there**2))),
        float(np.abs(there).max()),
        float(np.nanmean(off[:_AT_REST])),
        len(there) / len(off),
        1e3 * float(np.median([spent_s for _, spent_s in found])),
    )


def _by_edges(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """The rig's own."""
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), true_camera(pictures))
    angle.take_reference(still)

    def measure(picture: Image) -> float | None:
        turn = angle.measure(picture)
        return None if isinstance(turn, Refusal) else turn.angle_deg

    return measure


def _by_corners(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """Corners refined in a window around each, for plane and angle."""
    return _least_squares(pictures, still, lambda picture, seen: seen, lambda picture, seen: seen)


def _by_size(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """Two rounds of edges for the plane and for markers below 32 px, corners for all others."""

    def refine(picture: Image, seen: Corners) -> Corners | Refusal:
        return refine_edges(picture, seen) if mean_side(seen) < _EDGES_BELOW_PX else seen

    return _least_squares(pictures, still, refine_edges, refine)


def _least_squares(pictures: MarkerPictures, still: list[Image], fine: Refine, quick: Refine) -> Measure:
    """All eight corners alike. fine: how those of the plane are refined further; quick: those of a turn."""
    tracker = MarkerTracker(pictures.ids, pictures.dictionary, refine=refine_corners)

    def find(picture: Image, refine: Refine) -> Corners | Refusal:
        seen = tracker.detect(picture)
        return seen if isinstance(seen, Refusal) else refine(picture, seen)

    at_rest = [seen for picture in still if not isinstance(seen := find(picture, fine), Refusal)]
    plane = fit_plane(np.array(at_rest), true_camera(pictures))
    turns = [_plain_turn(find(picture, quick), plane) for picture in still]
    zero = float(np.mean([turn for turn in turns if turn is not None]))

    def measure(picture: Image) -> float | None:
        turn = _plain_turn(find(picture, quick), plane)
        return None if turn is None else turn - zero

    return measure


def _plain_turn(seen: Corners | Refusal, plane: PlaneReference) -> float | None:
    """Degrees of the rotation nearest to all corners; None unless their rms miss is small."""
    if isinstance(seen, Refusal) or plane.camera is None:
        return None
    flat = plane.camera.undistorted(seen).reshape(1, 8, 2)
    points = cv2.perspectiveTransform(flat, plane.plane_T_image[0])[0] @ (1, 1j)
    points, template = points - points.mean(), plane.template[0]
    turn = complex((template.conj() * points).sum() / (np.abs(template) ** 2).sum())
    missed = float(np.sqrt(np.mean(np.abs(points - turn * template) ** 2))) * plane.side_px
    small = missed <= max(0.75, 0.02 * plane.side_px) and abs(abs(turn) - 1.0) <= 0.1
    return float(np.degrees(np.angle(turn))) if small else None


WAYS: dict[str, Callable[[MarkerPictures, list[Image]], Measure]] = {
    "corners": _by_corners,
    "by size": _by_size,
    "ours": _by_edges,
}
