"""Orientations without changes of sign within an episode.

A quaternion and its negative are the same rotation. A tool that points down has w near 0, so noise changes
the sign from step to step. Exported quaternions are canonical (w >= 0) at the start of an episode; each later
one has the sign that is nearer to the quaternion before.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.types import Pose

Floats = NDArray[np.float64]


class ContinuousPoses:
    """Gives the poses of one episode, in order, continuous quaternions."""

    def __init__(self) -> None:
        self._last: Floats | None = None

    def next(self, pose: Pose) -> Pose:
        """Return the pose with the sign of its quaternion that continues the previous one."""
        found = np.array(pose.quaternion_xyzw)
        against = found[3] if self._last is None else found @ self._last
        found = -found if against < 0.0 else found
        self._last = found
        x, y, z, w = found.tolist()
        return replace(pose, quaternion_xyzw=(x, y, z, w))
