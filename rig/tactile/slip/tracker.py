"""One grasp: how the contact has turned and moved, through as few keyframes as will do."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.registration import Alignment, align, similarity, turning
from rig.tactile.slip.sampling import GradientField

# An alignment is good below this misfit and above this overlap; else a further keyframe is taken.
GOOD_MISFIT, GOOD_OVERLAP = 0.45, 0.7
# One whose steps were still large may be on its way to anywhere: it has to fit better.
UNSETTLED_MISFIT = 0.25
# Beyond these it is no alignment at all.
WORST_MISFIT, WORST_OVERLAP = 0.75, 0.4
# From where it is expected, an object turns at most so far between two frames.
MAX_JUMP_RAD = math.radians(20.0)
# An older keyframe is taken up again within this of its own angle.
NEAR_RAD = math.radians(25.0)
MAX_KEYFRAMES = 6
# A lost contact is looked for at these turns from where it was last: no further, as an edge looks
# the same after half a turn.
SEARCH_RAD = tuple(math.radians(turn) for turn in range(-72, 73, 12))
SEARCH_KEPT = 3


@dataclass(frozen=True, slots=True, eq=False)
class ContactPose:
    """Where a contact is.

    angle_rad: from the grasp's zero. point_px: where the first keyframe's center is now, x + i y.
    """

    angle_rad: float
    point_px: complex


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """A keyframe, the pose at which it was taken, and the variance of that angle, rad^2."""

    frame: Keyframe
    pose: ContactPose
    variance: float


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """A frame's pose, by which key, and how well it fits."""

    pose: ContactPose
    key: Key
    alignment: Alignment

    @property
    def turned_rad(self) -> float:
        """Turn since the keyframe was taken."""
        return self.pose.angle_rad - self.key.pose.angle_rad

    @property
    def good(self) -> bool:
        """Whether the keyframe still fits well."""
        found = self.alignment
        worst = GOOD_MISFIT if found.settled else UNSETTLED_MISFIT
        return found.misfit <= worst and found.overlap >= GOOD_OVERLAP


class KeyframeTracker:
    """Follows one grasp from its first keyframe on.

    angle_rad, variance: of the pose at the first keyframe. to_the_end: see `align`.
    """

    def __init__(self, first: Keyframe, angle_rad: float, variance: float, to_the_end: bool = False) -> None:
        self._to_the_end = to_the_end
        self._keys = [Key(first, ContactPose(angle_rad, first.center_px), variance)]
        self._key = self._keys[0]
        self._pose = self._key.pose
        self._weights: NDArray[np.float32] | None = None

    def track(self, field: GradientField, expected_rad: float) -> Tracked | None:
        """Return the pose in a frame, None where no keyframe fits. expected_rad: where to start from."""
        for key in self._candidates(expected_rad):
            found = self._aligned(key, field, ContactPose(expected_rad, self._pose.point_px))
            if found is not None and abs(found.pose.angle_rad - expected_rad) <= MAX_JUMP_RAD:
                return self._accept(found)
        return None

    def search(self, field: GradientField) -> Tracked | None:
        """Look for a lost contact over a wide range of turns; None where nothing fits."""
        rows, columns = np.nonzero(field.mask)
        middle = complex(columns.mean(), rows.mean())
        guesses = [ContactPose(self._pose.angle_rad + turn, middle) for turn in SEARCH_RAD]
        scores = [similarity(self._key.frame, field, *self._start(self._key, g)) for g in guesses]
        best = sorted(range(len(guesses)), key=lambda i: -scores[i])[:SEARCH_KEPT]
        weights, self._weights = self._weights, None
        found = [self._aligned(self._key, field, guesses[i]) for i in best]
        self._weights = weights
        fitting = [f for f in found if f is not None and f.good]
        return self._accept(min(fitting, key=lambda f: f.alignment.misfit)) if fitting else None

    def add_key(self, frame: Keyframe, pose: ContactPose, variance: float) -> None:
        """Take a further keyframe at a pose; the oldest but the first goes when there are many."""
        self._key = Key(frame, pose, variance)
        self._keys.append(self._key)
        self._weights = None
        if len(self._keys) > MAX_KEYFRAMES:
            del self._keys[1]

    def _candidates(self, angle_rad: float) -> Iterator[Key]:
        """Yield an older, surer key where one is near, then the one in use, then the other near ones."""
        near = [k for k in self._keys if abs(angle_rad - k.pose.angle_rad) < NEAR_RAD and k is not self._key]
        surer = [k for k in near if k.variance < self._key.variance]
        if surer:
            yield min(surer, key=lambda k: k.variance)
        yield self._key
        yield from (k for k in near if k not in surer[:1])

    def _aligned(self, key: Key, field: GradientField, expected: ContactPose) -> Tracked | None:
        weights = self._weights if key is self._key else None
        angle, shift = self._start(key, expected)
        alignment = align(key.frame, field, angle, shift, weights, self._to_the_end)
        if not (alignment.misfit <= WORST_MISFIT and alignment.overlap >= WORST_OVERLAP):
            return None
        lever = key.pose.point_px - key.frame.center_px
        point = key.frame.center_px + alignment.shift_px + turning(alignment.angle_rad) * lever
        found = Tracked(ContactPose(key.pose.angle_rad + alignment.angle_rad, point), key, alignment)
        # An older key has to fit well to be taken up again; the one in use is left only later.
        return found if key is self._key or found.good else None

    def _start(self, key: Key, expected: ContactPose) -> tuple[float, complex]:
        """Return the angle and shift of a key's center that would put it at a pose."""
        turn = expected.angle_rad - key.pose.angle_rad
        lever = key.pose.point_px - key.frame.center_px
        return turn, expected.point_px - turning(turn) * lever - key.frame.center_px

    def _accept(self, found: Tracked) -> Tracked:
        self._key, self._pose = found.key, found.pose
        self._weights = found.alignment.weights
        return found
