"""Kinematics of the UR5e from its nominal Denavit-Hartenberg parameters (Universal Robots, DH page)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from drivers.types import Pose, Vector6

_A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
_D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
_COS_ALPHA, _SIN_ALPHA = np.cos(_ALPHA).tolist(), np.sin(_ALPHA).tolist()
ELBOW_UP: Vector6 = (0.0, -1.75, -1.9, -1.05, 1.57, 0.0)
_REACHED, _ITERATIONS = 1e-6, 60
ENCODER_RAD = 3e-5
"""Standard deviation of the joint angles that a UR5e at rest reports (measured on a real arm)."""
_CYCLE_NS = 2_000_000
_NOISE_CYCLES = 9973


class Encoders:
    """Adds the noise of the encoders to joint angles; a new reading every 2 ms. seed: of the noise."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng((seed, 47))
        self._noise = rng.normal(0.0, ENCODER_RAD, (_NOISE_CYCLES, 6)).tolist()

    def shown(self, joints_rad: Vector6, time_ns: int) -> Vector6:
        """Return the reported joint angles."""
        noise = self._noise[time_ns // _CYCLE_NS % _NOISE_CYCLES]
        a, b, c, d, e, f = (q + n for q, n in zip(joints_rad, noise, strict=True))
        return a, b, c, d, e, f


def forward(joints_rad: Vector6 | NDArray[np.float64], tool_length_m: float) -> Pose:
    """Return `base_T_tcp` of six joint angles with a straight tool of the given length."""
    transform = _chain(np.asarray(joints_rad, float), tool_length_m)[-1]
    return Pose.from_rotation(transform[:3, 3], Rotation.from_matrix(transform[:3, :3]))


def inverse(
    base_T_tcp: Pose,  # noqa: N803
    tool_length_m: float,
    near_rad: Vector6 = ELBOW_UP,
) -> Vector6 | None:
    """Return joint angles near `near_rad` that reach a pose, or None if it is out of reach.

    Damped least squares (Wampler 1986); from a nearby start it needs two or three iterations.
    """
    joints = np.array(near_rad, float)
    target_position = np.asarray(base_T_tcp.position_m)
    target_rotation = base_T_tcp.rotation.as_matrix()
    for _ in range(_ITERATIONS):
        frames = _chain(joints, tool_length_m)
        error = _pose_error(frames[-1], target_position, target_rotation)
        if float(np.abs(error).max()) < _REACHED:
            wrapped = (joints + np.pi) % (2 * np.pi) - np.pi
            return tuple(float(v) for v in wrapped)  # type: ignore[return-value]
        jacobian = _jacobian(frames)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-6 * np.eye(6), error)
        joints += np.clip(step, -0.5, 0.5)
    return None


def _chain(joints: NDArray[np.float64], tool_length_m: float) -> list[NDArray[np.float64]]:
    frames = [np.eye(4)]
    cosines, sines = np.cos(joints).tolist(), np.sin(joints).tolist()
    for i, (c, s, ca, sa) in enumerate(zip(cosines, sines, _COS_ALPHA, _SIN_ALPHA, strict=True)):
        link = np.array(
            [
                [c, -s * ca, s * sa, _A_M[i] * c],
                [s, c * ca, -c * sa, _A_M[i] * s],
                [0.0, sa, ca, _D_M[i]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        frames.append(frames[-1] @ link)
    tool = np.eye(4)
    tool[2, 3] = tool_length_m
    frames.append(frames[-1] @ tool)
    return frames


def _pose_error(
    frame: NDArray[np.float64], position: NDArray[np.float64], rotation: NDArray[np.float64]
) -> NDArray[np.float64]:
    turn = Rotation.from_matrix(rotation @ frame[:3, :3].T).as_rotvec()
    return np.concatenate([position - frame[:3, 3], turn])


def _jacobian(frames: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    tip = frames[-1][:3, 3]
    columns = []
    for frame in frames[:6]:
        (ax, ay, az), (bx, by, bz) = frame[:3, 2].tolist(), (tip - frame[:3, 3]).tolist()
        # the cross product written out: numpy's takes most of the time of a simulated arm's state
        columns.append([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx, ax, ay, az])
    return np.array(columns).T
