"""Create poses from matrices, quaternions or rotation vectors, after checking the values."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calibration.verdict import length_guess
from drivers.errors import CalibrationError
from drivers.types import Pose

Array = NDArray[np.float64]

_NOT_ORTHONORMAL = 2e-3
"""Largest accepted deviation of R^T R from the identity."""
SAME_POSE_M, SAME_POSE_RAD = 1e-3, float(np.radians(0.5))
"""Robot poses closer than both count as one pose: well above the noise of a pose that a robot repeats
(0.1 mm, 0.02 degrees), well below the distance of poses that are chosen for a calibration."""
FARTHEST_M, REACH_M = 20.0, 5.0
"""Largest accepted coordinate of a pose, and of a tool in the base frame: robots reach at most 4.7 m."""


def pose_from_matrix(matrix: ArrayLike, name: str) -> Pose:
    """Create a pose from a (4, 4) matrix. Raises `CalibrationError` unless it is a rigid transform in m."""
    values = finite(matrix, (4, 4), name)
    turn = values[:3, :3]
    if np.abs(values[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise CalibrationError(f"{name}: the last row of its matrix is {values[3].tolist()}, not 0 0 0 1")
    if np.linalg.det(turn) < 0:
        raise CalibrationError(f"{name}: its rotation is a reflection (determinant -1); is an axis swapped?")
    if np.abs(turn.T @ turn - np.eye(3)).max() > _NOT_ORTHONORMAL:
        scale = float(np.cbrt(np.linalg.det(turn)))
        raise CalibrationError(f"{name}: its rotation matrix is not orthonormal (scale {scale:.4f})")
    return _pose(values[:3, 3], Rotation.from_matrix(turn), name)


def pose_matrix(pose: Pose) -> Array:
    """Return a pose as a matrix (4, 4), m."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation.as_matrix(), pose.position_m
    return matrix


def pose_from_quaternion(position_m: ArrayLike, quaternion_xyzw: ArrayLike, name: str) -> Pose:
    """Create a pose; both signs of a quaternion give the same rotation. Raises `CalibrationError`."""
    values = finite(quaternion_xyzw, (4,), name)
    length = float(np.linalg.norm(values))
    if abs(length - 1.0) > 0.01:
        raise CalibrationError(f"{name}: its quaternion has length {length:.4g}, not 1; is its order xyzw?")
    return _pose(finite(position_m, (3,), name), Rotation.from_quat(values), name)


def pose_from_rotation_vector(position_m: ArrayLike, rotation_vector_rad: ArrayLike, name: str) -> Pose:
    """Create a pose from a UR pose (x, y, z in m, rotation vector in rad). Raises `CalibrationError`."""
    values = finite(rotation_vector_rad, (3,), name)
    if np.linalg.norm(values) > 2.0 * np.pi + 1e-6:
        raise CalibrationError(
            f"{name}: a rotation vector of {np.linalg.norm(values):.1f} rad; is it in degrees?"
        )
    return _pose(finite(position_m, (3,), name), Rotation.from_rotvec(values), name)


def pose_fault(pose: Pose, name: str, farthest_m: float = FARTHEST_M) -> str | None:
    """Return why a pose from another source is invalid; None if it is valid."""
    try:
        found = pose_from_quaternion(pose.position_m, pose.quaternion_xyzw, name)
        require_near(found, name, farthest_m)
    except CalibrationError as error:
        return str(error)
    return None


def repeated_pose(pose: Pose, others: Iterable[tuple[str, Pose]]) -> str | None:
    """Return that a robot pose repeats one of the named others, or None.

    A repeated pose repeats the robot's errors. If it counted as an independent sample, sigma would be too
    small.
    """
    for name, other in others:
        near = np.linalg.norm(np.subtract(pose.position_m, other.position_m)) < SAME_POSE_M
        if near and (other.rotation.inv() * pose.rotation).magnitude() < SAME_POSE_RAD:
            return f"same robot pose as {name}"
    return None


def require_near(pose: Pose, name: str, farthest_m: float = FARTHEST_M) -> None:
    """Raise `CalibrationError` with a guess of the unit if a coordinate exceeds farthest_m."""
    largest_m = float(np.abs(pose.position_m).max())
    if largest_m > farthest_m:
        guess = length_guess(largest_m, "metres", 0.05, 3.0)
        raise CalibrationError(
            f"{name}: is {largest_m:.4g} m away, more than {farthest_m:g} m{guess}; m are needed"
        )


def finite(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Convert to a float64 array of a shape. Raises `CalibrationError` for another shape, NaN or infinity."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{name}: {values!r} are not numbers") from error
    if array.shape != shape:
        raise CalibrationError(f"{name}: numbers of shape {shape} are needed, got {array.shape}")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{name}: contains NaN or an infinite value")
    return array


def _pose(position_m: Array, rotation: Rotation, name: str) -> Pose:
    pose = Pose.from_rotation(position_m, rotation)
    require_near(pose, name)
    return pose
