"""The angle in the plane of the markers: exact corners give the exact angle, at every tilt."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.markers.angle import MarkerAngle, fit_plane, in_plane_angle
from calibration.markers.tracker import MarkerTracker
from calibration.targets.aruco import Refusal
from drivers.errors import CalibrationError
from support.marks import long

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


def test_rotation_out_of_the_plane_is_refused():
    angle = MarkerAngle(MarkerTracker((0, 1), "DICT_4X4_50"), KNOWN)
    angle.set_reference(list(still()))
    assert angle.turn(corners(5.0)).angle_deg == pytest.approx(5.0, abs=1e-3)
    assert angle.turn(corners(5.0, out_of_plane_deg=35.0)) is Refusal.OUT_OF_PLANE


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("tilt", [(10.0, 11.0), *long(((0.0, 0.0),), ((7.5, 0.0),))])
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


@pytest.mark.parametrize("lean", [-20.0, 15.0, 30.0])
def test_motion_out_of_the_plane_is_flagged(lean):
    reference = fit_plane(still(), KNOWN)
    assert not in_plane_angle(corners(5.0, out_of_plane_deg=lean), reference).in_plane


TORN = np.array([[[0.0, 0.0]], [[0.0, 6.0]]])
"""px; one marker moved relative to the other."""
WRONG = np.pad([[[3.0, 0.0], [-2.0, 3.0], [0.0, -3.0]]], ((0, 1), (0, 1), (0, 0)))
"""px; three wrong corners, more than may be occluded."""


@pytest.mark.parametrize(
    ("seen", "in_plane"),
    [
        (corners(5.0, depth_m=0.68), True),
        (corners(5.0, depth_m=0.6), False),
        (corners(5.0) + TORN, False),
        (corners(5.0)[::-1], False),
        (corners(10.0) + WRONG, False),
    ],
    ids=["slightly nearer", "nearer", "one marker shifted", "swapped", "three wrong corners"],
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


def test_nan_corners_are_refused():
    broken = corners(0.0)
    broken[0, 0, 0] = np.inf
    with pytest.raises(CalibrationError, match="finite"):
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
