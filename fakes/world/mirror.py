"""Copy the state of the world: a mirror for the process that renders the cameras, and a track of motions."""

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
"""Number of snapshots kept: two seconds at 250 per second."""
KEPT_SAMPLES = 50_000
"""Number of samples of a track kept: three minutes of motion at 250 per second."""
STILL_M_S = 0.001
"""Speed below which the tool counts as at rest."""
PATIENCE_S = 0.1
"""Longest wait for a snapshot; a late frame is better than one that shows an earlier state."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The world at one instant, small enough to be sent 250 times per second.

    tool: base_T_tcp. object_id, site: id of the placed object, and index of its grasp site that is held; None
    if there is none. off_m: as in `Grasp`. fixture: the mounted calibration target. seed: of the lift's
    variation.
    """

    state: WorldState
    tool: Pose
    object_id: str | None
    site: int | None
    off_m: tuple[float, float]
    fixture: Fixture | None
    seed: int

    @property
    def grasp(self) -> Grasp | None:
        if self.object_id is None or self.site is None:
            return None
        return Grasp(find_object(self.object_id).sites[self.site], self.off_m)


def snapshot_of(world: World, time_ns: int) -> Snapshot:
    """Advance the world to `time_ns`, and return the snapshot that the cameras need."""
    state = world.state_at(time_ns)
    model, site = world.model, world.site
    number = model.sites.index(site) if model is not None and site is not None else None
    off_m = world.grasp.off_m if world.grasp else (0.0, 0.0)
    # Over the wire protocol a path lasts one control cycle, so the orientation of its end is accurate enough.
    tool = Pose(world.tool.position_at(state.time_ns), world.tool.end.quaternion_xyzw)
    return Snapshot(state, tool, model.id if model else None, number, off_m, world.fixture, world.seed)


class MirroredWorld:
    """Implements the part of `World` that `FakeDigit` and `FakeCamera` use, from snapshots of a world.

    patience_s: longest wait for a snapshot, on the computer's clock.
    """

    def __init__(self, layout: BenchLayout, first: Snapshot, patience_s: float = PATIENCE_S) -> None:
        self.layout, self._patience_s = layout, patience_s
        self._arrived = threading.Condition()
        self._snapshots: deque[Snapshot] = deque(maxlen=KEPT)
        self.seed = -1  # seeds are not negative
        self.feed(first)

    def feed(self, snapshot: Snapshot) -> None:
        """Add the next snapshot; times must increase."""
        with self._arrived:
            self._snapshots.append(snapshot)
            if snapshot.seed != self.seed:
                self.seed = snapshot.seed
                self.variation = LiftVariation.from_rng(np.random.default_rng(self.seed))
            self._arrived.notify_all()

    @property
    def grasp(self) -> Grasp | None:
        """The grasp of the held object in the newest snapshot; None if nothing is held."""
        return self._snapshots[-1].grasp

    @property
    def fixture(self) -> Fixture | None:
        """The mounted calibration target; None if there is none."""
        return self._snapshots[-1].fixture

    def state_at(self, time_ns: int) -> WorldState:
        """Return the state at `time_ns`; if it does not arrive in time, the newest state."""
        return _state(*self._around(time_ns), time_ns)

    def object_pose_at(self, time_ns: int) -> Pose:
        before, after = self._around(time_ns)
        tool_m = _tool(before, after, time_ns).position_m
        state = _state(before, after, time_ns)
        return object_pose(self.layout, self.variation, after.grasp, state, tool_m)

    def tool_pose_at(self, time_ns: int) -> Pose:
        return _tool(*self._around(time_ns), time_ns)

    def _around(self, time_ns: int) -> tuple[Snapshot, Snapshot]:
        """Return the snapshots before and after a time; the same one twice at either end."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._snapshots[-1].state.time_ns >= time_ns, self._patience_s)
            after = self._snapshots[-1]
            for before in reversed(self._snapshots):
                if before.state.time_ns <= time_ns:
                    return (before, after) if after.state.time_ns > time_ns else (after, after)
                after = before
            return after, after


WorldView = World | MirroredWorld
"""Types of world that the simulated cameras can show."""


def _state(before: Snapshot, after: Snapshot, time_ns: int) -> WorldState:
    return after.state if before is after else between(before.state, after.state, time_ns)


def _tool(before: Snapshot, after: Snapshot, time_ns: int) -> Pose:
    """Return the TCP between two snapshots a few ms apart, with the orientation of the later one."""
    if before is after:
        return after.tool
    share = (time_ns - before.state.time_ns) / (after.state.time_ns - before.state.time_ns)
    x, y, z = (
        a + share * (b - a) for a, b in zip(before.tool.position_m, after.tool.position_m, strict=True)
    )
    return Pose((x, y, z), after.tool.quaternion_xyzw)


TrackSample = tuple[int, float, float, float, float, bool]
"""Time in ns, tool x y z in m, finger position in counts, whether the object is held."""


@dataclass(slots=True)
class Track:
    """Samples of the tool and the fingers; while nothing changes, no samples are added."""

    samples: deque[TrackSample] = field(default_factory=lambda: deque(maxlen=KEPT_SAMPLES))
    moving: bool = False
    _last: TrackSample | None = None

    def see(self, time_ns: int, tool_m: Vector3, counts: float, held: bool) -> None:
        """Add the state at a time; times must increase."""
        new = (time_ns, *tool_m, counts, held)
        last, self._last = self._last, new
        if last is None:
            self.samples.append(new)
        elif time_ns > last[0]:
            way_m = float(np.linalg.norm(np.subtract(tool_m, last[1:4])))
            self.moving = way_m > STILL_M_S * (time_ns - last[0]) / NS_PER_S
            if new[1:] != last[1:]:
                if self.samples[-1] != last:
                    self.samples.append(last)  # the end of the time without change
                self.samples.append(new)

    def since(self, time_ns: int) -> list[TrackSample]:
        """Return the samples from the last one before a time on, and the current one."""
        kept = list(self.samples)
        first = next((i for i in range(len(kept) - 1, 0, -1) if kept[i][0] <= time_ns), 0)
        now = [self._last] if self._last is not None and kept[-1] != self._last else []
        return kept[first:] + now
