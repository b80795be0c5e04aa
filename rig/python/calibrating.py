"""Solve calibrations from arrays: a camera from points on a board, a hand-eye from pairs of poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.camera.files import TERMS
from calibration.camera.intrinsics import assess_camera, calibrate_camera
from calibration.hand_eye.pose_pairs import PoseSample, calibrate_pose_pairs
from calibration.hand_eye.solve import Setup
from calibration.poses import pose_from_matrix, pose_matrix
from calibration.targets.boards import View
from drivers import arguments
from drivers.errors import InputError
from drivers.types import Pose
from drivers.values import short_repr

Array = NDArray[np.float64]
EYE_TO_HAND = Setup.EYE_TO_HAND.value
MAX_SIDE_PX, MAX_PX = 100_000, 1e6
MAX_BOARD_M, MAX_MATRIX = 100.0, 1e6
"""Limits of arguments, far beyond any camera, board (m) and pose (m)."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraSolution:
    """A calibrated camera with its uncertainty.

    size_px: width, height. matrix: (3, 3) px, pixel centres at integer coordinates. distortion: (5,) or (8,),
    in OpenCV's order. sigma: standard deviation of each estimated parameter by name (fx, fy, cx, cy, k1 ...).
    rms_px: reprojection error of the fitted points. held_out_rms_px: reprojection error on held-out views.
    verdict: "good", "weak" or "refused". reasons: of the verdict. rejected: reason for each rejected view by
    number, from 0.
    """

    size_px: tuple[int, int]
    matrix: Array
    distortion: Array
    sigma: dict[str, float]
    rms_px: float
    held_out_rms_px: float
    verdict: str
    reasons: tuple[str, ...]
    rejected: dict[int, str]

    __repr__ = short_repr


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeSolution:
    """The calibrated pose of a camera with its uncertainty.

    matrix: (4, 4) base_T_camera for eye-to-hand, tcp_T_camera for eye-in-hand. target: (4, 4) tcp_T_target or
    base_T_target. sigma_m, sigma_deg: (3,) standard deviations of position and rotation, in the axes of the
    base or the TCP. All are None if the calibration is refused. verdict, reasons, rejected: as in
    `CameraSolution`, by pair.
    """

    matrix: Array | None
    target: Array | None
    sigma_m: Array | None
    sigma_deg: Array | None
    verdict: str
    reasons: tuple[str, ...]
    rejected: dict[int, str]

    __repr__ = short_repr


def solve_camera(
    board_m: Sequence[ArrayLike], image_px: Sequence[ArrayLike], size_px: tuple[int, int]
) -> CameraSolution:
    """Calibrate a camera from views of a flat board.

    board_m: for each view (N, 2) or (N, 3) m, positions of its points on the board (z = 0). image_px: for
    each view (N, 2) px, positions of the points in the image. size_px: width and height of the images.
    Outliers among the views are rejected. Raises `InputError` for other shapes, `CalibrationError` if the
    views do not determine the camera.
    """
    boards, pictures = _items("board_m", board_m), _items("image_px", image_px)
    if len(boards) != len(pictures):
        numbers = f"{len(boards)} boards and {len(pictures)} pictures"
        raise InputError(f"solve_camera: {numbers}: give the same number of each")
    size = tuple(
        arguments.whole("solve_camera: size_px", n, 1, MAX_SIDE_PX) for n in _items("size_px", size_px)
    )
    if len(size) != 2:
        raise arguments.refusal("solve_camera: size_px", size_px, "(width, height)")
    views = [_view(i, *pair, size) for i, pair in enumerate(zip(boards, pictures, strict=True))]
    result = calibrate_camera(views)
    camera, assessment = result.fit.camera, assess_camera(result)
    return CameraSolution(
        size_px=camera.size,
        matrix=camera.matrix.astype(np.float64),
        distortion=camera.distortion.astype(np.float64),
        sigma={TERMS[i]: float(s) for i, s in zip(result.fit.lens.free, result.sigma, strict=True)},
        rms_px=result.fit.rms_px,
        held_out_rms_px=result.held_out_rms_px,
        verdict=assessment.verdict.value,
        reasons=assessment.reasons,
        rejected={int(r.id): r.reason for r in result.rejected},
    )


def solve_hand_eye(
    base_T_tcp: ArrayLike,  # noqa: N803 - frame names keep their case
    camera_T_target: ArrayLike,  # noqa: N803
    setup: str = EYE_TO_HAND,
) -> HandEyeSolution:
    """Calibrate the pose of a camera from pairs of robot pose and target pose.

    base_T_tcp: (N, 4, 4) of the robot, m. camera_T_target: (N, 4, 4) of a detector, m. setup: "eye-to-hand"
    (fixed camera, target on the tool) or "eye-in-hand" (camera on the tool, fixed target). The pairs are in
    order of time. Outliers among them are rejected. Raises `InputError` for an invalid pose or setup.
    """
    setup = arguments.choice("solve_hand_eye: setup", setup, [each.value for each in Setup])
    robot, seen = _poses("base_T_tcp", base_T_tcp), _poses("camera_T_target", camera_T_target)
    if len(robot) != len(seen):
        raise InputError(
            f"solve_hand_eye: {len(robot)} robot poses, {len(seen)} target poses: give the same number"
        )
    pairs = [PoseSample(str(i), *pair) for i, pair in enumerate(zip(robot, seen, strict=True))]
    result = calibrate_pose_pairs(pairs, Setup(setup))
    sigma = None if result.covariance is None else np.sqrt(np.diag(result.covariance))
    return HandEyeSolution(
        matrix=None if result.pose is None else pose_matrix(result.pose),
        target=None if result.target is None else pose_matrix(result.target),
        sigma_m=None if sigma is None else sigma[3:],
        sigma_deg=None if sigma is None else np.degrees(sigma[:3]),
        verdict=result.assessment.verdict.value,
        reasons=result.assessment.reasons,
        rejected={int(r.id): r.reason for r in result.rejected},
    )


def _items(name: str, values: object) -> list[Any]:
    """Return the items of an argument of `solve_camera`. Raises `InputError` if it has none."""
    try:
        return list(values)  # type: ignore[call-overload]
    except TypeError:
        raise arguments.refusal(f"solve_camera: {name}", values, "a list") from None


def _view(number: int, board_m: ArrayLike, image_px: ArrayLike, size_px: tuple[int, int]) -> View:
    three = np.ndim(board_m) == 2 and np.shape(board_m)[1] == 3
    board = arguments.array(
        f"solve_camera: board_m[{number}]", board_m, (None, 3 if three else 2), MAX_BOARD_M
    )
    seen = arguments.array(f"solve_camera: image_px[{number}]", image_px, (len(board), 2), MAX_PX)
    flat = np.column_stack([board[:, :2], np.zeros(len(board))])
    if three and np.abs(board[:, 2]).max(initial=0.0) > 0.0:
        raise InputError(f"solve_camera: view {number}: points of a flat board have z = 0")
    return View(str(number), np.arange(len(board)), flat, seen, size_px)


def _poses(name: str, matrices: ArrayLike) -> list[Pose]:
    stack = arguments.array(f"solve_hand_eye: {name}", matrices, (None, 4, 4), MAX_MATRIX)
    return [pose_from_matrix(matrix, f"{name}[{i}]") for i, matrix in enumerate(stack)]
