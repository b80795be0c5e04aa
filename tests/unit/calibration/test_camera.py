"""Detection of boards, fits of cameras, and rejection of bad sets of views."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.camera.intrinsics import (
    LENS_MODELS,
    CameraFit,
    assess_camera,
    calibrate_camera,
    camera_difference_px,
    held_out_error,
    projection_sigma_px,
)
from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.targets.boards import Marker, View, outside, parse_target, usable_views
from calibration.targets.sheets import sheet_svg
from calibration.verdict import Verdict
from drivers.errors import CalibrationError, InputError
from drivers.images import read_image
from drivers.types import Pose
from support.board_scenes import BOARD, CAMERA, board_pose, render_target


def exact_view(camera: CameraModel, camera_T_board: Pose, name: str, rng: np.random.Generator) -> View:  # noqa: N803
    """Return the corners of the board with the noise of a detector, without those outside the picture."""
    places = np.asarray(BOARD.board().getChessboardCorners(), np.float64)
    seen = camera.project(camera_T_board.rotation.apply(places) + np.asarray(camera_T_board.position_m))
    ids = np.flatnonzero((seen > 3.0).all(axis=1) & (seen < np.subtract(camera.size, 4.0)).all(axis=1))
    return View(name, ids, places[ids], rng.normal(seen[ids], 0.06), camera.size)


def views(
    count: int, seed: int = 0, tilt: tuple[float, float] = (5.0, 45.0), reach: float = 1.0,
    cameras: tuple[CameraModel, ...] = (CAMERA,),
) -> list[View]:  # fmt: skip
    """Return the first views that show at least a dozen corners. cameras: take them in turn."""
    rng = np.random.default_rng(seed)
    made = [
        exact_view(cameras[i % len(cameras)], board_pose(rng, tilt, reach), str(i), rng)
        for i in range(3 * count)
    ]
    return [view for view in made if len(view.ids) >= 12][:count]


@pytest.mark.heavy
@pytest.mark.parametrize(
    "spec",
    ["charuco:8x6:25:18:DICT_5X5_100", "charuco:8x6:25:18:DICT_5X5_100:legacy",
     "charuco:7x5:25:18:DICT_4X4_50", "chessboard:9x6:25", "marker:60:DICT_4X4_50:3"],
)  # fmt: skip
def test_every_target_is_drawn_and_detected_at_its_position(spec: str) -> None:
    target = parse_target(spec)
    assert target.spec == spec
    rng = np.random.default_rng(1)
    pose = Pose.from_rotation((-0.08, -0.06, 0.6), board_pose(rng, (10, 20)).rotation)
    view = target.find(render_target(target, CAMERA, pose, rng), "a")
    assert isinstance(view, View), view
    exact = CAMERA.project(pose.rotation.apply(view.board_m) + np.asarray(pose.position_m))
    assert np.abs(view.image_px - exact).mean() < (0.25 if isinstance(target, Marker) else 0.12)
    assert sheet_svg(spec).startswith("<svg")


@pytest.mark.parametrize(
    "spec",
    ["", "charuco", "charuco:8x6:18:25:DICT_5X5_100", "chessboard:2x2:25", "marker:0:DICT_4X4_50:0", "ring:4",
     "charuco:8x6:25:18:DICT_5X5_100:old", "marker:60:DICT_4X4_50:-1", "chessboard:9x6:nan"]
)  # fmt: skip
def test_invalid_target_is_rejected_with_the_valid_forms(spec: str) -> None:
    with pytest.raises(InputError, match="chessboard:9x6:25"):
        parse_target(spec)


def test_noise_picture_is_refused_with_a_reason() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    for spec in ("charuco:8x6:25:18:DICT_5X5_100", "chessboard:9x6:25", "marker:60:DICT_4X4_50:3"):
        target = parse_target(spec)
        assert isinstance(target.find(noise, "n"), str)
        with pytest.raises(InputError, match="uint8"):
            target.find(noise.astype(np.float32), "n")  # type: ignore[arg-type]


FACING = Pose((-0.10, -0.075, 0.42), (0.10, -0.08, 0.03, 0.991))


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("made", "read", "x_m", "reason"),
    [
        (BOARD.spec + ":legacy", BOARD.spec, -0.10, "ChArUco"),
        (BOARD.spec, "charuco:8x6:25:18:DICT_4X4_100", -0.10, "ChArUco"),
        ("chessboard:9x6:25", "chessboard:9x6:25", 0.12, "no chessboard"),
    ],
    ids=["legacy board read as new", "wrong dictionary", "cut by the border"],
)
def test_wrong_or_cut_board_is_refused(made: str, read: str, x_m: float, reason: str) -> None:
    pose = replace(FACING, position_m=(x_m, *FACING.position_m[1:]))
    picture = render_target(parse_target(made), CAMERA, pose, np.random.default_rng(1))
    if "chessboard" in read:  # searching it takes a second per megapixel
        picture = np.ascontiguousarray(picture[::2, ::2])
    assert reason in str(parse_target(read).find(picture, "board"))


@pytest.mark.heavy
def test_part_of_a_charuco_board_is_found() -> None:
    picture = render_target(BOARD, CAMERA, FACING, np.random.default_rng(1))
    picture[:, :560] = 120
    view = BOARD.find(picture, "board")
    assert isinstance(view, View), view
    exact = CAMERA.project(FACING.rotation.apply(view.board_m) + np.asarray(FACING.position_m))
    assert np.sqrt(((view.image_px - exact) ** 2).sum(axis=1).mean()) < 0.3


@pytest.mark.heavy
def test_views_that_do_not_determine_a_camera_are_refused_or_rated_weak() -> None:
    rng, (one,) = np.random.default_rng(1), views(1)
    refocused = replace(CAMERA, matrix=CAMERA.matrix * np.array([[1.04], [1.04], [1.0]]))
    for seen, reason in (
        (views(20, tilt=(0.0, 2.0)), "square-on"),
        ([replace(one, id=str(i), image_px=rng.normal(one.image_px, 0.06)) for i in range(15)], "same view"),
        (views(20, reach=0.1), "cover"),
        (views(20, cameras=(refocused, CAMERA)), "correlated"),
        (views(2), "at least 3 are needed"),
        ([], "at least 3 are needed"),
    ):
        try:
            said = "; ".join(assess_camera(calibrate_camera(seen)).reasons)
        except CalibrationError as error:
            said = str(error)
        assert reason in said


@pytest.fixture(scope="module")
def fitted() -> CameraFit:
    return calibrate_camera(views(20))


def test_error_on_held_out_views_uses_cameras_fitted_without_them(monkeypatch: pytest.MonkeyPatch) -> None:
    every, fitted = views(10), []

    def fit(seen: list[View], lens: object) -> Any:
        fitted.append(seen)
        return SimpleNamespace(camera=seen)

    def squared_distances(camera: list[View], view: View) -> np.ndarray:
        assert not any(one is view for one in camera)
        return np.ones(4)

    monkeypatch.setattr("calibration.camera.intrinsics.fit_camera", fit)
    monkeypatch.setattr("calibration.camera.intrinsics._squared_distances", squared_distances)
    assert held_out_error(every, LENS_MODELS[0]) == 1.0
    assert [len(seen) for seen in fitted] == [8] * 5


@pytest.mark.heavy
def test_camera_is_found_within_its_sigma(fitted: CameraFit) -> None:
    result = fitted
    found, true = result.fit.camera, CAMERA
    off = np.abs([found.matrix[0, 0] - true.matrix[0, 0], found.matrix[0, 2] - true.matrix[0, 2]])
    assert (off < 4 * result.sigma[[0, 2]]).all()
    assert result.held_out_rms_px < 0.1
    assert np.linalg.norm(camera_difference_px(CAMERA, found), axis=-1).mean() < 0.3
    assert assess_camera(result).verdict is Verdict.GOOD, assess_camera(result)


@pytest.mark.heavy
def test_camera_of_20_rendered_views_predicts_held_out_ones_within_a_tenth_of_a_pixel() -> None:
    rng, seen = np.random.default_rng(20), list[View]()
    while len(seen) < 20:
        found = BOARD.find(render_target(BOARD, CAMERA, board_pose(rng), rng), str(len(seen)))
        if isinstance(found, View) and len(found.ids) >= 12:
            seen.append(found)
    assert calibrate_camera(seen).held_out_rms_px < 0.1


@pytest.mark.heavy
def test_uncertainty_grows_in_unobserved_regions(fitted: CameraFit) -> None:
    whole, middle = projection_sigma_px(fitted), projection_sigma_px(calibrate_camera(views(15, reach=0.2)))
    assert middle.max() > 3 * whole.max()
    assert middle[0, 0] > 3 * middle[6, 8]


@pytest.mark.heavy
def test_two_bad_views_of_twenty_are_left_out_and_named() -> None:
    seen = views(20)
    for i in (4, 11):
        wrong = np.random.default_rng(i).normal(0, 8.0, seen[i].image_px.shape)
        seen[i] = replace(seen[i], image_px=seen[i].image_px + wrong)
    result = calibrate_camera(seen)
    assert {r.id for r in result.rejected} == {seen[4].id, seen[11].id}
    assert result.held_out_rms_px < 0.1


def test_invalid_views_are_left_out_with_their_reason() -> None:
    good = views(6)
    nan, one = good[0].image_px.copy(), good[1]
    nan[3, 1] = np.nan
    few = replace(one, id="few", ids=one.ids[:4], board_m=one.board_m[:4], image_px=one.image_px[:4])
    row = good[2].board_m[:, 1] == good[2].board_m[0, 1]
    line = replace(
        good[2], id="line", ids=np.arange(8), board_m=np.tile(good[2].board_m[row], (8, 1))[:8] * 1.0,
        image_px=np.column_stack([np.linspace(10, 600, 8), np.linspace(20, 300, 8)]),
    )  # fmt: skip
    odd = [replace(good[0], id="nan", image_px=nan), few, line, replace(good[3], id="size", size=(640, 480))]
    kept, rejected = usable_views([*good, *odd])
    assert len(kept) == 6
    said = {"nan": "infinite", "few": "8 are needed", "line": "line", "size": "640 x 480"}
    assert {r.id: said[r.id] in r.reason for r in rejected} == dict.fromkeys(said, True)


def photographed(spec: str, folder: Path, pattern: str, keep_all: bool = False) -> CameraFit:
    found = [parse_target(spec).find(read_image(p, grey=True), p.name) for p in sorted(folder.glob(pattern))]
    return calibrate_camera([view for view in found if isinstance(view, View)], keep_all=keep_all)


@pytest.mark.heavy
def test_real_photos_agree_with_the_published_calibrations(real_data: Path) -> None:
    """Thirteen of a chessboard with OpenCV's own recipe; four of a board, which give a weak camera."""
    many = photographed("chessboard:9x6:25:11", real_data / "opencv_chessboard", "left*.jpg", keep_all=True)
    matrix = many.fit.camera.matrix
    assert (matrix[0, 0], *matrix[:2, 2]) == pytest.approx((535.92, 342.28, 235.57), abs=1.0)
    four = photographed("charuco:5x7:40:20:DICT_6X6_250", real_data / "opencv_photos", "charuco*.jpg")
    assert assess_camera(four).verdict is Verdict.WEAK
    off = np.abs(np.diag(four.fit.camera.matrix)[:2] - (452.51, 456.77))
    assert (off < 3 * four.sigma[:2]).all()


def test_points_outside_the_stated_size_are_refused() -> None:
    seen = views(10)
    for size, swapped in (
        ((720, 1280), True),
        ((640, 480), False),
        ((1280, 500), False),
        ((900, 720), False),
    ):
        said = f"outside the picture of {size[0]} x {size[1]} px"
        with pytest.raises(CalibrationError, match=said) as refused:
            calibrate_camera([replace(view, size=size) for view in seen])
        assert ("are width and height swapped?" in str(refused.value)) is swapped
    for x, inside in ((-0.9, True), (-1.5, False), (1279.9, True), (1281.0, False)):
        places = seen[4].image_px.copy()  # corners refined at the border are inside
        places[3] = (x, 300.0)
        assert (outside(replace(seen[4], image_px=places)) is None) is inside
    seen[4] = replace(seen[4], image_px=places, id="04")
    with pytest.raises(CalibrationError, match=r"view 04: 1 point outside .* as at \(1281, 300\)"):
        calibrate_camera(seen)


def test_cameras_that_are_off_by_one_sigma_differ_in_the_uncertain_terms_only() -> None:
    """The terms are fx, fy, cx, cy and the distortion."""
    for term, place in enumerate(((0, 0), (1, 1), (0, 2), (1, 2))):
        known = replace(CAMERA, uncertainty=CameraUncertainty((term,), np.array([[4.0]])))
        (other,) = known.off_by_one_sigma()
        away = np.zeros((3, 3))
        away[place] = 2.0
        assert np.abs(other.matrix - CAMERA.matrix) == pytest.approx(away)
        assert other.distortion[:5] == pytest.approx(CAMERA.distortion[:5])
