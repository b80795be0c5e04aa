"""Error of the two-marker angle in images with varied size, tilt, noise, blur, JPEG and hidden edges."""

import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle
from calibration.markers.planar import wrapped_deg
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Refusal
from drivers.types import Image
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.harness import column

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


def true_camera(pictures: MarkerPictures) -> CameraModel:
    """Return the camera with which the images were rendered."""
    return CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)


def score_scene(scene: AngleScene, seed: tuple[int, ...]) -> AngleRow:
    """Measure the angle in the images of one scene."""
    pictures = MarkerPictures(scene.side_px, scene.tilt_deg, scene.blur_px, scene.noise_grey)
    rng = np.random.default_rng(seed)
    angle = MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), true_camera(pictures))
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
