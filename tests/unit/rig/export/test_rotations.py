"""Exported orientations are continuous within an episode and canonical at its start."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.types import Pose
from rig.export.messages import ContinuousPoses

NOISE_RAD = 3e-5
"""Noise of the orientation of a real arm at rest."""


def noisy(start_rotvec: tuple[float, float, float], turn_deg: float, seed: int) -> list[Pose]:
    """Poses of a tool that turns about its own axis, each with a canonical quaternion and noise."""
    rng = np.random.default_rng(seed)
    start = Rotation.from_rotvec(start_rotvec)
    poses = []
    for angle in np.linspace(0.0, turn_deg, 170):
        turn = Rotation.from_euler("z", angle, degrees=True)
        rotation = Rotation.from_rotvec(rng.normal(0.0, NOISE_RAD, 3)) * start * turn
        x, y, z, w = rotation.as_quat(canonical=True).tolist()
        poses.append(Pose((0.0, 0.0, 0.0), (x, y, z, w)))
    return poses


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 400.0])
@pytest.mark.parametrize(
    "start", [(np.pi, 0.0, 0.0), (0.0, np.pi, 0.0), (2.2214, 2.2214, 0.0), (0.3, 0.1, 0.2), (0.0, 0.0, np.pi)]
)
def test_no_step_changes_sign_and_rotations_are_kept(
    start: tuple[float, float, float], turn_deg: float
) -> None:
    recorded = noisy(start, turn_deg, 3)
    continuous = ContinuousPoses()
    found = np.array([continuous.next(pose).quaternion_xyzw for pose in recorded])
    given = np.array([pose.quaternion_xyzw for pose in recorded])
    assert found[0, 3] >= 0.0
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0.9).all()
    assert np.abs(np.abs(np.sum(found * given, axis=1)) - 1.0).max() < 1e-12
    assert np.array_equal(np.abs(found), np.abs(given))


def test_canonical_quaternions_of_a_tool_pointing_down_do_change_sign() -> None:
    given = np.array([pose.quaternion_xyzw for pose in noisy((np.pi, 0.0, 0.0), 0.0, 3)])
    assert given[:, 0].std() > 0.5
