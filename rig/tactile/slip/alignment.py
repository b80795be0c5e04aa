"""Align frames to the keyframes of a contact: poses, fits, and the arrays that the compiled loops work on.

Keyframe k was taken at angle theta_k with the tracked point at p_k. For a candidate pose (theta, p) it has
turned by theta - theta_k, and its center has moved so that the point is at p. The residuals of its slopes and
of its texture, each divided by its mean square, are linearised in (theta, p); gain and constant slope of each
keyframe are eliminated. The sum over the keyframes, weighted by richness, gives one 3 x 3 system per
iteration.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.height import Field
from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.loops import (
    ANGLE,
    CURVED,
    LEVER_X,
    LEVER_Y,
    MOST_KEYS,
    MOST_POINTS,
    PLAIN,
    SCRATCH,
    SLOPES,
    TEXTURE,
    Found,
    Grid,
    Keys,
    Plan,
    Planes,
    align,
    search_grid,
    weigh,
)
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES
from rig.tactile.slip.slopes import CURVATURE
from rig.tactile.slip.texture import Texture

COARSE_ITERATIONS, COARSE_PART = 6, 3
"""Iterations from a further start, with every third point."""
GRID_RAD, GRID_PX = math.radians(8.0), 2
"""Steps of the search by curvature: its agreement falls to about half over one step of a sharp contact."""


class Pose(NamedTuple):
    """Angle of the object, rad, counter-clockwise, and position of the tracked point, work pixels, y down."""

    angle_rad: float
    point_px: complex

    def moved(self, by: "Pose") -> "Pose":
        """Return this pose after a rotation and a shift."""
        return Pose(self.angle_rad + by.angle_rad, self.point_px + by.point_px)

    def since(self, other: "Pose") -> "Pose":
        """Return the rotation and the shift from another pose to this one."""
        return Pose(self.angle_rad - other.angle_rad, self.point_px - other.point_px)


@dataclass(frozen=True, slots=True)
class Fit:
    """A pose, and how well the keyframes fit there.

    score: mean of -log(1 - correlation^2) / 2, summed over the channels. best: highest correlation of the
    slopes. loss: missing agreement of the frame's curvature with the keyframe that shows a rotation best,
    divided by the loss after a rotation by 10 degrees. rank: score minus the mean missing agreement. alone:
    from slopes alone.
    """

    pose: Pose
    score: float
    best: float
    loss: float
    rank: float
    alone: bool

    @property
    def angle_rad(self) -> float:
        """The angle of the pose."""
        return self.pose.angle_rad

    @property
    def fits(self) -> bool:
        """Whether the keyframes fit well enough for an answer."""
        return self.alone or self.score >= ALIGNMENT.least_score


class Reading:
    """One way to read the frames: the weight of the slopes beside the texture, and the poses it has found.

    keys: the pose of each keyframe according to this reading. Readings that see the same rotation agree. One
    that follows what rests with the gel, or a wrong match, leaves the others.
    """

    def __init__(self, slopes_share: float, pose: Pose) -> None:
        self.slopes_share, self.pose = slopes_share, pose
        self.keys: list[Pose] = []

    def move(self, by: Pose) -> None:
        """Move the pose, for a frame that this reading has not aligned."""
        self.pose = self.pose.moved(by)

    def anchor(self, by_px: complex) -> None:
        """Track another point of the object, which is now away from the present one by this."""
        angle = self.pose.angle_rad
        self.keys = [
            Pose(key.angle_rad, key.point_px + by_px * cmath.exp(1j * (angle - key.angle_rad)))
            for key in self.keys
        ]
        self.pose = Pose(angle, self.pose.point_px + by_px)

    def join(self, other: "Reading") -> None:
        """Take the pose of another reading, and move the keyframes with it."""
        by = other.pose.since(self.pose)
        self.keys = [key.moved(by) for key in self.keys]
        self.pose = other.pose


class Aligner:
    """Aligns frames to keyframes. Its arrays are made once and used for all contacts of a sensor."""

    def __init__(self) -> None:
        self._weights = np.zeros((MOST_KEYS, 2, MOST_POINTS), np.float32)
        self._scratch = np.zeros((MOST_KEYS, 2, SCRATCH, MOST_POINTS), np.float32)
        self._views = np.array([[1.0, 0.0, 0.0]] * 2)
        self._keys: list[Keyframe] = []

    def take(self, keys: list[Keyframe]) -> None:
        """Use other keyframes from now on."""
        self._keys, best = keys, max(key.richness for key in keys)
        self._bank = np.stack([key.rows for key in keys])
        self._plain = np.ascontiguousarray(self._bank[:, :CURVED, PLAIN])
        self._facts = np.stack([key.facts((key.richness / best) ** KEYFRAMES.power) for key in keys])

    def view(self, slopes: Field, corner_px: tuple[int, int], reading: Reading) -> None:
        """Take the slopes of a frame (4, h, w), see `slope_planes`, whose box begins at a corner.

        They are aligned to the richest keyframe and to those nearest to the last angle of a reading.
        """
        angles = [key.angle_rad for key in reading.keys]
        self._view_slopes(slopes, corner_px, self._choose(angles, reading.pose.angle_rad))
        self.read_as(reading)

    def _view_slopes(self, slopes: Field, corner_px: tuple[int, int], used: NDArray[np.int64]) -> None:
        self._views[SLOPES], self.used = (1.0, -corner_px[0], -corner_px[1]), used
        self._slopes = self._texture = slopes

    def view_texture(self, texture: Texture) -> None:
        """Take the texture too, and weigh its points: texture that has not moved may belong to the gel."""
        self._views[TEXTURE], self._texture = texture.view, texture.planes
        keys, frame = Keys(self._bank, self._facts, self.used), self._frame
        weigh(keys, frame, ALIGNMENT.rest_share, ALIGNMENT.noise_share, self._weights)

    @property
    def _frame(self) -> Planes:
        return Planes(self._slopes, self._texture, self._views)

    def read_as(self, reading: Reading) -> None:
        """Align with the poses of the keyframes, and the weight of the slopes, of a reading."""
        self._share = reading.slopes_share
        for facts, key, pose in zip(self._facts, self._keys, reading.keys, strict=True):
            lever = pose.point_px - key.center_px
            facts[ANGLE], facts[LEVER_X], facts[LEVER_Y] = pose.angle_rad, lever.real, lever.imag

    def alone(self, start: Pose) -> Fit:
        """Align the slopes alone."""
        plan = Plan(self._share, ALIGNMENT.score_of_loss, 1, int(ALIGNMENT.iterations), 1)
        return _fit(self._run(self.used, [start], plan, self._plain)[0], alone=True)

    def both(self, starts: Sequence[Pose]) -> Fit:
        """Align both channels from several starts; return the fit with the highest rank."""
        return _fit(self._jointly(self.used, starts, int(ALIGNMENT.iterations))[0])

    def directly(
        self,
        key: int,
        frame: tuple[Field, tuple[int, int], Texture],
        reading: Reading,
        starts: Sequence[Pose],
    ) -> Fit:
        """Align a frame (slopes, corner, texture) to one keyframe, from several starts."""
        slopes, corner_px, texture = frame
        self._view_slopes(slopes, corner_px, np.array([key], np.int64))
        self.view_texture(texture)
        self.read_as(reading)
        return self.both(starts)

    def at(self, pose: Pose) -> Fit:
        """Return how well both channels fit at a pose, without a step."""
        return _fit(self._jointly(self.used, [pose], 0)[0])

    def coarse(self, starts: Sequence[Pose]) -> tuple[Fit, float]:
        """Align roughly to the richest keyframe; return the best fit, and the rank from the first start."""
        found, first = self._jointly(self.used[:1], starts, COARSE_ITERATIONS, COARSE_PART)
        return _fit(found), first

    def search_grid(self, around: Pose, turns: int, steps: int) -> Pose:
        """Return the pose on a grid at which the curvature agrees best with the richest keyframe.

        turns, steps: number of steps of `GRID_RAD` and `GRID_PX` to either side.
        """
        k, pose = self.used[0], np.array([around.angle_rad, around.point_px.real, around.point_px.imag])
        grid = Grid(turns, GRID_RAD, steps, GRID_PX, COARSE_PART)
        rim = 2 * (steps * GRID_PX + 1)
        plane = cv2.copyMakeBorder(self._slopes[CURVATURE], rim, rim, rim, rim, cv2.BORDER_CONSTANT)
        view = self._views[SLOPES] + (0.0, rim, rim)
        angle, x, y = search_grid(self._bank[k, CURVED], self._facts[k], plane, view, pose, grid)
        return Pose(angle, complex(x, y))

    def _choose(self, angles_rad: list[float], near_rad: float) -> NDArray[np.int64]:
        """Return the indices of the richest keyframe and of the nearest others that are rich enough."""
        rich = [key.richness for key in self._keys]
        richest = rich.index(max(rich))
        good = [k for k, one in enumerate(rich) if one >= KEYFRAMES.least_richness * rich[richest]]
        others = sorted((k for k in good if k != richest), key=lambda k: abs(angles_rad[k] - near_rad))
        return np.array([richest, *others[: int(KEYFRAMES.used) - 1]], np.int64)

    def _jointly(
        self, used: NDArray[np.int64], starts: Sequence[Pose], most: int, part: int = 1
    ) -> tuple[Found, float]:
        plan = Plan(self._share, ALIGNMENT.score_of_loss, 2, most, part)
        return self._run(used, starts, plan, self._weights)

    def _run(
        self, used: NDArray[np.int64], starts: Sequence[Pose], plan: Plan, weights: Field
    ) -> tuple[Found, float]:
        at = np.array([(angle, point.real, point.imag) for angle, point in starts])
        keys = Keys(self._bank, self._facts, used)
        return align(keys, self._frame, weights, self._scratch, at, plan)


def _fit(found: Found, alone: bool = False) -> Fit:
    pose = Pose(found.angle_rad, complex(found.x, found.y))
    return Fit(pose, found.score, found.best, found.loss, found.rank, alone)
