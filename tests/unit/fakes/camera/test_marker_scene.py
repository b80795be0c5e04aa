"""The simulated camera image agrees with its ground truth."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from fakes.camera.marker_scene import MarkerScene

FACING = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def seen_from(turn_deg=0.0, tilt_deg=(0.0, 0.0), x=0.0, y=0.0, z=0.7):
    """`camera_T_object`: turned counter-clockwise as seen, then tilted about camera x and y."""
    tilt = Rotation.from_euler("xy", tilt_deg, degrees=True)
    return Pose.from_rotation((x, y, z), tilt * FACING * Rotation.from_euler("y", -turn_deg, degrees=True))


def grey(picture):
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


def rng():
    return np.random.default_rng(3)


def test_positive_turn_is_counter_clockwise_as_seen():
    corners = MarkerScene(focal_px=700, unit_seed=1).exact_corners_px(seen_from(turn_deg=30.0))
    dx, dy = corners[1].mean(axis=0) - corners[0].mean(axis=0)
    assert -np.degrees(np.arctan2(dy, dx)) == pytest.approx(30.0)


def test_exact_corners_agree_with_opencv_projection():
    scene = MarkerScene(focal_px=650, unit_seed=1, k1=-0.2)
    pose = seen_from(20.0, (12.0, -7.0), 0.03, -0.05, 0.8)
    half = scene.marker_side_m / 2
    square = np.array([[-half, 0, half], [half, 0, half], [half, 0, -half], [-half, 0, -half]])
    points = np.concatenate([square + np.array([x, 0, z]) for x, z in scene.marker_centres_m])
    projected, _ = cv2.projectPoints(
        points,
        pose.rotation.as_rotvec(),
        np.array(pose.position_m),
        scene.camera_matrix,
        scene.distortion,
    )
    np.testing.assert_allclose(scene.exact_corners_px(pose).reshape(8, 2), projected.reshape(8, 2), atol=1e-9)


def edge_errors_px(picture, corners):
    """How far drawn outer edges lie from where they should, along the outward normal."""
    offsets = np.linspace(-3.0, 3.0, 121)
    errors = []
    for marker in corners:
        for a, b in zip(marker, np.roll(marker, -1, axis=0), strict=True):
            along = (b - a) / np.hypot(*(b - a))
            outward = np.array([along[1], -along[0]])
            for share in (0.3, 0.4, 0.5, 0.6, 0.7):
                where = a + share * (b - a) + offsets[:, None] * outward
                profile = cv2.remap(picture, where[None].astype(np.float32), None, cv2.INTER_LINEAR)[0]
                step = (profile.astype(float) - profile[0]) / (float(profile[-1]) - float(profile[0]))
                errors.append(offsets[-1] - np.trapezoid(step, offsets))
    return np.array(errors)


@pytest.mark.heavy
@pytest.mark.parametrize("k1", [0.0, -0.2])
def test_drawn_edges_match_the_ground_truth(k1):
    scene = MarkerScene(focal_px=700, unit_seed=1, noise_grey=0.0, k1=k1)
    draw = np.random.default_rng(5)
    errors = []
    for _ in range(12):
        x, y = draw.uniform(-0.06, 0.06, 2)
        pose = seen_from(draw.uniform(-40, 40), tuple(draw.uniform(-15, 15, 2)), x, y)
        errors.append(edge_errors_px(grey(scene.render(pose, rng())), scene.exact_corners_px(pose)))
    pooled = np.concatenate(errors)
    assert abs(pooled.mean()) < 0.005
    assert pooled.std() < 0.02
