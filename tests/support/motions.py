"""Motions with ground truth: views of a target, pairs of poses, a tool tip about one point, two clocks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.solve import HandEyeSample, Setup
from calibration.targets.boards import Marker, View
from calibration.time_offset import TimedSignal, make_stream
from drivers.types import Pose

Array = NDArray[np.floating]

CAMERA = CameraModel(
    (1280, 720), np.array([[980.0, 0.0, 639.5], [0.0, 980.0, 359.5], [0.0, 0.0, 1.0]]), np.zeros(5)
)
MARKER = Marker(0.060, "DICT_4X4_50", 0)
_BORDER_PX = 5.0


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations per coordinate: corners (px), robot positions (m) and orientations (deg)."""

    corner_px: float = 0.2
    robot_m: float = 1e-4
    robot_deg: float = 0.02


NOISE = Noise()


@dataclass(frozen=True, slots=True)
class Truth:
    """The true transforms X and Z of A Z = X B."""

    setup: Setup
    x: Pose
    z: Pose

    def error(self, found: Pose) -> tuple[float, float]:
        """Return position error in mm and rotation error in degrees of an estimate."""
        vector = self.error_vector(found)
        return 1e3 * float(np.linalg.norm(vector[3:])), float(np.degrees(np.linalg.norm(vector[:3])))

    def error_vector(self, found: Pose) -> Array:
        """Return the error as (6,): rotation vector in the axes of X (rad), and translation (m)."""
        turn = (self.x.rotation.inv() * found.rotation).as_rotvec()
        return np.concatenate([turn, np.subtract(found.position_m, self.x.position_m)])


def draw_truth(rng: np.random.Generator, setup: Setup = Setup.EYE_TO_HAND) -> Truth:
    """Draw a camera about 0.8 m from the workspace (or on the tool), and a target at a random angle."""
    look = Rotation.from_euler("x", -100, degrees=True) * Rotation.from_rotvec(rng.normal(0, 0.2, 3))
    if setup is Setup.EYE_TO_HAND:
        x = Pose.from_rotation(rng.normal((0.5, -0.7, 0.3), 0.05), look)
    else:
        x = Pose.from_rotation(
            rng.normal((0.0, 0.06, 0.05), 0.01), Rotation.from_rotvec(rng.normal(0, 0.3, 3))
        )
    return Truth(
        setup, x, Pose.from_rotation(rng.normal(0, 0.03, 3), Rotation.from_rotvec(rng.normal(0, 1, 3)))
    )


def general_scene(
    rng: np.random.Generator, count: int = 20, setup: Setup = Setup.EYE_TO_HAND, flipped: int = 0,
    noise: Noise = NOISE,
) -> tuple[Truth, list[HandEyeSample]]:  # fmt: skip
    """Draw views from 0.5 to 0.9 m, turned by 10 to 45 degrees; the first `flipped` by another 20 to 40."""
    truth = draw_truth(rng, setup)
    samples: list[HandEyeSample] = []
    while len(samples) < count:
        place = Pose.from_rotation(rng.uniform((-0.15, -0.12, 0.5), (0.15, 0.12, 0.9)), Rotation.identity())
        camera_T_target = _turned(place, rng, 10.0, 45.0)  # noqa: N806
        seen = _seen(camera_T_target)
        if (seen < _BORDER_PX).any() or (seen > np.subtract(CAMERA.size, 1 + _BORDER_PX)).any():
            continue
        wrong = len(samples) < flipped
        shown = _turned(camera_T_target, rng, 20.0, 40.0) if wrong else camera_T_target
        samples.append(noisy_sample(len(samples), truth, camera_T_target, shown, rng, noise))
    return truth, samples


def noisy_sample(
    number: int, truth: Truth, true_view: Pose, shown: Pose, rng: np.random.Generator, noise: Noise
) -> HandEyeSample:
    """Return the sample of a view: the robot's pose at `true_view`, and an image of `shown`, with noise."""
    robot = truth.x @ true_view @ truth.z.inverse()
    if truth.setup is Setup.EYE_IN_HAND:
        robot = robot.inverse()
    said = Pose.from_rotation(
        rng.normal(robot.position_m, noise.robot_m),
        robot.rotation * Rotation.from_rotvec(rng.normal(0, np.radians(noise.robot_deg), 3)),
    )
    name, places_m = f"{number:02d}", MARKER.places_m
    pixels = rng.normal(_seen(shown), noise.corner_px)
    return HandEyeSample(name, said, View(name, np.arange(len(places_m)), places_m, pixels, CAMERA.size))


def _turned(pose: Pose, rng: np.random.Generator, low_deg: float, high_deg: float) -> Pose:
    axis = rng.normal(0, 1, 3)
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(low_deg, high_deg)))
    return Pose.from_rotation(pose.position_m, pose.rotation * turn)


def _seen(camera_T_target: Pose) -> Array:  # noqa: N803
    at = camera_T_target.rotation.apply(MARKER.places_m) + np.asarray(camera_T_target.position_m)
    return CAMERA.project(at)


def wiggle_scene(
    rng: np.random.Generator, motion: str = "chirp", offset_s: float = 0.0473, seconds: float = 20.0,
    drift_ppm: float = 0.0,
) -> tuple[TimedSignal, TimedSignal]:  # fmt: skip
    """Draw a robot's angle at 500 Hz, and a camera's at 30 Hz: 0.2 deg noise, 2 ms jitter, 5 % dropped.

    motion: chirp (8 degrees, 0.4 to 1.2 Hz); static; constant (without noise); sine (4 Hz, which repeats
    within the search range). The camera's clock is `offset_s` behind in the middle, and drifts by
    `drift_ppm`.
    """
    robot_s = np.arange(0.0, seconds, 0.002)
    camera_s = np.arange(0.0, seconds, 1 / 30) + rng.uniform(-0.002, 0.002, round(np.ceil(seconds * 30)))
    camera_s = np.sort(camera_s[rng.uniform(size=len(camera_s)) > 0.05])
    noise = 0.0 if motion == "constant" else 0.2
    robot = _angle_deg(robot_s, motion, seconds) + rng.normal(0.0, noise / 20, len(robot_s))
    camera = 0.97 * _angle_deg(camera_s, motion, seconds) + 3.0 + rng.normal(0.0, noise, len(camera_s))
    own_s = camera_s - offset_s - 1e-6 * drift_ppm * (camera_s - seconds / 2)
    epoch = 1_700_000_000_000_000_000
    return (
        make_stream(epoch + np.rint(robot_s * 1e9).astype(np.int64), robot, "robot"),
        make_stream(epoch + np.rint(own_s * 1e9).astype(np.int64), camera, "camera"),
    )


def _angle_deg(time_s: Array, motion: str, seconds: float) -> Array:
    if motion in ("static", "constant"):
        return np.zeros_like(time_s)
    if motion == "sine":
        return 8.0 * np.sin(2 * np.pi * 4.0 * time_s)
    period = min(seconds, 10.0)
    within = np.mod(time_s, period)
    phase = 2 * np.pi * (0.4 * within + 0.4 * within**2 / period)
    return 8.0 * np.sin(phase)


def motion_scene(
    rng: np.random.Generator, turns: Sequence[Array] | Array, moves: Array
) -> tuple[Truth, list[HandEyeSample]]:
    """Return views with given rotations (rotation vectors) and translations (m), from a pose 0.7 m ahead."""
    truth = draw_truth(rng)
    first = Pose.from_rotation((0.0, 0.0, 0.7), Rotation.from_rotvec([0.3, 0.2, 0.1]))
    samples = []
    for i, (turn, move) in enumerate(zip(turns, moves, strict=True)):
        place = np.add(first.position_m, move)
        view = Pose.from_rotation(place, Rotation.from_rotvec(turn) * first.rotation)
        samples.append(noisy_sample(i, truth, view, view, rng, NOISE))
    return truth, samples


def pivot_scene(
    rng: np.random.Generator, count: int, turns: Rotation | None = None
) -> tuple[Array, list[tuple[str, Pose]]]:
    """Draw the tip's position in the tool frame, and poses with the tip in one hole (sigma 0.1 mm)."""
    tip, hole = np.array([0.004, -0.002, 0.283]), np.array([0.45, 0.05, 0.02])
    turns = turns or Rotation.from_rotvec(rng.normal(0.0, 0.45, (count, 3)))
    down = Rotation.from_euler("x", 180, degrees=True)
    poses = []
    for i in range(count):
        turn = down * turns[i]
        place = rng.normal(hole - turn.apply(tip), 1e-4)
        poses.append((f"{i:02d}", Pose.from_rotation(place, turn)))
    return tip, poses


ROBOT = (np.radians(0.03), 3e-4)
TARGET = (np.radians(0.2), np.radians(0.05), 1e-3, 4e-3)
"""Noise of tilt, rotation about the axis, lateral position, and depth."""


def disturbed(pose: Pose, rng: np.random.Generator, turns: Array, moves: Array) -> Pose:
    """Perturb a pose in its parent's axes by normal steps of these sigmas."""
    turn = Rotation.from_rotvec(rng.normal(0, 1, 3) * turns)
    return Pose.from_rotation(pose.position_m + rng.normal(0, 1, 3) * moves, turn * pose.rotation)


def pose_pairs(
    seed: int, count: int = 20, setup: Setup = Setup.EYE_TO_HAND, noise: float = 1.0, size: float = 1.0
) -> tuple[Truth, list[PoseSample]]:
    """Draw pairs with `noise` times the noise above; distances to the target appear `size` times as long."""
    rng = np.random.default_rng((5, seed))
    truth, views = general_scene(rng, count, setup, noise=Noise(0.0, 0.0, 0.0))
    samples = []
    for view in views:
        robot = view.base_T_tcp if setup is Setup.EYE_TO_HAND else view.base_T_tcp.inverse()
        seen = truth.x.inverse() @ robot @ truth.z
        seen = replace(seen, position_m=tuple(size * v for v in seen.position_m))
        tilt, turn, across, depth = noise * np.array(TARGET)
        seen = disturbed(seen, rng, np.array([tilt, tilt, turn]), np.array([across, across, depth]))
        twist = [rng.normal(0, noise * s, 3) for s in ROBOT]
        said = view.base_T_tcp @ Pose.from_rotation(twist[1], Rotation.from_rotvec(twist[0]))
        samples.append(PoseSample(view.id, said, seen))
    return truth, samples


ORDERS: dict[str, Callable[[int], list[int]]] = {
    "each row five times": lambda count: [i for i in range(count) for _ in range(5)],
    "table five times": lambda count: list(range(count)) * 5,
    "rows at random": lambda count: np.random.default_rng(1).integers(0, count, 5 * count).tolist(),
    "first row forty times": lambda count: [0] * 40 + list(range(1, count)),
    "there and back": lambda count: list(range(count)) + list(range(count))[::-1],
}
"""Orders in which rows of a table repeat one another, by the number of rows."""


def jittered(pose: Pose, rng: np.random.Generator, jitter: float) -> Pose:
    """Add a robot's noise, 0.1 mm and 0.02 degrees, times `jitter`."""
    turn = Rotation.from_rotvec(rng.normal(0, 3e-4, 3) * jitter)
    return Pose.from_rotation(rng.normal(pose.position_m, 1e-4 * jitter), pose.rotation * turn)
