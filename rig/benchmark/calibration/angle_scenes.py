"""The two-marker angle beside two other methods to find corners, on the same simulated pictures."""

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
from calibration.targets.aruco import Corners, Refusal, mean_side, refine_corners, refine_edges
from drivers.types import Image
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.harness import column

_FRAMES, _AT_REST, _REFERENCE = 120, 40, 12
_FURTHEST_DEG = 25.0
_EDGES_BELOW_PX = 32.0


@dataclass(frozen=True, slots=True)
class AngleScene:
    """Conditions of a scene's pictures.

    jpeg: quality of the compression, None for no compression. hidden: in every other picture, an edge of one
    marker is covered to this share of the marker's side.
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
    """One method in one scene. rms_deg, worst_deg: of the answers; rest_deg: mean at rest; answered: share.

    ms: median of processor time per picture.
    """

    rms_deg: float
    worst_deg: float
    rest_deg: float
    answered: float
    ms: float

    def __str__(self) -> str:
        answered = "" if self.answered == 1.0 else f" {self.answered:.0%}"
        figures = f"{self.rms_deg:.4f}, {self.worst_deg:.3f} ({self.rest_deg:+.4f})"
        return f"{figures}{answered}; {self.ms:.2f}"


@dataclass(frozen=True, slots=True)
class AngleRow:
    """All methods in one scene."""

    scene: str = column("two-marker angle, SIMULATED")
    corners: AngleScore = column("corners", doc="corners refined in a window around each")
    by_size: AngleScore = column("by size", doc="edges for the plane and for small markers, else corners")
    ours: AngleScore = column("ours")


def angle_rows(seed: int) -> list[AngleRow]:
    """Return every method's score in every scene."""
    return [score_scene(scene, (seed, 11, number)) for number, scene in enumerate(SCENES)]


def true_camera(pictures: MarkerPictures) -> CameraModel:
    """Return the camera that the pictures were drawn with."""
    return CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)


def score_scene(scene: AngleScene, seed: tuple[int, ...]) -> AngleRow:
    """Score every method in one scene, all on the same pictures."""
    pictures = MarkerPictures(scene.side_px, scene.tilt_deg, scene.blur_px, scene.noise_grey)
    rng = np.random.default_rng(seed)
    still = [_compressed(pictures.draw(0.0, rng), scene) for _ in range(_REFERENCE)]
    share = np.clip(np.arange(_FRAMES) - _AT_REST, 0, None) / (_FRAMES - _AT_REST)
    truth = _FURTHEST_DEG * (1.0 - np.cos(np.pi * share)) / 2.0
    shown = [_draw(pictures, scene, number, float(deg), rng) for number, deg in enumerate(truth)]
    methods = [make(pictures, still) for make in (_by_corners, _by_size, _by_edges)]
    seen: list[list[tuple[float | None, float]]] = [[] for _ in methods]
    for picture in shown:  # in turn, so that all methods meet the same load of the machine
        for measure, found in zip(methods, seen, strict=True):
            began = time.thread_time()
            found.append((measure(picture), time.thread_time() - began))
    return AngleRow(str(scene), *(_score(found, truth) for found in seen))


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
    """Cover a part of one edge of a (4, 2) px marker with one grey, in place."""
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
    """Return the picture after a JPEG compression of the scene's quality."""
    if scene.jpeg is None:
        return picture
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.jpeg])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def _score(found: list[tuple[float | None, float]], truth: NDArray[np.floating]) -> AngleScore:
    """Score the angle in degrees, or None, and the time in s of each picture."""
    pairs = zip((angle for angle, _ in found), truth, strict=True)
    off = np.array([np.nan if angle is None else wrapped_deg(angle - true) for angle, true in pairs])
    answered = off[np.isfinite(off)]
    return AngleScore(
        rms_deg=float(np.sqrt(np.mean(answered**2))),
        worst_deg=float(np.abs(answered).max()),
        rest_deg=float(np.nanmean(off[:_AT_REST])),
        answered=len(answered) / len(off),
        ms=1e3 * float(np.median([spent_s for _, spent_s in found])),
    )


def _by_edges(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """Return the rig's own method."""
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), true_camera(pictures))
    angle.take_reference(still)

    def measure(picture: Image) -> float | None:
        turn = angle.measure(picture)
        return None if isinstance(turn, Refusal) else turn.angle_deg

    return measure


def _by_corners(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """Return the method that refines corners in a window around each, for plane and angle."""
    return _least_squares(pictures, still, lambda picture, seen: seen, lambda picture, seen: seen)


def _by_size(pictures: MarkerPictures, still: list[Image]) -> Measure:
    """Return the method that uses edges for the plane and for markers below 32 px, else corners."""

    def refine(picture: Image, seen: Corners) -> Corners | Refusal:
        return refine_edges(picture, seen) if mean_side(seen) < _EDGES_BELOW_PX else seen

    return _least_squares(pictures, still, refine_edges, refine)


def _least_squares(pictures: MarkerPictures, still: list[Image], fine: Refine, quick: Refine) -> Measure:
    """Return a method that weighs all eight corners alike.

    fine: refines the corners of the plane; quick: those of an angle.
    """
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
    """Return the rotation in degrees that fits all corners best; None if its rms residual is large."""
    if isinstance(seen, Refusal) or plane.camera is None:
        return None
    flat = plane.camera.undistorted(seen).reshape(1, 8, 2)
    points = cv2.perspectiveTransform(flat, plane.plane_T_image[0])[0] @ (1, 1j)
    points, template = points - points.mean(), plane.template[0]
    turn = complex((template.conj() * points).sum() / (np.abs(template) ** 2).sum())
    missed = float(np.sqrt(np.mean(np.abs(points - turn * template) ** 2))) * plane.side_px
    small = missed <= max(0.75, 0.02 * plane.side_px) and abs(abs(turn) - 1.0) <= 0.1
    return float(np.degrees(np.angle(turn))) if small else None
