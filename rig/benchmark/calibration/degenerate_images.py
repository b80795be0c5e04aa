"""Pictures that a calibration must not take at face value: of markers and of boards."""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from calibration.markers.angle import MarkerAngle
from calibration.markers.planar import PlanarAngle
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Refusal, side_lengths
from calibration.targets.boards import Charuco, parse_target
from calibration.targets.edges import refine_edges
from calibration.targets.views import View
from drivers.types import Image, Pose
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.calibration.angle_scenes import true_camera
from rig.benchmark.calibration.board_scenes import BOARD, CAMERA, render_target
from rig.benchmark.calibration.degenerate import Case, CaseAnswer, answered, refused

Rng = np.random.Generator
_PICTURES = MarkerPictures()
_ALLOWED_DEG = 0.25


def cases() -> list[Case]:
    """All cases of markers and boards in pictures."""
    return [*_markers(), *_boards()]


def _markers() -> list[Case]:
    group = "marker pictures"
    changes: list[tuple[str, Callable[[Image], Image], tuple[str, ...]]] = [
        ("no marker", lambda p: np.full_like(p, 120), ("no marker",)),
        ("one of two hidden", _one_hidden, ("one marker",)),
        ("id seen twice", _twice, ("twice", "one marker")),
        ("mirrored", lambda p: np.ascontiguousarray(p[:, ::-1]), ("marker",)),
        ("inverted", lambda p: 255 - p, ("marker",)),
        ("blurred by motion, 9 px", _smeared, ("marker", "plane", "edge")),
        ("saturated", lambda p: cv2.add(p, np.full_like(p, 70)), ("marker",)),  # type: ignore[return-value]
        ("dark", lambda p: (p // 8).astype(np.uint8), ("marker",)),
        ("half a marker beyond the border", _cut, ("marker",)),
        ("quiet paper stained", _stained, ("marker",)),
        (
            "resolution changed in mid-trial",
            lambda p: np.asarray(cv2.resize(p, (320, 240)), np.uint8),
            ("size changed",),
        ),
        ("three channels", lambda p: np.dstack([p, p, p]), ("uint8",)),
        ("16 bits", lambda p: p.astype(np.uint16), ("uint8",)),  # type: ignore[return-value]
        ("empty", lambda p: p[:0], ("size", "uint8")),
        ("non-contiguous", lambda p: np.asfortranarray(p), ()),
        ("read-only", _frozen, ()),
    ]
    listed = [Case(group, name, partial(_angle_of, change=change), why) for name, change, why in changes]
    return [
        *listed,
        Case(group, "24 px markers", partial(_whole, side_px=24.0)),
        Case(group, "110 px markers", partial(_whole, side_px=110.0)),
        Case(group, "12 px markers", partial(_whole, side_px=12.0), ("marker",)),
        Case(group, "wrong dictionary", partial(_whole, dictionary="DICT_6X6_250"), ("both are found in 0",)),
        Case(group, "ids given in the other order", partial(_whole, ids=(1, 0))),
        Case(group, "equal ids", partial(_whole, ids=(1, 1)), ("different ids",)),
        Case(group, "turn of exactly 0", partial(_turn, deg=0.0)),
        Case(group, "turn of exactly 180", partial(_turn, deg=180.0)),
        Case(group, "turn across the wrap at 180", partial(_turn, deg=-179.95)),
        Case(group, "window without an edge", _no_edge, ("corner",)),
    ]


def _boards() -> list[Case]:
    group = "board pictures"
    new, legacy, odd = BOARD.spec, BOARD.spec + ":legacy", "charuco:7x5:25:18:DICT_5X5_100"
    other = "charuco:8x6:25:18:DICT_4X4_100"
    rows: list[tuple[str, Callable[[Rng], CaseAnswer], tuple[str, ...]]] = [
        (
            "legacy ChArUco, even rows, read as new",
            partial(_board, made=legacy, read=new),
            ("legacy", "ChArUco"),
        ),
        ("legacy ChArUco read as legacy", partial(_board, made=legacy, read=legacy), ()),
        ("odd rows", partial(_board, made=odd, read=odd), ()),
        ("wrong dictionary", partial(_board, made=new, read=other), ("ChArUco",)),
        ("part of the board", _part_of_board, ()),
        ("chessboard cut by the border", _cut_chessboard, ("no chessboard",)),
        ("marker larger than its square", _bad_spec, ("not understood",)),
    ]
    return [Case(group, name, run, reasons) for name, run, reasons in rows]


def _angle_of(rng: Rng, change: Callable[[Image], Image]) -> CaseAnswer:
    angle = _at_rest(_PICTURES, rng)
    return _off_by(angle.measure(change(_PICTURES.draw(5.0, rng))), 5.0)


def _whole(
    rng: Rng, side_px: float = 40.0, dictionary: str = "DICT_4X4_50", ids: tuple[int, int] = (0, 1)
) -> CaseAnswer:
    pictures = MarkerPictures(side_px=side_px, tilt_deg=5.0)
    angle = _at_rest(pictures, rng, dictionary, ids)
    return _off_by(angle.measure(pictures.draw(5.0, rng)), 5.0)


def _turn(rng: Rng, deg: float) -> CaseAnswer:
    angle = _at_rest(_PICTURES, rng)
    angle.forget()
    return _off_by(angle.measure(_PICTURES.draw(deg, rng)), deg, sigmas=0.0)


def _at_rest(
    pictures: MarkerPictures, rng: Rng, dictionary: str = "DICT_4X4_50", ids: tuple[int, int] = (0, 1)
) -> MarkerAngle:
    """The measurement with its reference taken."""
    angle = MarkerAngle(MarkerTracker(ids, dictionary), true_camera(pictures))
    angle.take_reference([pictures.draw(0.0, rng) for _ in range(12)])
    return angle


def _off_by(seen: PlanarAngle | Refusal, truth_deg: float, sigmas: float = 4.0) -> CaseAnswer:
    """How far an angle is off, where so many of its own sigma are allowed."""
    if isinstance(seen, Refusal):
        return refused(str(seen))
    off_deg = abs((seen.angle_deg - truth_deg + 180.0) % 360.0 - 180.0)
    return answered(off_deg, max(_ALLOWED_DEG, sigmas * seen.sigma_deg))


def _middle(number: int) -> tuple[int, int]:
    x, y = _PICTURES.exact_corners(5.0)[number].mean(axis=0)
    return round(float(x)), round(float(y))


def _one_hidden(picture: Image) -> Image:
    x, y = _middle(1)
    hidden = picture.copy()
    hidden[y - 40 : y + 40, x - 40 : x + 40] = 120
    return hidden


def _twice(picture: Image) -> Image:
    """The second marker's place shows a copy of the first, and the second is gone."""
    (x0, y0), (x1, y1) = _middle(0), _middle(1)
    copied = picture.copy()
    copied[y1 - 36 : y1 + 36, x1 - 36 : x1 + 36] = picture[y0 - 36 : y0 + 36, x0 - 36 : x0 + 36]
    copied[y1 + 60 : y1 + 132, x1 - 36 : x1 + 36] = picture[y0 - 36 : y0 + 36, x0 - 36 : x0 + 36]
    return copied


def _smeared(picture: Image) -> Image:
    return np.asarray(cv2.blur(picture, (9, 1)), np.uint8)


def _cut(picture: Image) -> Image:
    x, _ = _middle(0)
    shifted = np.roll(picture, -x, axis=1)
    shifted[:, -x:] = 120
    return shifted


def _stained(picture: Image) -> Image:
    x, y = _middle(0)
    stained = picture.copy()
    cv2.circle(stained, (x, y), 12, 128, -1)
    return stained


def _frozen(picture: Image) -> Image:
    picture.setflags(write=False)
    return picture


def _no_edge(rng: Rng) -> CaseAnswer:
    square = np.array([[[20.0, 20], [60, 20], [60, 60], [20, 60]]])
    found = refine_edges(rng.integers(118, 122, (90, 90), dtype=np.uint8), square)
    return (
        refused(str(found)) if isinstance(found, Refusal) else answered(float(side_lengths(found).max()), 0.0)
    )


_FACING = Pose((-0.10, -0.075, 0.42), (0.10, -0.08, 0.03, 0.991))


def _board(rng: Rng, made: str, read: str) -> CaseAnswer:
    picture = render_target(parse_target(made), CAMERA, _FACING, rng)
    return _where(parse_target(read).find(picture, "board"))


def _part_of_board(rng: Rng) -> CaseAnswer:
    picture = render_target(BOARD, CAMERA, _FACING, rng)
    picture[:, :560] = 120
    return _where(BOARD.find(picture, "board"))


def _cut_chessboard(rng: Rng) -> CaseAnswer:
    target = parse_target("chessboard:9x6:25")
    away = Pose((0.12, _FACING.position_m[1], 0.42), _FACING.quaternion_xyzw)
    return _where(target.find(render_target(target, CAMERA, away, rng), "board"))


def _bad_spec(_: Rng) -> CaseAnswer:
    return answered(float(isinstance(parse_target("charuco:8x6:18:25:DICT_5X5_100"), Charuco)), 0.0)


def _where(view: View | str) -> CaseAnswer:
    """How far a view's corners are from the truth, rms px."""
    if isinstance(view, str):
        return refused(view)
    exact = CAMERA.project(_FACING.rotation.apply(view.board_m) + np.asarray(_FACING.position_m))
    return answered(float(np.sqrt(((view.image_px - exact) ** 2).sum(axis=1).mean())), 0.3)
