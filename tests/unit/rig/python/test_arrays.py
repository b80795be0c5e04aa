"""Arrays in, arrays out: an estimator over anyone's frames, scores, calibrations."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rig
from drivers.errors import CalibrationError, EstimatorError, InputError
from drivers.types import Image
from rig.contract_checks import gel, pressed_bar
from rig.tactile.sample import SlipSample, State

SIZE = (640, 480)
FOCAL = 610.0
RNG = np.random.default_rng(3)


class Brightness:
    """Not the rig's, and in no file: as one writes it in a notebook."""

    def __init__(self, background: Image) -> None:
        self.dark = float(background.mean())

    def update(self, image: Image, time_ns: int) -> SlipSample:
        return SlipSample(time_ns, State.TRACKING, float(image.mean()) - self.dark, contact_area_px=50.0)


def bars() -> list[Image]:
    return [gel(320, 240, i) for i in range(4)] + [pressed_bar(20.0 + max(0, i - 10), i) for i in range(30)]


@pytest.mark.heavy
def test_a_bar_that_turns_is_followed() -> None:
    angles = rig.estimate(bars(), gel(320, 240), fps=30.0)
    assert angles.time_s[:3].tolist() == pytest.approx([0.0, 1 / 30, 2 / 30], abs=1e-8)
    assert np.isnan(angles.angle_deg[:4]).all()
    assert angles.states[:2] == ("no_contact", "no_contact")
    assert angles.angle_deg[-1] == pytest.approx(19.0, abs=3.0)
    assert np.isfinite(angles.sigma_deg[-1])


@pytest.mark.parametrize(
    ("frames", "why"),
    [
        ("lifts/001.mcap", "is a path: give frames as arrays"),
        ([], "there are no frames"),
        ([np.zeros((32, 24), np.uint8)], r"shape \(32, 24\): give \(H, W, 3\)"),
        (np.zeros((3, 32, 24, 3), np.float32), "give uint8 RGB"),
        ([np.zeros((32, 24, 3), np.uint8), np.zeros((24, 24, 3), np.uint8)], "use one size"),
        ([1, 2], "give uint8 RGB"),
    ],
)
def test_invalid_frames_are_an_input_error(frames: Any, why: str) -> None:
    with pytest.raises(InputError, match=why):
        rig.estimate(frames)


@pytest.mark.heavy
def test_iterator_of_frames_and_own_class_are_accepted() -> None:
    angles = rig.estimate(iter(bars()), gel(320, 240), estimator=Brightness)
    assert len(angles) == 34
    assert angles.angle_deg[round(0.15 * 60.0)] == 0.0, "its area is constant from the first frame on"
    averaged = rig.estimate(iter(bars()), gel(320, 240), estimator=Brightness, window=5)
    assert np.abs(np.diff(averaged.angle_deg)).max() < np.abs(np.diff(angles.angle_deg)).max()


def test_frames_that_are_read_into_one_array_give_the_same_angles() -> None:
    # so small that slip does not reduce them, which would copy them
    background, *frames = (np.ascontiguousarray(image[::4, ::4]) for image in (gel(320, 240), *bars()))

    def into_one_array() -> Iterator[Image]:
        buffer = np.empty_like(background)
        for frame in frames:
            buffer[:] = frame
            yield buffer

    angles = rig.estimate(into_one_array(), background)
    assert np.isfinite(angles.angle_deg[-1])
    np.testing.assert_array_equal(angles.angle_deg, rig.estimate(frames, background).angle_deg)


def test_frame_that_is_no_image_is_an_input_error_if_the_background_is_given() -> None:
    with pytest.raises(InputError, match="give uint8 RGB"):
        rig.estimate([*bars()[:2], None], gel(320, 240))  # type: ignore[list-item]


def test_error_of_own_class_names_its_line() -> None:
    class Failing(Brightness):
        def update(self, image: Image, time_ns: int) -> SlipSample:
            raise ValueError("no gradient today")

    with pytest.raises(
        rig.EstimatorError, match=r"failed on 34 frames.*test_arrays.py, line \d+: raise ValueError"
    ):
        rig.estimate(bars(), gel(320, 240), estimator=Failing)


def test_invalid_arguments_are_input_errors() -> None:
    def two() -> Iterator[Image]:
        return iter([gel(80, 60, 1), gel(80, 60, 2)])

    empty = gel(80, 60)
    for arguments, match in (
        ({"times_s": [0.0]}, "1 times for more frames"),
        ({"times_s": [0.0, 1.0, 2.0]}, "3 times for 2 frames"),
        ({"times_s": [1.0, 0.0]}, "not decreasing"),
        ({"fps": 0.0}, "fps is 0.0: give a number from 0.02 to 2000"),
        ({"window": 0}, "window is 0: give a whole number from 1 to 100"),
    ):
        with pytest.raises(InputError, match=match):
            rig.estimate(two(), empty, **arguments)  # type: ignore[arg-type]
    with pytest.raises(EstimatorError, match="has no method update"):
        rig.estimate(two(), empty, estimator=int)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="use one size"):
        rig.estimate([gel(90, 60)], empty)


def test_angles_keep_their_values_if_the_given_arrays_change() -> None:
    given = np.array([0.0, 1.0]), np.array([3.0, 4.0]), np.array([0.1, 0.2])
    angles = rig.Angles(*given)
    for values in given:
        values[:] = 7.0
    assert angles.time_s.tolist() == [0.0, 1.0]
    assert angles.angle_deg.tolist() == [3.0, 4.0]
    assert angles.sigma_deg.tolist() == [0.1, 0.2]


def test_angles_validate_their_shapes() -> None:
    angles = rig.Angles([0, 1, 2], [3.0, float("nan"), 4.0])  # type: ignore[arg-type]
    assert angles.time_s.dtype == np.float64
    assert np.isnan(angles.sigma_deg).all()
    for arguments, match in (
        (([0, 1], [1.0]), "2 times and 1 angles"),
        (([1, 0], [1.0, 2.0]), "not decrease"),
        (([0, 1], [[1.0], [2.0]]), "shape"),
        (([0, 1], ["a", "b"]), "not numbers"),
        (([0, 1], [1.0, 2.0], [0.1, 0.1], ("tracking",)), "same number of each"),
    ):
        with pytest.raises(InputError, match=match):
            rig.Angles(*arguments)


def test_score_counts_frames_that_both_have() -> None:
    times = np.arange(0.0, 1.0, 0.01)
    truth = rig.Angles(times, 10 * times)
    angles = 10 * times + 0.5
    angles[:20] = np.nan
    score = rig.score(rig.Angles(times, angles, np.full(100, 0.3)), truth)
    assert (score.mean_deg, score.std_deg, score.frames) == pytest.approx((0.5, 0.0, 80))
    assert (score.answered, score.within_two_sigma) == pytest.approx((0.8, 1.0))
    assert rig.score(rig.Angles(times, angles, np.full(100, 0.2)), truth).within_two_sigma == 0.0
    nothing = rig.score(rig.Angles(times + 100, angles), truth)
    assert (nothing.frames, np.isnan(nothing.mean_deg)) == (0, True)


def test_score_with_little_ground_truth_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    times = np.arange(0.0, 1.0, 0.01)
    angles = rig.Angles(times, 10 * times)
    rig.score(angles, rig.Angles(times[10:90], 10 * times[10:90]))
    assert not caplog.messages
    for truth in (rig.Angles(1e3 * times, 10 * times), rig.Angles(times[::10], 10 * times[::10])):
        caplog.clear()
        score = rig.score(angles, truth)
        assert caplog.messages[0].startswith(f"score: {score.frames} of 100 frames have ground truth")


def board_views(count: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Points of a board, and where a pinhole with a little noise sees them."""
    board = np.array([(x, y, 0.0) for y in np.arange(6) * 0.03 for x in np.arange(8) * 0.03]) - (0.1, 0.07, 0)
    seen = []
    while len(seen) < count:
        turn = Rotation.from_rotvec(RNG.uniform(-0.7, 0.7, 3))
        points = turn.apply(board) + RNG.uniform((-0.08, -0.06, 0.4), (0.08, 0.06, 0.6))
        pixels = FOCAL * points[:, :2] / points[:, 2:] + ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
        if (pixels > 1).all() and (pixels < np.subtract(SIZE, 2)).all():
            seen.append(pixels + RNG.normal(0, 0.05, pixels.shape))
    return [board] * count, seen


@pytest.mark.heavy
def test_a_camera_is_solved_from_points() -> None:
    found = rig.solve_camera(*board_views(20), SIZE)
    assert found.matrix[0, 0] == pytest.approx(FOCAL, abs=4 * found.sigma["fx"] + 0.3)
    assert found.size_px == SIZE
    assert found.rms_px < 0.2
    assert found.verdict in ("good", "weak")
    board, seen = board_views(2)
    with pytest.raises(CalibrationError):
        rig.solve_camera(board, seen, SIZE)
    for wrong, match in (
        (([board[0]], seen), "give the same number"),
        (([board[0][:5]], seen[:1]), r"image_px\[0\] has shape \(48, 2\): give numbers of shape \(5, 2\)"),
        (([board[0] + 0.1], seen[:1]), "z = 0"),
    ):
        with pytest.raises(InputError, match=match):
            rig.solve_camera(*wrong, SIZE)


def matrix(rotation: Rotation, place: np.ndarray) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation.as_matrix(), place
    return made


def test_a_hand_eye_is_solved_from_pairs_of_poses() -> None:
    camera = matrix(Rotation.from_euler("xyz", (110, 5, -20), degrees=True), np.array([0.4, -0.6, 0.2]))
    target = matrix(Rotation.from_euler("xyz", (3, 4, 5), degrees=True), np.array([0.01, 0.02, 0.05]))
    robot = np.array(
        [matrix(Rotation.from_rotvec(RNG.uniform(-1, 1, 3)), RNG.uniform((0.3, -0.2, 0.1), (0.6, 0.2, 0.4)))
         for _ in range(20)]
    )  # fmt: skip
    noise = [matrix(Rotation.from_rotvec(RNG.normal(0, 5e-4, 3)), RNG.normal(0, 2e-4, 3)) for _ in robot]
    seen = np.array(
        [np.linalg.inv(camera) @ pose @ target @ off for pose, off in zip(robot, noise, strict=True)]
    )
    found = rig.solve_hand_eye(robot, seen)
    assert found.verdict in ("good", "weak"), found.reasons
    assert found.matrix is not None
    assert found.sigma_m is not None
    assert np.linalg.norm(found.matrix[:3, 3] - camera[:3, 3]) < 5 * np.linalg.norm(found.sigma_m) + 2e-4
    refused = rig.solve_hand_eye(robot[:2], seen[:2])
    assert (refused.verdict, refused.matrix) == ("refused", None)
    for wrong, match in (
        ((robot, seen[:3]), "give the same number"),
        ((robot[0], seen[0]), r"give numbers of shape \(N, 4, 4\)"),
        ((robot, 2 * seen), "last row"),
        ((robot, seen, "on the table"), "give one of eye-to-hand"),
        (("robot", seen), "base_T_tcp contains str.* values, not numbers"),
    ):
        with pytest.raises(InputError, match=match):
            rig.solve_hand_eye(*wrong)
