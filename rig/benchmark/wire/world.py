"""What the world of simulated devices reports in real time: the stages of a lift, and its true motion."""

import math
import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any, TypeVar

from drivers.clock import NS_PER_S, to_ns
from drivers.errors import DeviceError
from drivers.types import Vector3

POLL_S = 0.004
LEVEL_M = 0.0015
"""A tool this near the grasp's height is at the grasp."""
TRIES = 3

Result = TypeVar("Result")


class Stage(StrEnum):
    """Stages of a lift, as an observer sees them in the motions of arm and hand."""

    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    HOLD = "hold"
    LOWER = "lower"
    RELEASE = "release"


LASTS_S = {
    Stage.APPROACH: 1.4,
    Stage.GRASP: 3.2,
    Stage.LIFT: 1.3,
    Stage.HOLD: 1.1,
    Stage.LOWER: 0.35,
    Stage.RELEASE: 0.6,
}
"""Shortest duration of each stage, approximately."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time after the beginning of a stage, s."""

    stage: Stage
    after_s: float


def random_moment(stage: Stage, rng: random.Random) -> Moment:
    """Draw a moment of a stage."""
    return Moment(stage, rng.uniform(0.0, LASTS_S[stage]))


class StageWatch:
    """Follows a lift by the simulated world. grasp_m: height of the tool that grasps."""

    def __init__(self, grasp_m: float) -> None:
        self._grasp_m = grasp_m
        self.stage: Stage | None = None

    def see(self, world: Mapping[str, Any]) -> Stage | None:
        """Return the stage of the lift in the world's current state, None before the first motion."""
        low, moving = world["tool_m"][2] - self._grasp_m < LEVEL_M, world["tool_moving"]
        match self.stage:
            case None if moving:
                self.stage = Stage.APPROACH
            case Stage.APPROACH if low and not moving:
                self.stage = Stage.GRASP
            case Stage.GRASP if world["held"] and moving and not low:
                self.stage = Stage.LIFT
            case Stage.LIFT if not moving:
                self.stage = Stage.HOLD
            case Stage.HOLD if moving:
                self.stage = Stage.LOWER
            case Stage.LOWER if low:
                self.stage = Stage.RELEASE
        return self.stage


def wait_for(
    moment: Moment,
    grasp_m: float,
    world: Callable[[], Mapping[str, Any]],
    over: Callable[[], bool],
) -> Stage | None:
    """Wait for a moment of the next lift; return the stage at that time, None if the lift ended before it.

    world: returns the state of the simulated world. over: whether the lift has ended.
    """
    watch, began_ns = StageWatch(grasp_m), 0
    while not over():
        now = world()
        stage = watch.see(now)
        if stage is moment.stage and not began_ns:
            began_ns = now["now_ns"]
        if began_ns and now["now_ns"] - began_ns >= to_ns(moment.after_s):
            return stage
        time.sleep(POLL_S)
    return None


def bench_ns(call: Callable[..., Mapping[str, Any]]) -> int:
    """Return the time of the system clock of running fakes and their bench, ns. call: as in `read_track`."""
    now = call("world")
    return now["start_ns"] + now["now_ns"]


def let_pass(call: Callable[..., Mapping[str, Any]], duration_s: float) -> None:
    """Wait for a time of the clock of running fakes. call: as in `read_track`."""
    end_ns = bench_ns(call) + to_ns(duration_s)
    while bench_ns(call) < end_ns:
        time.sleep(POLL_S)


def tried(do: Callable[[], Result], before_again: Callable[[], str] = lambda: "") -> Result:
    """Return what `do` returns; repeat it if it raises `DeviceError`, as real-time runs do on a loaded host.

    before_again: puts the bench in order; it returns the reason if that is impossible, and nothing is
    repeated then. Raises the `DeviceError` of the last of three tries.
    """
    for _ in range(TRIES - 1):
        try:
            return do()
        except DeviceError:
            if before_again():
                raise
    return do()


STILL_M_S = 0.001
REST_NS = to_ns(0.003)
"""A tool slower than `STILL_M_S` for this time has come to a standstill: a safe end moves it on at once."""
ABOVE_M = 0.003
"""An object released higher than this above its place falls."""


@dataclass(frozen=True, slots=True)
class TrueState:
    """State at a time, monotonic ns: tool in the base frame in m, finger position in counts, object held."""

    time_ns: int
    tool_m: Vector3
    counts: float
    held: bool


@dataclass(frozen=True, slots=True)
class Standstill:
    """The first standstill after an event. after_s: 0 if the tool stood. way_m: distance since the event."""

    time_ns: int
    after_s: float
    way_m: float


def read_track(call: Callable[..., Mapping[str, Any]], since_ns: int) -> list[TrueState]:
    """Read the states since a time from running fakes, oldest first; each holds until the next.

    call: of their side channel (`rig.bench.fakes_process.fakes_control`).
    """
    return [
        TrueState(time_ns, (x, y, z), counts, held)
        for time_ns, x, y, z, counts, held in call("track", since_ns=since_ns)["samples"]
    ]


def standstill(track: Sequence[TrueState], event_ns: int) -> Standstill:
    """Return when the tool first stood after an event, and how far it had moved."""
    there = at(track, event_ns)
    stood = there
    for before, after in pairwise(track):
        if after.time_ns <= event_ns:
            continue
        if _speed_m_s(before, after) > STILL_M_S:
            stood = after
        elif after.time_ns - max(stood.time_ns, event_ns) >= REST_NS:
            break
    after_s = max(0, stood.time_ns - event_ns) / NS_PER_S
    return Standstill(max(stood.time_ns, event_ns), after_s, math.dist(there.tool_m, stood.tool_m))


def at(track: Sequence[TrueState], time_ns: int) -> TrueState:
    """Return the state at a time."""
    return next((state for state in reversed(track) if state.time_ns <= time_ns), track[0])


def dropped(track: Sequence[TrueState], grasp_m: float) -> bool:
    """Whether the object was released above its place, where the tool grasps it at a height of `grasp_m`."""
    return any(
        before.held and not after.held and before.tool_m[2] > grasp_m + ABOVE_M
        for before, after in pairwise(track)
    )


def carried(track: Sequence[TrueState], grasp_m: float, set_down: bool = False) -> bool:
    """Whether the tool rose with the object after it had set the object down at the grasp's height.

    set_down: whether the object was set down when the track begins.
    """
    was_up = was_down = set_down
    for state in track:
        above_m = state.tool_m[2] - grasp_m
        if not state.held:
            was_up = was_down = False
        elif above_m > ABOVE_M:
            if was_down:
                return True
            was_up = True
        elif above_m < ABOVE_M / 2:
            was_down = was_up
    return False


def _speed_m_s(before: TrueState, after: TrueState) -> float:
    lasts_s = max(after.time_ns - before.time_ns, 1) / NS_PER_S
    return math.dist(before.tool_m, after.tool_m) / lasts_s
