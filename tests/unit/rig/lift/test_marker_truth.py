"""The true angle of a lift: zero, wrist, gaps, refusals, and its interpolation."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.markers.angle import MarkerAngle
from calibration.markers.tracker import MarkerTracker
from drivers.errors import CalibrationError, InputError
from drivers.types import Pose
from fakes.camera.marker_scene import MarkerScene
from rig.lift.marker_truth import MarkerTruth

MS = 1_000_000
FRAME_NS = 33 * MS
ALONG_Y = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
CAMERA = Pose.from_rotation((0.0, -0.7, 0.3), Rotation.from_euler("xz", [6.0, 4.0], degrees=True) * ALONG_Y)
DOWN = Rotation.from_euler("x", 180, degrees=True)
STILL_FRAMES = 12


@pytest.fixture(scope="module")
def scene():
    return MarkerScene(focal_px=700, unit_seed=1)


def about_y(turn_deg):
    """Counter-clockwise for a camera along +y."""
    return Rotation.from_euler("y", -turn_deg, degrees=True)


def known(scene):
    return CameraModel(scene.size, scene.camera_matrix, scene.distortion)


class Lift:
    """Feeds a measurement with pictures of an object on a rotating wrist."""

    def __init__(self, scene, camera=None, place_sigma_rad=0.0):
        self.scene = scene
        self.truth = MarkerTruth(
            MarkerAngle(MarkerTracker((0, 1), "DICT_4X4_50"), camera), CAMERA, place_sigma_rad
        )
        self.rng = np.random.default_rng(7)
        self.time_ns = 0

    def picture(self, turn_deg, up_m=0.0):
        placed = Pose.from_rotation((0.0, 0.0, 0.28 + up_m), about_y(turn_deg))
        rgb = self.scene.render(CAMERA.inverse() @ placed, self.rng)
        _, jpeg = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
        return cv2.imdecode(jpeg, cv2.IMREAD_COLOR_RGB)

    def see(self, turn_deg, wrist_deg=0.0, up_m=0.0):
        self.show(self.picture(turn_deg, up_m), wrist_deg)

    def show(self, image, wrist_deg=0.0, wrist_tip_deg=0.0):
        tip = Rotation.from_euler("x", wrist_tip_deg, degrees=True)
        wrist = Pose.from_rotation((0.0, 0.0, 0.5), tip * about_y(wrist_deg) * DOWN)
        self.truth.update(image, self.time_ns, wrist)
        self.time_ns += FRAME_NS

    def rest(self, frames=STILL_FRAMES):
        """Frames at rest, then set the zero."""
        start = self.time_ns
        for _ in range(frames):
            self.see(0.0)
        self.truth.set_zero(start, self.time_ns)


BLANK = np.full((480, 640, 3), 90, np.uint8)


@pytest.mark.heavy
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("with_camera", [True, False])
def test_slip_is_measured_within_a_twentieth_of_a_degree(scene, sign, with_camera):
    lift = Lift(scene, known(scene) if with_camera else None)
    lift.rest()
    turned = [sign * 0.75 * k for k in range(40)]
    for k, turn in enumerate(turned):
        lift.see(turn, up_m=0.001 * k)
    series = lift.truth.series()
    error = series.angle_deg - np.array([0.0] * STILL_FRAMES + turned)
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert abs(error[:STILL_FRAMES].mean()) < 1e-9
    assert (series.sigma_deg > 0.0).all()
    assert series.sigma_deg.max() < 0.1


@pytest.mark.heavy
def test_sigma_includes_the_camera_and_its_pose(scene):
    exact = known(scene)
    unsure = replace(exact, uncertainty=CameraUncertainty((0, 1), np.full((2, 2), 15.0**2) + np.eye(2)))
    sigmas = {}
    for name, lift in {
        "exact": Lift(scene, exact), "lens": Lift(scene, unsure), "place": Lift(scene, exact, 0.01),
    }.items():  # fmt: skip
        lift.rest()
        lift.show(lift.picture(25.0), wrist_tip_deg=10.0)
        sigmas[name] = lift.truth.series().sigma_deg[-1]
    assert sigmas["lens"] > 1.2 * sigmas["exact"]
    assert sigmas["place"] == pytest.approx(np.hypot(sigmas["exact"], 0.01 * 10.0), rel=0.05)


@pytest.mark.parametrize("with_camera", [True, False])
def test_rotation_of_the_wrist_is_not_measured_as_the_object(scene, with_camera):
    lift = Lift(scene, known(scene) if with_camera else None)
    lift.rest()
    for k in range(1, 11):
        lift.see(turn_deg=0.5 * k + 1.2 * k, wrist_deg=1.2 * k)
    assert lift.truth.latest_angle_deg() == pytest.approx(5.0, abs=0.15)
    assert lift.truth.series().angle_deg[-1] == lift.truth.latest_angle_deg()


def test_live_angle_waits_for_the_zero_ends_with_the_markers_and_is_not_unwrapped_across_a_gap(scene):
    lift = Lift(scene)
    for _ in range(STILL_FRAMES):
        lift.see(0.0)
    assert lift.truth.latest_angle_deg() is None
    lift.truth.set_zero(0, lift.time_ns)
    assert lift.truth.latest_angle_deg() == pytest.approx(0.0, abs=0.05)
    for k in range(1, 14):
        lift.see(15.0 * k)
    assert lift.truth.latest_angle_deg() == pytest.approx(195.0, abs=0.2)
    lift.show(BLANK)
    assert lift.truth.latest_angle_deg() is not None
    lift.show(BLANK)
    assert lift.truth.latest_angle_deg() is None
    lift.see(210.0)
    assert lift.truth.latest_angle_deg() == pytest.approx(-150.0, abs=0.2)


def test_refused_frames_are_absent(scene):
    lift = Lift(scene)
    lift.rest()
    lift.show(BLANK)
    hidden = lift.picture(0.0)
    hidden[:, :320] = 90
    lift.show(hidden)
    lift.time_ns -= FRAME_NS
    lift.see(0.0)
    lift.see(1.0)
    assert len(lift.truth.series()) == STILL_FRAMES + 1


@pytest.mark.parametrize(
    ("seen", "blank", "later_ms", "said"),
    [
        (9, 4, 0, r"9 frames with both markers in 0.4. s .*4 x no marker found.*needs 10.*light"),
        (6, 0, 600, r"only 6 frames came .*too busy(?!.*light)"),
    ],
)
def test_zero_with_too_few_frames_lists_the_refusals(scene, seen, blank, later_ms, said):
    lift = Lift(scene)
    for _ in range(seen):
        lift.see(0.0)
    for _ in range(blank):
        lift.show(BLANK)
    with pytest.raises(CalibrationError, match=said):
        lift.truth.set_zero(0, lift.time_ns + later_ms * MS)
    with pytest.raises(CalibrationError, match="no zero"):
        lift.truth.series()


def test_zero_of_a_slow_camera_uses_earlier_frames_but_none_of_the_grasp(scene):
    lift = Lift(scene)
    for k in range(8):
        lift.see(2.0 * k)  # the fingers close
    rest_ns = lift.time_ns
    for _ in range(STILL_FRAMES):
        lift.see(16.0)
    lift.truth.set_zero(lift.time_ns - 5 * FRAME_NS, lift.time_ns, earliest_ns=rest_ns)
    whole = lift.truth.series()
    since = whole.select(whole.time_ns >= lift.truth.rests_from_ns)
    assert len(since) == 10
    assert abs(since.angle_deg.mean()) < 1e-9
    late_ns = lift.time_ns - 5 * FRAME_NS
    with pytest.raises(CalibrationError, match="5 frames"):
        lift.truth.set_zero(late_ns, lift.time_ns, earliest_ns=late_ns)


def test_moving_object_gives_no_zero(scene):
    lift = Lift(scene)
    for k in range(STILL_FRAMES):
        lift.see(1.0 * k)
    lift.truth.set_zero(0, lift.time_ns)
    with pytest.raises(CalibrationError, match="at rest"):
        lift.truth.measure_zero()


def test_series_includes_the_frames_before_the_zero(scene):
    lift = Lift(scene)
    for _ in range(3):
        lift.see(-5.0)
    zero_from = lift.time_ns
    lift.rest()
    whole = lift.truth.series()
    assert len(whole) == STILL_FRAMES + 3
    assert whole.angle_deg[0] == pytest.approx(-5.0, abs=0.1)
    assert whole.time_ns[3] == zero_from == lift.truth.rests_from_ns


def test_pictures_of_another_shape_are_refused(scene):
    for channels in (4, 1):
        with pytest.raises(InputError, match="RGB"):
            Lift(scene).truth.update(np.zeros((480, 640, channels), np.uint8), 0, CAMERA)
