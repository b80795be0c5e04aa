"""Motions with ground truth: given views of a target, pairs of poses, a tool tip turned about one point."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.solve import HandEyeSample, Setup
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import (
    NOISE,
    Noise,
    Truth,
    draw_truth,
    general_scene,
    noisy_sample,
)

Array = NDArray[np.floating]


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
