"""True motion of a simulated bench behind the wire protocols, from the track that its world keeps."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from drivers.clock import NS_PER_S, to_ns
from drivers.types import Vector3

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
