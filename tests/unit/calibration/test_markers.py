"""Two markers: detected and followed, refused with a reason, and their rotation, in every plane."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle, PlanarAngle, assess_markers, fit_plane, in_plane_angle
from calibration.markers.tracker import FORGET_AFTER_FRAMES, MarkerTracker, Refine
from calibration.targets.aruco import (
    Refusal,
    detect_all,
    detector,
    refine_corners,
    refine_edges,
    refine_quick,
    side_lengths,
)
from calibration.verdict import Verdict
from drivers.errors import CalibrationError, InputError
from support.marker_pictures import MarkerPictures
from support.marks import heavy

Image = NDArray[Any]
NEAR = MarkerPictures(side_px=40.0, tilt_deg=15.0)
STILL = NEAR.exact_corners(0.0)


def drawn(x_m: float = 0.0, seed: int = 0) -> Image:
    return NEAR.draw(0.0, np.random.default_rng(seed), (x_m, 0.0))


def around(corners):
    """The top left and the bottom right of a marker with some paper, px."""
    return corners.min(axis=0).astype(int) - 8, corners.max(axis=0).astype(int) + 8


def hidden(gray, corners):
    """The picture with one marker covered."""
    covered, (low, high) = gray.copy(), around(corners)
    covered[low[1] : high[1], low[0] : high[0]] = 100
    return covered


def copied(gray, corners, to):
    """The picture with a copy of one marker; `to`: x, y of the copy's top left."""
    doubled, (low, high) = gray.copy(), around(corners)
    width, height = high - low
    doubled[to[1] : to[1] + height, to[0] : to[0] + width] = gray[low[1] : high[1], low[0] : high[0]]
    return doubled


@pytest.mark.heavy
def test_detected_corners_match_the_exact_projection():
    tracker = MarkerTracker((0, 1))
    for k in range(30):
        place = (0.002 * k - 0.03, 0.03 - 0.002 * k)
        found = tracker.detect(NEAR.draw(float(k), np.random.default_rng(k), place))
        assert isinstance(found, np.ndarray)
        error = found - NEAR.exact_corners(float(k), place)
        assert np.sqrt((error**2).sum(axis=-1).mean()) < 0.15
        assert side_lengths(found).mean() == pytest.approx(39.3, abs=1.0)


def test_image_without_markers_is_refused_before_and_after_detection():
    noise = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    for gray in (np.zeros((480, 640), np.uint8), np.full((480, 640), 255, np.uint8), noise):
        tracker = MarkerTracker((0, 1))
        for _ in range(2):
            assert tracker.detect(gray) is Refusal.NOT_FOUND
            assert isinstance(tracker.detect(drawn()), np.ndarray)


def test_hidden_and_copied_markers_are_refused():
    gray, (first, second) = drawn(), STILL
    beside = copied(gray, first, (60, 60))
    x, y = first.min(axis=0).astype(int) - 8
    equally_near = copied(gray, first, (x, y - 30))
    equally_near[y + 30 :] = copied(gray, first, (x, y + 30))[y + 30 :]
    for before, seen, refusal in (
        ([], hidden(gray, first), Refusal.ONE_HIDDEN),
        ([gray], hidden(gray, first), Refusal.ONE_HIDDEN),
        ([gray], hidden(gray, second), Refusal.ONE_HIDDEN),
        ([], beside, Refusal.DUPLICATE),
        ([gray], hidden(beside, first), Refusal.JUMP),
        ([gray], equally_near, Refusal.DUPLICATE),
    ):
        tracker = MarkerTracker((0, 1))
        for known in before:
            tracker.detect(known)
        assert tracker.detect(seen) is refusal


def test_markers_are_found_at_a_new_position_after_missed_frames():
    tracker = MarkerTracker((0, 1))
    tracker.detect(drawn(-0.1))
    answers = [tracker.detect(drawn(0.1)) for _ in range(FORGET_AFTER_FRAMES + 1)]
    assert isinstance(answers[0], Refusal)
    assert isinstance(answers[-1], np.ndarray)


@pytest.mark.parametrize("x_m", [-0.19, 0.16])
def test_frame_with_a_marker_cut_by_the_border_is_refused(x_m):
    tracker = MarkerTracker((0, 1))
    for k in range(9):
        found = tracker.detect(drawn(x_m * (1.0 + 0.02 * k), k))
    assert found is Refusal.ONE_HIDDEN


@pytest.mark.parametrize(("ids", "dictionary"), [((3, 3), "DICT_4X4_50"), ((0, 1), "DICT_NONE")])
def test_invalid_markers_are_refused(ids, dictionary):
    with pytest.raises(InputError):
        MarkerTracker(ids, dictionary)


def test_markers_of_a_real_photo_are_followed(real_data):
    folder, name = real_data / "opencv_photos", "singlemarkersoriginal.jpg"
    gray = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
    rows = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    gold = {row["marker_id"]: row for row in rows if row["image"] == name}
    for ids in ((40, 98), (23, 203), (62, 124)):
        tracker = MarkerTracker(ids, "DICT_6X6_250")
        first, second = tracker.detect(gray), tracker.detect(gray)
        assert isinstance(first, np.ndarray)
        assert isinstance(second, np.ndarray)
        np.testing.assert_allclose(first, second, atol=0.1)
        expected = [[[gold[i][f"{axis}{k}"] for axis in "xy"] for k in range(4)] for i in ids]
        assert np.abs(second - expected).max() < 2.0


def test_dictionary_file_is_read_or_rejected(tmp_path) -> None:
    (tmp_path / "bad.yml").write_text("%YAML:1.0\nnmarkers: 3\n")
    for name in ("none.yml", "bad.yml"):
        with pytest.raises(CalibrationError, match="dictionary"):
            detector(str(tmp_path / name))


def angle_of(pictures: MarkerPictures = NEAR) -> MarkerAngle:
    camera = CameraModel(pictures.scene.size, pictures.scene.camera_matrix, pictures.scene.distortion)
    return MarkerAngle(MarkerTracker(pictures.ids, pictures.dictionary), camera)


def at_rest(pictures: MarkerPictures, count: int) -> list[Image]:
    rng = np.random.default_rng(0)
    return [pictures.draw(0.0, rng) for _ in range(count)]


@pytest.mark.parametrize("refine", [refine_edges, refine_quick])
@pytest.mark.parametrize("side_px", [40.0, *heavy(24.0, 80.0)])
def test_edges_find_corners_better_than_windows(side_px: float, refine: Refine) -> None:
    pictures = MarkerPictures(side_px=side_px, tilt_deg=15.0)
    rng, truth = np.random.default_rng(1), pictures.exact_corners(12.0)
    by_edges, by_windows = [], []
    for _ in range(6):
        seen = pictures.draw(12.0, rng)
        quads = detect_all(detector(pictures.dictionary), seen)
        windows = [refine_corners(seen, quads[i][0][None]) for i in pictures.ids]
        corners = np.concatenate(windows)  # type: ignore[arg-type]
        edges = refine(seen, corners)
        assert not isinstance(edges, Refusal)
        by_edges.append(edges - truth)
        by_windows.append(corners - truth)
    assert np.std(by_edges) < 0.6 * np.std(by_windows)
    assert np.std(by_edges) < 0.12


@pytest.fixture(scope="module")
def angle() -> MarkerAngle:
    found = angle_of()
    found.take_reference(at_rest(NEAR, 12))
    return found


@pytest.mark.parametrize("turn_deg", [0.1, -30.0, 179.9, *heavy(0.0, -0.1, 15.0, 90.0, -179.9, 180.0)])
def test_rotation_is_measured_with_its_sign(turn_deg: float, angle: MarkerAngle) -> None:
    angle.forget()
    rng = np.random.default_rng(3)
    for answer in [angle.measure(NEAR.draw(turn_deg, rng)) for _ in range(4)]:
        assert isinstance(answer, PlanarAngle)
        assert apart_deg(answer.angle_deg, turn_deg) < min(0.15, 6 * max(answer.sigma_deg, 0.01))


def stained(seen: Image) -> Image:
    x, y = NEAR.exact_corners(5.0)[0].mean(axis=0)
    return cv2.circle(seen.copy(), (round(float(x)), round(float(y))), 12, 128, -1)


def frozen(seen: Image) -> Image:
    seen.setflags(write=False)
    return seen


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
    seen: object
    try:
        seen = angle.measure(change(NEAR.draw(5.0, np.random.default_rng(1))))
    except InputError as error:
        seen = error
    if reason:
        assert reason in str(seen)
    else:
        assert isinstance(seen, PlanarAngle), seen
        assert abs(seen.angle_deg - 5.0) < max(0.25, 4.0 * seen.sigma_deg)


def test_window_without_an_edge_is_refused() -> None:
    square = np.array([[[20.0, 20], [60, 20], [60, 60], [20, 60]]])
    noise = np.random.default_rng(1).integers(118, 122, (90, 90), dtype=np.uint8)
    assert refine_edges(noise, square) is Refusal.NO_CORNER


@pytest.mark.heavy
def test_report_at_rest_assesses_size_and_scatter() -> None:
    good = assess_markers(at_rest(NEAR, 30), angle_of())
    assert good.assessment.verdict is Verdict.GOOD, good.assessment
    small = MarkerPictures(side_px=20.0, tilt_deg=5.0)
    weak = assess_markers(at_rest(small, 30), angle_of(small))
    assert any("px wide" in reason for reason in weak.assessment.reasons)


def test_pictures_without_markers_and_too_few_are_refused() -> None:
    angle = MarkerAngle(MarkerTracker(NEAR.ids, NEAR.dictionary))
    with pytest.raises(CalibrationError, match="no reference"):
        angle.measure(at_rest(NEAR, 1)[0])
    with pytest.raises(CalibrationError, match="0 of 12"):
        angle.take_reference([np.full((480, 640), 128, np.uint8)] * 12)
    with pytest.raises(CalibrationError, match="at least 20 are needed"):
        assess_markers(at_rest(NEAR, 5), angle)


KNOWN = CameraModel.pinhole((640, 480), 700.0)
CAMERA = KNOWN.matrix
SQUARE = np.array([[-0.02, 0.02, 0], [0.02, 0.02, 0], [0.02, -0.02, 0], [-0.02, -0.02, 0]])
TOWARDS_CAMERA = Rotation.from_euler("x", 180, degrees=True)


def corners(turn_deg, tilt_deg=(0.0, 0.0), shift_m=(0.0, 0.0), out_of_plane_deg=0.0, depth_m=0.7):
    """(2, 4, 2) px: a board with y up, rotated in its plane, then tilted; its second marker is rotated."""
    askew = Rotation.from_euler("z", 4.0, degrees=True).apply(SQUARE)
    board = np.concatenate([SQUARE + np.array([-0.06, 0.0, 0.0]), askew + np.array([0.06, 0.005, 0.0])])
    lean = Rotation.from_euler("y", out_of_plane_deg, degrees=True)
    turned = lean.apply(Rotation.from_euler("z", turn_deg, degrees=True).apply(board))
    turned += np.append(shift_m, 0.0)
    seen = (Rotation.from_euler("xy", tilt_deg, degrees=True) * TOWARDS_CAMERA).apply(turned)
    seen[:, 2] += depth_m
    flat = seen @ CAMERA.T
    return (flat[:, :2] / flat[:, 2:]).reshape(2, 4, 2)


def still(tilt_deg=(0.0, 0.0), noise_px=0.0, frames=10, seed=0):
    noise = np.random.default_rng(seed).normal(0.0, noise_px, (frames, 2, 4, 2))
    return corners(0.0, tilt_deg) + noise


def apart_deg(a, b):
    return abs((a - b + 180.0) % 360.0 - 180.0)


tilts = st.tuples(st.floats(-30, 30), st.floats(-30, 30))
shifts = st.tuples(st.floats(-0.1, 0.1), st.floats(-0.08, 0.08))


@given(turn=st.floats(-180, 180), tilt=tilts, shift=shifts, known=st.booleans())
def test_exact_corners_give_the_exact_angle(turn, tilt, shift, known):
    reference = fit_plane(still(tilt), KNOWN if known else None)
    answer = in_plane_angle(corners(turn, tilt, shift), reference)
    assert apart_deg(answer.angle_deg, turn) < 1e-4
    assert -180.0 <= answer.angle_deg <= 180.0
    assert answer.in_plane
    assert answer.scale == pytest.approx(1.0, abs=1e-4)
    assert answer.residual_px < 1e-3


def test_angles_of_the_reference_have_a_mean_of_zero():
    angle, seen = MarkerAngle(MarkerTracker((0, 1), "DICT_4X4_50")), list(still((10.0, 5.0), noise_px=0.3))
    angle.set_reference(seen)
    assert np.mean([angle.turn(each).angle_deg for each in seen]) == pytest.approx(0.0, abs=1e-9)


def test_rotation_out_of_the_plane_is_refused():
    angle = MarkerAngle(MarkerTracker((0, 1), "DICT_4X4_50"), KNOWN)
    angle.set_reference(list(still()))
    assert angle.turn(corners(5.0)).angle_deg == pytest.approx(5.0, abs=1e-3)
    assert angle.turn(corners(5.0, out_of_plane_deg=35.0)) is Refusal.OUT_OF_PLANE


@pytest.mark.heavy
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("tilt", [(10.0, 11.0), *heavy(((0.0, 0.0),), ((7.5, 0.0),))])
def test_sigma_matches_the_error_under_noise(tilt, known):
    rng = np.random.default_rng(4)
    scores, errors = [], []
    for seed in range(30):
        reference = fit_plane(still(tilt, 0.1, frames=15, seed=seed), KNOWN if known else None)
        for turn in (-25.0, -8.0, 8.0, 25.0):
            noisy = corners(turn, tilt, (0.01, 0.02)) + rng.normal(0.0, 0.1, (2, 4, 2))
            answer = in_plane_angle(noisy, reference)
            errors.append(answer.angle_deg - turn)
            scores.append(errors[-1] / answer.sigma_deg)
    assert np.std(errors) < 0.06
    assert abs(np.mean(errors)) < 0.015
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


@given(turn=st.floats(-30, 30))
def test_lens_distortion_is_corrected(turn):
    bent = CameraModel(KNOWN.size, CAMERA, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))

    def distorted(points_px):
        rays = (points_px - CAMERA[:2, 2]) / 700.0
        radius = (rays**2).sum(axis=-1, keepdims=True)
        return rays * (1 - 0.2 * radius + 0.05 * radius**2) * 700.0 + CAMERA[:2, 2]

    reference = fit_plane(distorted(still((8.0, 3.0))), bent)
    answer = in_plane_angle(distorted(corners(turn, (8.0, 3.0), (0.08, 0.06))), reference)
    assert answer.angle_deg == pytest.approx(turn, abs=1e-3)


TORN = np.array([[[0.0, 0.0]], [[0.0, 6.0]]])
"""px; one marker moved relative to the other."""
WRONG = np.pad([[[3.0, 0.0], [-2.0, 3.0], [0.0, -3.0]]], ((0, 1), (0, 1), (0, 0)))
"""px; three wrong corners, more than may be occluded."""


@pytest.mark.parametrize(
    ("seen", "in_plane"),
    [
        *((corners(5.0, out_of_plane_deg=lean), False) for lean in (-20.0, 15.0, 30.0)),
        (corners(5.0, depth_m=0.68), True),
        (corners(5.0, depth_m=0.6), False),
        (corners(5.0) + TORN, False),
        (corners(5.0)[::-1], False),
        (corners(10.0) + WRONG, False),
    ],
    ids=[
        "leaning back",
        "leaning",
        "leaning more",
        "slightly nearer",
        "nearer",
        "one marker shifted",
        "swapped",
        "three wrong corners",
    ],
)
def test_corners_inconsistent_with_a_planar_turn_are_flagged(seen, in_plane):
    assert in_plane_angle(seen, fit_plane(still(), KNOWN)).in_plane is in_plane


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (still(frames=9), "needs 10 frames"),
        (np.full((10, 2, 4, 2), np.nan), "NaN or infinite"),
        (still(noise_px=3.0), "at rest"),
        (np.zeros((10, 2, 4, 2)), "plane"),
        (np.repeat(corners(0.0)[None, :1], 10, axis=0).repeat(2, axis=1) * (1.0, 2.0), "plane"),
    ],
    ids=["few", "nan", "moving", "coincident", "not square"],
)
def test_degenerate_reference_is_refused(reference, message):
    with pytest.raises(CalibrationError, match=message):
        fit_plane(reference, KNOWN)


def test_infinite_corners_are_refused():
    broken = corners(0.0)
    broken[0, 0, 0] = np.inf
    with pytest.raises(CalibrationError, match="infinite"):
        in_plane_angle(broken, fit_plane(still()))


@given(
    turn=st.floats(-180, 180),
    marker=st.integers(0, 1),
    side=st.integers(0, 3),
    pushed=st.floats(-3.0, 3.0),
    tilt=tilts,
)
def test_occluded_marker_edge_does_not_change_the_angle(turn, marker, side, pushed, tilt):
    reference = fit_plane(still(tilt), KNOWN)
    seen = corners(turn, tilt)
    ends = [side, (side + 1) % 4]
    inward = seen[marker].mean(axis=0) - seen[marker][ends].mean(axis=0)
    seen[marker][ends] += pushed * inward / np.linalg.norm(inward)
    answer = in_plane_angle(seen, reference)
    assert answer.in_plane
    assert apart_deg(answer.angle_deg, turn) < 0.06
    assert apart_deg(answer.angle_deg, turn) < 3.0 * answer.sigma_deg + 1e-3
