"""Detecting and tracking two markers: sub-pixel corners, and a reason for every refusal."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.markers.tracker import FORGET_AFTER_FRAMES, MarkerTracker
from calibration.targets.aruco import Refusal, side_lengths
from drivers.errors import InputError
from drivers.types import Pose
from fakes.camera.marker_scene import MarkerScene

FACING = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def seen_from(turn_deg=0.0, tilt_deg=(7.0, 5.0), x=0.0, y=0.0, z=0.7):
    tilt = Rotation.from_euler("xy", tilt_deg, degrees=True)
    return Pose.from_rotation((x, y, z), tilt * FACING * Rotation.from_euler("y", -turn_deg, degrees=True))


@pytest.fixture(scope="module")
def scene():
    return MarkerScene(focal_px=700, unit_seed=1)


def picture(scene, pose, seed=0):
    """A grey picture of a JPEG camera."""
    rgb = scene.render(pose, np.random.default_rng(seed))
    _, jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    return cv2.cvtColor(cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB), cv2.COLOR_RGB2GRAY)


def hidden(gray, corners):
    """The picture with one marker covered."""
    covered = gray.copy()
    low, high = corners.min(axis=0).astype(int) - 8, corners.max(axis=0).astype(int) + 8
    covered[low[1] : high[1], low[0] : high[0]] = 100
    return covered


def copied(gray, corners, to):
    """The picture with a copy of one marker; `to`: x, y of the copy's top left."""
    low, high = corners.min(axis=0).astype(int) - 8, corners.max(axis=0).astype(int) + 8
    doubled, (width, height) = gray.copy(), high - low
    doubled[to[1] : to[1] + height, to[0] : to[0] + width] = gray[low[1] : high[1], low[0] : high[0]]
    return doubled


def test_detected_corners_match_the_exact_projection(scene):
    tracker = MarkerTracker((0, 1))
    for k in range(30):
        pose = seen_from(turn_deg=k, x=0.002 * k - 0.03, y=0.03 - 0.002 * k)
        found = tracker.detect(picture(scene, pose, k))
        assert isinstance(found, np.ndarray)
        error = found - scene.exact_corners_px(pose)
        assert np.sqrt((error**2).sum(axis=-1).mean()) < 0.3
        assert side_lengths(found).mean() == pytest.approx(40.0, abs=1.0)


def noise_picture():
    return np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)


@pytest.mark.parametrize(
    "gray",
    [np.zeros((480, 640), np.uint8), np.full((480, 640), 255, np.uint8), noise_picture()],
    ids=["black", "saturated", "noise"],
)
def test_image_without_markers_is_refused_before_and_after_detection(scene, gray):
    tracker = MarkerTracker((0, 1))
    assert tracker.detect(gray) is Refusal.NOT_FOUND
    assert isinstance(tracker.detect(picture(scene, seen_from())), np.ndarray)
    assert tracker.detect(gray) is Refusal.NOT_FOUND
    assert isinstance(tracker.detect(picture(scene, seen_from())), np.ndarray)


def test_frame_with_a_hidden_marker_is_refused(scene):
    gray, exact = picture(scene, seen_from()), scene.exact_corners_px(seen_from())
    for first_seen in (False, True):
        tracker = MarkerTracker((0, 1))
        if first_seen:
            tracker.detect(gray)
        for marker in exact:
            assert tracker.detect(hidden(gray, marker)) is Refusal.ONE_HIDDEN


def test_copies_of_a_marker_are_refused(scene):
    gray, (first, _) = picture(scene, seen_from()), scene.exact_corners_px(seen_from())
    beside = copied(gray, first, (60, 60))
    alone = hidden(beside, first)
    x, y = first.min(axis=0).astype(int) - 8
    equally_near = copied(gray, first, (x, y - 30))
    equally_near[y + 30 :] = copied(gray, first, (x, y + 30))[y + 30 :]
    for before, seen, refusal in (
        ([], beside, Refusal.DUPLICATE),
        ([gray], alone, Refusal.JUMP),
        ([gray], equally_near, Refusal.DUPLICATE),
    ):
        tracker = MarkerTracker((0, 1))
        for known in before:
            tracker.detect(known)
        assert tracker.detect(seen) is refusal


def test_markers_are_found_at_a_new_position_after_missed_frames(scene):
    tracker = MarkerTracker((0, 1))
    tracker.detect(picture(scene, seen_from(x=-0.1)))
    moved = picture(scene, seen_from(x=0.12))
    answers = [tracker.detect(moved) for _ in range(FORGET_AFTER_FRAMES + 1)]
    assert isinstance(answers[0], Refusal)
    assert isinstance(answers[-1], np.ndarray)


@pytest.mark.parametrize("x", [-0.24, 0.24])
def test_frame_with_a_marker_cut_by_the_border_is_refused(scene, x):
    tracker = MarkerTracker((0, 1))
    for k in range(9):
        found = tracker.detect(picture(scene, seen_from(x=x * (1.0 + 0.02 * k)), k))
    assert found is Refusal.ONE_HIDDEN


@pytest.mark.parametrize(("ids", "dictionary"), [((3, 3), "DICT_4X4_50"), ((0, 1), "DICT_NONE")])
def test_invalid_markers_are_refused(ids, dictionary):
    with pytest.raises(InputError):
        MarkerTracker(ids, dictionary)


@pytest.mark.parametrize("ids", [(40, 98), (23, 203), (62, 124)])
def test_markers_of_a_real_photo_are_followed(ids, real_data):
    folder, name = real_data / "opencv_photos", "singlemarkersoriginal.jpg"
    gray = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
    rows = np.genfromtxt(folder / "gold_corners.csv", delimiter=",", dtype=None, names=True, encoding=None)
    gold = {row["marker_id"]: row for row in rows if row["image"] == name}
    tracker = MarkerTracker(ids, "DICT_6X6_250")
    first, second = tracker.detect(gray), tracker.detect(gray)
    assert isinstance(first, np.ndarray)
    assert isinstance(second, np.ndarray)
    np.testing.assert_allclose(first, second, atol=0.1)
    expected = [[[gold[i][f"{axis}{k}"] for axis in "xy"] for k in range(4)] for i in ids]
    assert np.abs(second - expected).max() < 2.0
