"""Motions with ground truth: given views of a target, and a tool tip turned about one point."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.samples import HandEyeSample
from drivers.types import Pose
from rig.benchmark.calibration.motion_scenes import NOISE, Truth, draw_truth, noisy_sample

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
