"""The world as another process sees it: for the cameras, which are drawn where there is a core free."""

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.types import Pose, Vector3
from fakes.catalogue import GraspSite, find_object
from fakes.moment import Draw, Layout, Moment, between, object_pose
from fakes.world import World

KEPT = 512
"""Snapshots kept: two seconds at 250 a second."""
PATIENCE_S = 0.1
"""A frame that comes late is better than one that shows an older moment as its own."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The world at one moment, small enough to be sent 250 times a second.

    tool_m: the TCP in base. object_id, site: the grasp site that is held, None without one.
    seed: of the peculiarities of this lift.
    """

    moment: Moment
    tool_m: Vector3
    object_id: str | None
    site: int | None
    seed: int


def snapshot_of(world: World, time_ns: int) -> Snapshot:
    """Advance the world to `time_ns` and return what the cameras need of it."""
    moment = world.moment_at(time_ns)
    model, site = world.model, world.site
    number = model.sites.index(site) if model is not None and site is not None else None
    return Snapshot(
        moment, world.tool.position_at(moment.time_ns), model.id if model else None, number, world.seed
    )


class MirroredWorld:
    """What `FakeDigit` and `FakeCamera` need of a `World`, fed with snapshots of one."""

    def __init__(self, layout: Layout, first: Snapshot) -> None:
        self.layout = layout
        self._arrived = threading.Condition()
        self._snapshots: deque[Snapshot] = deque([first], maxlen=KEPT)
        self._drawn = (first.seed, _draw(first.seed))

    def feed(self, snapshot: Snapshot) -> None:
        """Take the next snapshot; times increase."""
        with self._arrived:
            self._snapshots.append(snapshot)
            if snapshot.seed != self._drawn[0]:
                self._drawn = (snapshot.seed, _draw(snapshot.seed))
            self._arrived.notify_all()

    @property
    def seed(self) -> int:
        """Seed of the present lift's peculiarities."""
        return self._drawn[0]

    @property
    def draw(self) -> Draw:
        """The present lift's peculiarities."""
        return self._drawn[1]

    @property
    def site(self) -> GraspSite | None:
        """The grasp site that is held, the same value each time."""
        return _site(self._snapshots[-1])

    def moment_at(self, time_ns: int) -> Moment:
        """The world at `time_ns`; waits a moment for it, then gives the newest one."""
        before, after = self._around(time_ns)
        if before is after:
            return after.moment
        return between(before.moment, after.moment, time_ns)

    def object_pose_at(self, time_ns: int) -> Pose:
        """`base_T_object` at `time_ns`, as `World.object_pose_at`."""
        before, after = self._around(time_ns)
        moment, tool_m = after.moment, after.tool_m
        if before is not after:
            moment = between(before.moment, after.moment, time_ns)
            share = (time_ns - before.moment.time_ns) / (after.moment.time_ns - before.moment.time_ns)
            x, y, z = (a + share * (b - a) for a, b in zip(before.tool_m, after.tool_m, strict=True))
            tool_m = (x, y, z)
        return object_pose(self.layout, self.draw, _site(after), moment, tool_m)

    def _around(self, time_ns: int) -> tuple[Snapshot, Snapshot]:
        """The snapshots before and after a time; twice the same one at either end."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._snapshots[-1].moment.time_ns >= time_ns, PATIENCE_S)
            after = self._snapshots[-1]
            for before in reversed(self._snapshots):
                if before.moment.time_ns <= time_ns:
                    return (before, after) if after.moment.time_ns > time_ns else (after, after)
                after = before
            return after, after


def _draw(seed: int) -> Draw:
    return Draw.from_rng(np.random.default_rng(seed))


def _site(snapshot: Snapshot) -> GraspSite | None:
    if snapshot.object_id is None or snapshot.site is None:
        return None
    return find_object(snapshot.object_id).sites[snapshot.site]
