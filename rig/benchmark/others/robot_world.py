"""OpenCV's test set of robot-world and hand-eye calibration, with its published answer.

A camera on a robot's tool before a board (A. Tabb, "Solving the Robot-World Hand-Eye(s) Calibration Problem
with Iterative Methods", data set 1, Ag Data Commons 2017; in opencv_extra). A X = Z B: A takes the board's
frame to the camera's, B the robot's base to its tool, X the base to the board, Z the tool to the camera; mm.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.hand_eye.pose_pairs import PoseSample
from calibration.hand_eye.pose_solve import calibrate_pose_pairs
from calibration.hand_eye.samples import Setup
from calibration.poses import pose_from_matrix, pose_matrix
from drivers.errors import CalibrationError
from rig.benchmark.others.rows import Row, Say, clone_of, commit_of, how_to_clone, skipped

PART = "real sets"
_HALVES = 12
REPOSITORY = "opencv/opencv_extra"
FOLDER = Path("testdata/cv/robot_world_hand_eye_calibration")
_METHODS = {"Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, "Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI}

Array = NDArray[np.floating]
Pairs = list[tuple[Array, Array]]
"""A and B of each pose, (4, 4), m."""
Answer = tuple[Array, Array]
"""X and Z, (4, 4) each, m."""


def run_robot_world(clones: Path | None, say: Say) -> list[Row]:
    """A row for each of OpenCV's methods and for the published answer, by poses that were held out."""
    clone = clone_of(REPOSITORY, clones)
    if clone is None or not (clone / FOLDER / "cali.txt").is_file():
        return [skipped(PART, f"{REPOSITORY} robot_world", how_to_clone(REPOSITORY))]
    say(f"{REPOSITORY}: {FOLDER.name}")
    pairs = _read(clone / FOLDER)
    published = _published(clone / FOLDER / "rwhe_AA_RPI" / "transformations.txt")
    solvers: dict[str, Callable[[Pairs], Answer]] = {"ours": _ours}
    solvers |= {f"OpenCV's {name}": partial(_opencv, method) for name, method in _METHODS.items()}
    solvers["the published answer, of all poses"] = lambda _: published
    version, what = commit_of(clone), f"{REPOSITORY} robot_world, {len(pairs)} poses"
    try:
        missed = {name: _held_out(solve, pairs) for name, solve in solvers.items()}
    except CalibrationError as error:
        return [Row(PART, what, version, str(error), met=False)]
    ours = missed.pop("ours")
    return [
        Row(
            PART, f"{what}: {name}", version, "poses of the other half missed by, rms, mm and deg",
            f"{ours[0]:.1f}, {ours[1]:.2f}", f"{theirs[0]:.1f}, {theirs[1]:.2f}",
            ours[0] <= theirs[0] if name.startswith("the published") else None,
        )
        for name, theirs in missed.items()
    ]  # fmt: skip


def _held_out(solve: Callable[[Pairs], Answer], pairs: Pairs) -> tuple[float, float]:
    """Return by how much A X misses Z B in halves that were not solved with, medians, mm and deg."""
    rng = np.random.default_rng(0)
    missed = []
    for _ in range(_HALVES):
        order = rng.permutation(len(pairs))
        half, rest = order[: len(pairs) // 2], order[len(pairs) // 2 :]
        missed.append(_missed(solve([pairs[i] for i in half]), [pairs[i] for i in rest]))
    mm, deg = np.median(missed, axis=0)
    return float(mm), float(deg)


def _ours(pairs: Pairs) -> Answer:
    """Raises `CalibrationError` where ours refuses."""
    samples = [
        PoseSample(f"{i:03d}", pose_from_matrix(robot, "robot").inverse(), pose_from_matrix(seen, "target"))
        for i, (seen, robot) in enumerate(pairs)
    ]
    found = calibrate_pose_pairs(samples, Setup.EYE_IN_HAND)
    if found.pose is None or found.target is None:
        raise CalibrationError(f"refused: {found.assessment}")
    return pose_matrix(found.target.inverse()), pose_matrix(found.pose.inverse())


def _read(folder: Path) -> Pairs:
    numbers = np.fromstring(" ".join((folder / "robot_cali.txt").read_text().split()[1:]), sep=" ")
    robots = [_rigid(matrix[:3, :3], matrix[:3, 3]) for matrix in numbers.reshape(-1, 4, 4)]
    lines = [line.split() for line in (folder / "cali.txt").read_text().splitlines()[1:] if line.strip()]
    # a line: picture, camera matrix (9), rotation (9), translation (3), distortion
    seen = [np.array(line[10:22], float) for line in lines]
    return list(zip((_rigid(v[:9].reshape(3, 3), v[9:]) for v in seen), robots, strict=True))


def _published(path: Path) -> Answer:
    words = [word for word in path.read_text().split() if word != "X"]
    split = words.index("Z")
    x, z = (np.array(part, float).reshape(4, 4) for part in (words[:split], words[split + 2 :]))
    return _rigid(x[:3, :3], x[:3, 3]), _rigid(z[:3, :3], z[:3, 3])


def _rigid(rotation: Array, translation_mm: Array) -> Array:
    """Return (4, 4), m, of the rotation nearest to a matrix that was printed with a few digits."""
    left, _, right = np.linalg.svd(rotation)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = left @ right, 1e-3 * np.asarray(translation_mm, float)
    return matrix


def _opencv(method: int, pairs: Pairs) -> Answer:
    seen, robots = zip(*pairs, strict=True)
    found = cv2.calibrateRobotWorldHandEye(
        [a[:3, :3] for a in seen],
        [a[:3, 3] for a in seen],
        [b[:3, :3] for b in robots],
        [b[:3, 3] for b in robots],
        method=method,
    )
    x, z = np.eye(4), np.eye(4)
    x[:3, :3], x[:3, 3] = found[0], found[1].reshape(3)
    z[:3, :3], z[:3, 3] = found[2], found[3].reshape(3)
    return x, z


def _missed(answer: Answer, pairs: Pairs) -> tuple[float, float]:
    """Return by how much A X misses Z B, rms over the pairs, mm and deg."""
    x, z = answer
    both = [(seen @ x, z @ robot) for seen, robot in pairs]
    moved = [np.linalg.norm(one[:3, 3] - other[:3, 3]) for one, other in both]
    turned = [Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude() for one, other in both]
    mm, rad = (float(np.sqrt(np.mean(np.square(values)))) for values in (1e3 * np.array(moved), turned))
    return mm, float(np.degrees(rad))
