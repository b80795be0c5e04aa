"""Bad pictures, views and tables are refused with the reason, or give correct results."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.intrinsics import assess_camera, calibrate_camera
from calibration.camera.model import CameraModel
from calibration.gel.balls import Press, calibrate_gel, find_press
from calibration.gripper import Direction, OpeningSample, calibrate_opening
from calibration.markers.angle import MarkerAngle, PlanarAngle
from calibration.markers.tracker import MarkerTracker
from calibration.poses import pose_from_matrix, pose_from_quaternion, pose_from_rotation_vector
from calibration.targets.aruco import Refusal, refine_edges
from calibration.targets.boards import View, parse_target
from calibration.time_offset import TimedSignal, make_stream, time_offset
from drivers.errors import RigError
from drivers.types import Pose
from fakes.studio.calibration_scenes import MarkerPictures
from rig.benchmark.calibration.board_scenes import BOARD, CAMERA, board_pose, render_target
from rig.benchmark.calibration.motion_scenes import wiggle_scene
from support.board_views import exact_view
from support.simulated_gel import MM_PER_PX, SimulatedGel

Image = NDArray[Any]
PICTURES = MarkerPictures()
GEL = SimulatedGel(seed=7)
TURN = Rotation.from_rotvec([0.4, -0.3, 0.2])


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def refusal(answer: Callable[[], object]) -> str:
    """Return the reason of a refusal, raised or returned; "" for a result."""
    try:
        found = answer()
    except RigError as error:
        return str(error)
    return str(found) if isinstance(found, str | Refusal) else ""


def marker_angle(
    pictures: MarkerPictures, ids: tuple[int, int] = (0, 1), dictionary: str = "DICT_4X4_50"
) -> MarkerAngle:
    camera = CameraModel(pictures.size, pictures.camera_matrix, pictures.distortion)
    angle, draws = MarkerAngle(MarkerTracker(ids, dictionary), camera), rng()
    angle.take_reference([pictures.draw(0.0, draws) for _ in range(12)])
    return angle


@pytest.fixture(scope="module")
def angle() -> MarkerAngle:
    return marker_angle(PICTURES)


def stained(picture: Image) -> Image:
    x, y = PICTURES.exact_corners(5.0)[0].mean(axis=0)
    return cv2.circle(picture.copy(), (round(float(x)), round(float(y))), 12, 128, -1)


def frozen(picture: Image) -> Image:
    picture.setflags(write=False)
    return picture


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda p: p[:, ::-1].copy(), "marker"),
        (lambda p: 255 - p, "marker"),
        (lambda p: cv2.blur(p, (9, 1)), ""),
        (lambda p: cv2.add(p, np.full_like(p, 70)), ""),
        (lambda p: p // 8, ""),
        (stained, "marker"),
        (lambda p: cv2.resize(p, (320, 240)), "size changed"),
        (lambda p: np.dstack([p, p, p]), "uint8"),
        (lambda p: p.astype(np.uint16), "uint8"),
        (lambda p: p[:0], "size"),
        (np.asfortranarray, ""),
        (frozen, ""),
    ],
    ids=["mirrored", "inverted", "motion blur", "saturated", "dark", "stained", "other size", "3 channels",
         "16 bits", "empty", "not contiguous", "read-only"],
)  # fmt: skip
def test_bad_marker_image_is_refused_or_measured_correctly(
    change: Callable[[Image], Image], reason: str, angle: MarkerAngle
) -> None:
    angle.forget()
    picture = change(PICTURES.draw(5.0, rng()))
    if reason:
        assert reason in refusal(lambda: angle.measure(picture))
    else:
        assert_measured(angle.measure(picture))


def assert_measured(seen: PlanarAngle | Refusal) -> None:
    assert isinstance(seen, PlanarAngle), seen
    assert abs(seen.angle_deg - 5.0) < max(0.25, 4.0 * seen.sigma_deg)


def test_window_without_an_edge_is_refused() -> None:
    square = np.array([[[20.0, 20], [60, 20], [60, 60], [20, 60]]])
    noise = rng().integers(118, 122, (90, 90), dtype=np.uint8)
    assert "corner" in refusal(lambda: refine_edges(noise, square))


FACING = Pose((-0.10, -0.075, 0.42), (0.10, -0.08, 0.03, 0.991))


@pytest.mark.slow
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
    pose = Pose((x_m, *FACING.position_m[1:]), FACING.quaternion_xyzw)
    picture = render_target(parse_target(made), CAMERA, pose, rng())
    assert reason in refusal(lambda: parse_target(read).find(picture, "board"))


@pytest.mark.slow
def test_part_of_a_charuco_board_is_found() -> None:
    picture = render_target(BOARD, CAMERA, FACING, rng())
    picture[:, :560] = 120
    view = BOARD.find(picture, "board")
    assert isinstance(view, View), view
    exact = CAMERA.project(FACING.rotation.apply(view.board_m) + np.asarray(FACING.position_m))
    assert np.sqrt(((view.image_px - exact) ** 2).sum(axis=1).mean()) < 0.3


def seen(poses: Iterable[Pose], cameras: tuple[CameraModel, ...] = (CAMERA,), count: int = 20) -> list[View]:
    """Return the first views that show at least a dozen corners."""
    draws = rng()
    made = [exact_view(BOARD, cameras[i % len(cameras)], p, f"{i:02d}", draws) for i, p in enumerate(poses)]
    return [view for view in made if len(view.ids) >= 12][:count]


def poses(tilt_deg: tuple[float, float] = (5.0, 45.0), reach: float = 1.0) -> Iterable[Pose]:
    draws = rng()
    return (board_pose(draws, tilt_deg, reach) for _ in range(80))


@pytest.mark.slow
def test_views_that_do_not_determine_a_camera_are_refused_or_rated_weak() -> None:
    draws, nearer = rng(), CAMERA.matrix * np.array([[1.04], [1.04], [1.0]])
    (one,) = seen(poses(), count=1)
    copies = [replace(one, id=str(i), image_px=draws.normal(one.image_px, 0.06)) for i in range(15)]
    refocused = CameraModel(CAMERA.size, nearer, CAMERA.distortion)
    for views, reason in (
        (seen(poses((0.0, 2.0))), "square-on"),
        (copies, "same view"),
        (seen(poses(reach=0.1)), "cover"),
        (seen(poses(), (refocused, CAMERA)), "correlated"),
        (seen(poses(), count=2), "at least 3 are needed"),
        ([], "at least 3 are needed"),
    ):
        reasons = refusal(lambda views=views: "; ".join(assess_camera(calibrate_camera(views)).reasons))
        assert reason in reasons


def hot_pixel(frame: Image) -> Image:
    frame[100, 100] = 255
    return frame


def lined(frame: Image) -> Image:
    frame[20:300, 118:124] = np.minimum(frame[20:300, 118:124].astype(int) + 80, 255)
    return frame


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda frame: frame, "no contact"),
        (hot_pixel, "no contact"),
        (lined, "not round"),
        (lambda frame: np.minimum(frame.astype(int) + 60, 255).astype(np.uint8), "not round"),
        (lambda frame: np.full_like(frame, 90), "alike"),
        (lambda frame: frame[:100], "differ in size"),
        (lambda frame: frame[..., 0], "RGB is needed"),
        (lambda frame: frame.astype(np.float32), "RGB is needed"),
    ],
    ids=["no contact", "hot pixel", "line", "brighter", "constant", "other size", "grey", "float"],
)
def test_picture_without_a_round_press_is_refused(change: Callable[[Image], Image], reason: str) -> None:
    picture = change(GEL.frame(rng()))
    assert reason in refusal(lambda: find_press(picture, GEL.reference, "press", 4.0))


def test_three_presses_are_too_few_for_a_colour_map() -> None:
    found = [find_press(p.image, GEL.reference, p.name, p.radius_mm) for p in GEL.presses(3)]
    presses = [press for press in found if isinstance(press, Press)]
    assert "8 are the least" in refusal(lambda: calibrate_gel(presses, MM_PER_PX))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t, v: (t + 3 * 3600 * 10**9 * (np.arange(len(t)) > len(t) // 2), v), "jumps"),
        (lambda t, v: ((t / 1e9).astype(np.float32), v), "integer ns"),
        (lambda t, v: (t[:5], v[:5]), "at least 20 are needed"),
        (lambda t, v: (t[:0], v[:0]), "at least 20 are needed"),
    ],
    ids=["clock jumps by hours", "float32 seconds", "five samples", "empty"],
)
def test_unusable_stream_is_refused(change: Callable[..., tuple[Any, Any]], reason: str) -> None:
    _, camera = wiggle_scene(rng())
    assert reason in refusal(lambda: make_stream(*change(camera.time_ns, camera.values), "camera"))


def test_streams_without_overlap_are_refused() -> None:
    robot, camera = wiggle_scene(rng())
    later = TimedSignal(camera.time_ns + 10**12, camera.values)
    assert "overlap" in "; ".join(time_offset(robot, later).assessment.reasons)


@pytest.mark.parametrize(
    ("counts", "opening_m"), [(300.0, 0.05), (100.0, 50.0), (100.0, float("nan"))],
    ids=["counts above 255", "opening in mm", "NaN"],
)  # fmt: skip
def test_bad_opening_is_left_out_and_named(counts: float, opening_m: float) -> None:
    samples = [OpeningSample("bad", counts, opening_m, Direction.CLOSING)]
    samples += [
        OpeningSample(f"{way} {at}", at, 0.12 - 0.0005 * at, way)
        for way in Direction
        for at in range(10, 210, 20)
    ]
    found = calibrate_opening(samples)
    assert [rejected.id for rejected in found.rejected] == ["bad"]
    table = found.tables[Direction.CLOSING]
    assert np.interp(100.0, table.counts, table.opening_m) == pytest.approx(0.07, abs=1e-6)


def matrix_with(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = np.eye(4)
    whole[:3, :3] = turn
    return whole


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: pose_from_matrix(matrix_with(1.01 * TURN.as_matrix()), "pose"), "not orthonormal"),
        (lambda: pose_from_matrix(matrix_with(np.diag([1.0, 1.0, -1.0])), "pose"), "reflection"),
        (lambda: pose_from_rotation_vector((0, 0, 0), (90.0, 0, 0), "pose"), "degrees"),
        (lambda: pose_from_quaternion((0, 0, 0), 1.5 * TURN.as_quat(), "pose"), "length"),
        (lambda: pose_from_quaternion((0, 0, 0), np.zeros(4), "pose"), "length"),
    ],
    ids=["scaled", "reflected", "in degrees", "not normalised", "zeros"],
)
def test_invalid_rotation_is_rejected(make: Callable[[], Pose], reason: str) -> None:
    assert reason in refusal(make)


@pytest.mark.parametrize("angle_rad", [0.0, np.pi - 1e-9, np.pi, np.pi + TURN.magnitude()])
def test_rotation_vector_of_any_length_is_the_same_rotation(angle_rad: float) -> None:
    rotvec = angle_rad * TURN.as_rotvec() / TURN.magnitude()
    pose = pose_from_rotation_vector((0, 0, 0), rotvec, "pose")
    matrix = pose_from_matrix(matrix_with(Rotation.from_rotvec(rotvec).as_matrix()), "pose")
    for made in (pose, matrix):
        assert (made.rotation.inv() * Rotation.from_rotvec(rotvec)).magnitude() < 1e-7
