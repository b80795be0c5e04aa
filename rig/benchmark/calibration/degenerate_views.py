"""Sets of board views that a camera calibration must not take at face value."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from calibration.camera.checks import assess_camera, camera_difference_px, projection_sigma_px
from calibration.camera.intrinsics import calibrate_camera
from calibration.camera.model import CameraModel
from calibration.targets.boards import View
from drivers.types import Pose
from rig.benchmark.calibration.board_scenes import BOARD, CAMERA, board_pose, exact_view
from rig.benchmark.calibration.degenerate import Case, CaseAnswer, answered, refused

Rng = np.random.Generator


def cases() -> list[Case]:
    """All cases of intrinsics."""
    group = "intrinsics"
    return [
        Case(group, "square-on views only", partial(_solved, tilt=(0.0, 2.0)), ("square-on",), draws=3),
        Case(group, "copies of one view", _copies, ("same view",), draws=3),
        Case(group, "centre only", partial(_solved, reach=0.1), ("cover",), draws=3),
        Case(group, "one distance", _one_distance, (), draws=3),
        Case(group, "2 views", partial(_solved, count=2), ("3 are the least",), draws=3),
        Case(group, "no views", partial(_solved, count=0), ("3 are the least",)),
        Case(group, "wrong square size", _wrong_square, (), draws=3),
        Case(group, "mixed resolutions", _mixed, (), draws=3),
        Case(group, "2 bad views of 20", _two_bad, (), draws=3),
        Case(group, "focus moved between views", _refocused, ("alike",), draws=3),
        Case(group, "NaN in a corner", _nan_corner, (), draws=3),
        Case(group, "collinear corners", _collinear, ("one line",), draws=3),
    ]


def _one_distance(rng: Rng) -> CaseAnswer:
    made = []
    for i in range(40):
        pose = board_pose(rng)
        there = (*pose.position_m[:2], 0.4)
        made.append(exact_view(BOARD, CAMERA, Pose.from_rotation(there, pose.rotation), f"{i:02d}", rng))
    return _camera(_large(made))


def _large(made: Iterable[View], count: int = 20) -> list[View]:
    """The first views that show a dozen corners at least."""
    return [view for view in made if len(view.ids) >= 12][:count]


def _seen(
    rng: Rng, count: int = 20, tilt: tuple[float, float] = (5.0, 45.0), reach: float = 1.0
) -> list[View]:
    made = (
        exact_view(BOARD, CAMERA, board_pose(rng, tilt, reach), f"{i:02d}", rng) for i in range(4 * count)
    )
    return _large(made, count)


def _camera(views: list[View], doubted: bool = False) -> CaseAnswer:
    """Rms projection error against the true camera, allowed three of its own sigma.

    doubted: a case that a doubt must name.
    """
    result = calibrate_camera(views)
    assessment = assess_camera(result)
    if assessment.refusals or (doubted and assessment.doubts):
        return refused(*assessment.reasons)
    off = np.sqrt((camera_difference_px(CAMERA, result.fit.camera) ** 2).sum(axis=-1).mean())
    said = 3.0 * float(np.sqrt((projection_sigma_px(result) ** 2).mean()))
    return answered(float(off), max(0.3, said))


def _solved(
    rng: Rng, count: int = 20, tilt: tuple[float, float] = (5.0, 45.0), reach: float = 1.0
) -> CaseAnswer:
    return _camera(_seen(rng, count, tilt, reach), doubted=reach < 1.0)


def _copies(rng: Rng) -> CaseAnswer:
    one = _seen(rng, 1)[0]
    return _camera([replace(one, id=str(i), image_px=rng.normal(one.image_px, 0.06)) for i in range(15)])


def _wrong_square(rng: Rng) -> CaseAnswer:
    """The scale of a board is the scale of its distance: a camera does not depend on it."""
    return _camera([replace(view, board_m=view.board_m * 1.1) for view in _seen(rng)])


def _mixed(rng: Rng) -> CaseAnswer:
    small = [replace(v, id=f"small {v.id}", image_px=v.image_px / 2, size=(640, 360)) for v in _seen(rng, 4)]
    return _camera([*_seen(rng), *small])


def _two_bad(rng: Rng) -> CaseAnswer:
    views = _seen(rng)
    for i in (4, 11):
        views[i] = replace(views[i], image_px=rng.normal(views[i].image_px, 8.0))
    return _camera(views)


def _refocused(rng: Rng) -> CaseAnswer:
    nearer = CameraModel(CAMERA.size, CAMERA.matrix * np.array([[1.04], [1.04], [1.0]]), CAMERA.distortion)
    made = [
        exact_view(BOARD, CAMERA if i % 2 else nearer, board_pose(rng), f"{i:02d}", rng) for i in range(40)
    ]
    return _camera(_large(made), doubted=True)


def _nan_corner(rng: Rng) -> CaseAnswer:
    views = _seen(rng, 21)
    pixels = views[2].image_px.copy()
    pixels[0, 0] = np.nan
    return _camera([*views[:2], replace(views[2], image_px=pixels), *views[3:]])


def _collinear(rng: Rng) -> CaseAnswer:
    lines = []
    for view in _seen(rng, 10):
        row = np.flatnonzero(np.isclose(view.board_m[:, 1], view.board_m[0, 1]))
        again = np.resize(row, 8)
        lines.append(
            replace(view, ids=view.ids[again], board_m=view.board_m[again], image_px=view.image_px[again])
        )
    return _camera(lines)
