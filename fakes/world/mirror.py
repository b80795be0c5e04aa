"""Copy the state of the world: a mirror for the process that renders the cameras, and a track of motions."""

import threading
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.clock import NS_PER_S
from drivers.types import Pose, Vector3
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

    tool: base_T_tcp. fixture: the mounted calibration target. seed: of the lift's variation.
    """

    state: WorldState
    tool: Pose
    grasp: Grasp | None
    fixture: Fixture | None
    seed: int


def snapshot_of(world: World, time_ns: int) -> Snapshot:
    """Advance the world to `time_ns`, and return the snapshot that the cameras need."""
    state = world.state_at(time_ns)
    # Over the wire protocol a path lasts one control cycle, so the orientation of its end is accurate enough.
    tool = Pose(world.tool.position_at(state.time_ns), world.tool.end.quaternion_xyzw)
    return Snapshot(state, tool, world.grasp, world.fixture, world.seed)


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
        return self._at(time_ns).state

    def object_pose_at(self, time_ns: int) -> Pose:
        now = self._at(time_ns)
        return object_pose(self.layout, self.variation, now.grasp, now.state, now.tool.position_m)

    def tool_pose_at(self, time_ns: int) -> Pose:
        return self._at(time_ns).tool

    def _at(self, time_ns: int) -> Snapshot:
        """Return the world at a time, interpolated between two snapshots a few ms apart.

        The tool has the orientation of the later one. Before the first and after the last snapshot the world
        does not change.
        """
        with self._arrived:
            self._arrived.wait_for(lambda: self._snapshots[-1].state.time_ns >= time_ns, self._patience_s)
            before = after = self._snapshots[-1]
            for before in reversed(self._snapshots):
                if before.state.time_ns <= time_ns:
                    break
                after = before
        if not before.state.time_ns <= time_ns < after.state.time_ns:
            return after
        share = (time_ns - before.state.time_ns) / (after.state.time_ns - before.state.time_ns)
        ends = zip(before.tool.position_m, after.tool.position_m, strict=True)
        x, y, z = (a + share * (b - a) for a, b in ends)
        tool = Pose((x, y, z), after.tool.quaternion_xyzw)
        return replace(after, state=between(before.state, after.state, time_ns), tool=tool)


WorldView = World | MirroredWorld
"""Types of world that the simulated cameras can show."""


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
