"""Copies of the world's state: a mirror for the process that draws the cameras, and a track of motions."""

import threading
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Pose, Vector3
from fakes.objects.catalogue import find_object
from fakes.world.fixture import Fixture
from fakes.world.state import BenchLayout, Grasp, LiftVariation, WorldState, between, object_pose
from fakes.world.world import World

KEPT = 512
"""Snapshots kept: two seconds at 250 a second."""
PATIENCE_S = 0.1
"""A frame that comes late is better than one that shows an earlier state as its own."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The world at one instant, small enough to be sent 250 times a second.

    tool: the TCP in base. object_id, site: the grasp site that is held, None without one. off_m: as
    in `Grasp`. fixture: the calibration target that is mounted. seed: of this lift's peculiarities.
    """

    state: WorldState
    tool: Pose
    object_id: str | None
    site: int | None
    off_m: tuple[float, float]
    fixture: Fixture | None
    seed: int


def snapshot_of(world: World, time_ns: int) -> Snapshot:
    """Advance the world to `time_ns` and return what the cameras need of it."""
    state = world.state_at(time_ns)
    model, site = world.model, world.site
    number = model.sites.index(site) if model is not None and site is not None else None
    off_m = world.grasp.off_m if world.grasp else (0.0, 0.0)
    # behind a wire a path is one control cycle long: its end's turn will do, and costs nothing
    tool = Pose(world.tool.position_at(state.time_ns), world.tool.end.quaternion_xyzw)
    return Snapshot(state, tool, model.id if model else None, number, off_m, world.fixture, world.seed)


class MirroredWorld:
    """What `FakeDigit` and `FakeCamera` need of a `World`, fed with snapshots of one."""

    def __init__(self, layout: BenchLayout, first: Snapshot) -> None:
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
    def variation(self) -> LiftVariation:
        """The present lift's peculiarities."""
        return self._drawn[1]

    @property
    def grasp(self) -> Grasp | None:
        """How the object is held, the same value each time."""
        return _grasp(self._snapshots[-1])

    @property
    def fixture(self) -> Fixture | None:
        """The calibration target that is mounted, if any."""
        return self._snapshots[-1].fixture

    def state_at(self, time_ns: int) -> WorldState:
        """The world at `time_ns`; waits for it briefly, then returns the newest one."""
        before, after = self._around(time_ns)
        if before is after:
            return after.state
        return between(before.state, after.state, time_ns)

    def object_pose_at(self, time_ns: int) -> Pose:
        """`base_T_object` at `time_ns`, as `World.object_pose_at`."""
        before, after = self._around(time_ns)
        state = after.state if before is after else between(before.state, after.state, time_ns)
        tool_m = _tool(before, after, time_ns).position_m
        return object_pose(self.layout, self.variation, _grasp(after), state, tool_m)

    def tool_pose_at(self, time_ns: int) -> Pose:
        """`base_T_tcp` at `time_ns`, as `World.tool_pose_at`."""
        return _tool(*self._around(time_ns), time_ns)

    def _around(self, time_ns: int) -> tuple[Snapshot, Snapshot]:
        """The snapshots before and after a time; twice the same one at either end."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._snapshots[-1].state.time_ns >= time_ns, PATIENCE_S)
            after = self._snapshots[-1]
            for before in reversed(self._snapshots):
                if before.state.time_ns <= time_ns:
                    return (before, after) if after.state.time_ns > time_ns else (after, after)
                after = before
            return after, after


def _draw(seed: int) -> LiftVariation:
    return LiftVariation.from_rng(np.random.default_rng(seed))


def _grasp(snapshot: Snapshot) -> Grasp | None:
    if snapshot.object_id is None or snapshot.site is None:
        return None
    return Grasp(find_object(snapshot.object_id).sites[snapshot.site], snapshot.off_m)


def _tool(before: Snapshot, after: Snapshot, time_ns: int) -> Pose:
    """The TCP between two snapshots a few ms apart; the turn between them is that of the later one."""
    if before is after:
        return after.tool
    share = (time_ns - before.state.time_ns) / (after.state.time_ns - before.state.time_ns)
    x, y, z = (
        a + share * (b - a) for a, b in zip(before.tool.position_m, after.tool.position_m, strict=True)
    )
    return Pose((x, y, z), after.tool.quaternion_xyzw)


STILL_M_S = 0.001
"""Slower than this is standing still."""
KEPT = 50_000
"""Samples kept: three minutes of motion at 250 a second."""

TrackSample = tuple[int, float, float, float, float, bool]
"""ns of the world's time, tool x y z in m, counts of the fingers, whether the object is held."""


@dataclass(slots=True)
class Track:
    """Samples from where something changed; nothing is added while all stands still."""

    samples: deque[TrackSample] = field(default_factory=lambda: deque(maxlen=KEPT))
    moving: bool = False
    _last: TrackSample | None = None

    def see(self, time_ns: int, tool_m: Vector3, counts: float, held: bool) -> None:
        """Take how things are at a time; times increase."""
        new = (time_ns, *tool_m, counts, held)
        last, self._last = self._last, new
        if last is None:
            self.samples.append(new)
        elif time_ns > last[0]:
            way_m = float(np.linalg.norm(np.subtract(tool_m, last[1:4])))
            self.moving = way_m > STILL_M_S * (time_ns - last[0]) / NS_PER_S
            if new[1:] != last[1:]:
                if self.samples[-1] != last:
                    self.samples.append(last)  # until then nothing had changed
                self.samples.append(new)

    def since(self, time_ns: int) -> list[TrackSample]:
        """Return the samples from the last one before a time on, and how things are now."""
        kept = list(self.samples)
        first = next((i for i in range(len(kept) - 1, 0, -1) if kept[i][0] <= time_ns), 0)
        now = [self._last] if self._last is not None and kept[-1] != self._last else []
        return kept[first:] + now
