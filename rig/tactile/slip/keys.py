"""The keyframes of a contact: when one is made, which are kept, and the map of their slopes.

These steps take long, so each is a job for a frame after the one that asked for it: a further keyframe, a map
learnt again, and the change of all keyframes to it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.types import Image
from rig.tactile.slip.alignment import Aligner, Fit, Pose, Reading
from rig.tactile.slip.gradient import Learn, LearntGradientMap
from rig.tactile.slip.height import Box, Field, contact_box
from rig.tactile.slip.keyframe import Keyframe, Source, make_keyframe
from rig.tactile.slip.loops import MOST_KEYS
from rig.tactile.slip.parameters import ALIGNMENT, KEYFRAMES
from rig.tactile.slip.search import MOST_TURN_RAD
from rig.tactile.slip.seen import Seen
from rig.tactile.slip.slopes import slope_planes

CLOSING_RAD = math.radians(5.0)
"""Starts beside the tracked angle for a direct alignment to an old keyframe."""


@dataclass(frozen=True, slots=True, eq=False)
class _Make:
    """Make a keyframe of an earlier frame, with its poses in the readings. alone: see `Fit`."""

    source: Source
    poses: list[Pose]
    alone: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Learn:
    """Learn the map at the richest keyframe."""

    source: Source


@dataclass(frozen=True, slots=True, eq=False)
class _Change:
    """Change all keyframes to a map."""

    learnt: LearntGradientMap


class Keyring:
    """The keyframes of one contact, in the order of their frames, and their poses in the readings.

    settling: whether the contact has settled, but has no keyframe yet that was made since.
    """

    def __init__(
        self,
        learn: Learn,
        aligner: Aligner,
        readings: Sequence[Reading],
        learnt: LearntGradientMap,
        key: Keyframe,
        time_s: float,
    ) -> None:
        self._learn, self._aligner, self._readings, self._map = learn, aligner, readings, learnt
        self._job: _Make | _Learn | _Change | None = None
        self._asked, self._weighed_s, self.settling = False, time_s, False
        for reading in readings:
            reading.keys.append(reading.pose)
        self._take([key])

    @property
    def richest(self) -> Keyframe:
        """The keyframe with the most texture."""
        return max(self.keys, key=lambda key: key.richness)

    @property
    def observable(self) -> bool:
        """Whether a rotation changes at least one keyframe enough."""
        return any(key.observable for key in self.keys)

    @property
    def is_idle(self) -> bool:
        """Whether no job is left, and no keyframe is asked for."""
        return self._job is None and not self._asked

    @property
    def has_work(self) -> bool:
        """Whether a job is left."""
        return self._job is not None

    def ask(self) -> None:
        """Make a keyframe of the next frame."""
        self._asked = True

    def settle(self) -> None:
        """Make a keyframe of the next frame, the first one of the settled contact."""
        self._asked = self.settling = True

    def slopes(self, difference: Field, mask: Image) -> tuple[Field, Box]:
        """Return `slope_planes` of a frame, and their box."""
        box = contact_box(mask)
        return slope_planes(difference, self._map, mask, box, ALIGNMENT.broad_share), box

    def work(self, settled: bool) -> bool | None:
        """Do the job that is left; return whether it added a keyframe, None without a job."""
        job, self._job = self._job, None
        if isinstance(job, _Make):
            return self._make(job, settled)
        if isinstance(job, _Learn):
            self._learn_map(job.source)
        elif isinstance(job, _Change):
            self._change_map(job.learnt)
        return None if job is None else False

    def consider(self, seen: Seen, fit: Fit, looked: bool, busy: bool, settled: bool) -> None:
        """Make a keyframe of a frame, later, if it is needed. looked: whether its texture is known."""
        usable = self._job is None and not seen.torn and (looked or self._asked)
        if usable and self._is_wanted(seen, fit, busy, settled):
            poses = [reading.pose for reading in self._readings]
            self._asked, self._job = False, _Make(seen.source(busy), poses, fit.alone)

    def _is_wanted(self, seen: Seen, fit: Fit, busy: bool, settled: bool) -> bool:
        """Whether a frame should become a keyframe: it is asked for, has turned far, grown, or is richer.

        A contact that has grown much fits an old keyframe best when it is turned, so that its rims meet.
        """
        nearest = min(abs(key.angle_rad - fit.angle_rad) for key in self._readings[0].keys)
        if self._asked or nearest > KEYFRAMES.further_rad:
            return True
        if settled:
            if seen.time_s - self._weighed_s < ALIGNMENT.network_s:
                return False
        elif seen.region.area_px > KEYFRAMES.grown * self.keys[-1].area_px:
            return True
        self._weighed_s = seen.time_s
        return seen.texture(busy).is_richer(KEYFRAMES.richer * self.richest.richness, seen.region.mask)

    def _make(self, job: _Make, settled: bool) -> bool:
        """Make a keyframe and return whether it is kept; the poorest one makes room."""
        key, poses = make_keyframe(job.source, self._map), job.poses
        if key is None:
            return False
        outgrown = key.area_px / (KEYFRAMES.grown if key.observable else 1.0) if self.settling else 0.0
        kept = [k for k, one in enumerate(self.keys) if one.area_px > outgrown]
        if not key.observable and any(self.keys[k].observable for k in kept):
            return False
        if settled and not job.alone:
            poses = self._close(job.source, poses)
        self.settling = False
        self._keep(kept)
        if not self.keys or key.richness > self.richest.richness:
            self._job = _Learn(job.source)
        if len(self.keys) == MOST_KEYS:
            poorest = self.keys.index(min(self.keys, key=lambda one: one.richness))
            self._keep([k for k in range(MOST_KEYS) if k != poorest])
        for reading, pose in zip(self._readings, poses, strict=True):
            reading.keys.append(pose)
        self._take([*self.keys, key])
        return True

    def _close(self, source: Source, poses: list[Pose]) -> list[Pose]:
        """Return the poses of a frame, corrected by the oldest keyframe to which it can be aligned directly.

        The errors of a chain of keyframes add up; one step from an old keyframe does not have them.
        """
        (slopes, box), first = self.slopes(source.difference, source.mask), poses[0]
        frame = slopes, box[:2], source.texture
        starts = [Pose(first.angle_rad + aside, first.point_px) for aside in (0.0, -CLOSING_RAD, CLOSING_RAD)]
        for k in range(len(self.keys)):
            fit = self._aligner.directly(k, frame, self._readings[0], starts)
            if fit.rank >= ALIGNMENT.closing_rank:
                by = fit.pose.since(first)
                far = abs(by.angle_rad) > MOST_TURN_RAD
                if far or fit.rank < self._aligner.at(first).rank + ALIGNMENT.closing_gain:
                    return poses
                for reading in self._readings:
                    reading.move(by)
                return [pose.moved(by) for pose in poses]
        return poses

    def _keep(self, kept: list[int]) -> None:
        """Forget the other keyframes."""
        self.keys = [self.keys[k] for k in kept]
        for reading in self._readings:
            reading.keys = [reading.keys[k] for k in kept]

    def _learn_map(self, source: Source) -> None:
        learnt = self._learn(source.difference, source.mask)
        self._job = None if learnt is None else _Change(learnt)

    def _change_map(self, learnt: LearntGradientMap) -> None:
        self._map = learnt
        self._take([key.with_map(learnt) for key in self.keys])

    def _take(self, keys: list[Keyframe]) -> None:
        self.keys = keys
        self._aligner.take(keys)
