"""Simulated streams and poses with known answers: wiggles seen by two clocks, a tip on a point."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.time_offset import TimedSignal, make_stream
from drivers.types import Pose

Array = NDArray[np.floating]


def wiggle_scene(
    rng: np.random.Generator, motion: str = "chirp", offset_s: float = 0.0473, seconds: float = 20.0,
    noise_deg: float = 0.2, drift_ppm: float = 0.0,
) -> tuple[TimedSignal, TimedSignal]:  # fmt: skip
    """A robot's angle at 500 Hz, and a camera's at 30 Hz with 2 ms jitter and 5 % dropped frames.

    motion: chirp (8 degrees, 0.4 to 1.2 Hz), static, constant (no noise either), sine (4 Hz, so
    that it repeats within the search). The camera's clock is `offset_s` behind, growing by
    `drift_ppm` from the middle.
    """
    robot_s = np.arange(0.0, seconds, 0.002)
    camera_s = np.arange(0.0, seconds, 1 / 30) + rng.uniform(-0.002, 0.002, round(np.ceil(seconds * 30)))
    camera_s = np.sort(camera_s[rng.uniform(size=len(camera_s)) > 0.05])
    noise = 0.0 if motion == "constant" else noise_deg
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


def pivot_scene(
    rng: np.random.Generator, count: int, turns: Rotation | None = None, noise_m: float = 1e-4
) -> tuple[Array, list[tuple[str, Pose]]]:
    """Poses of a tool whose tip rests in one hole, and where the tip truly is in the tool's frame."""
    tip, hole = np.array([0.004, -0.002, 0.283]), np.array([0.45, 0.05, 0.02])
    turns = turns or Rotation.from_rotvec(rng.normal(0.0, 0.45, (count, 3)))
    down = Rotation.from_euler("x", 180, degrees=True)
    poses = []
    for i in range(count):
        turn = down * turns[i]
        place = rng.normal(hole - turn.apply(tip), noise_m)
        poses.append((f"{i:02d}", Pose.from_rotation(place, turn)))
    return tip, poses
