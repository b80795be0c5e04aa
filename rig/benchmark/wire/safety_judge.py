"""Whether what moved after an event was agreed to, by the true track."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from protocols.safe_end import REACH_M
from protocols.steps import CLEARANCE_M
from rig.benchmark.wire.moments import Stage
from rig.benchmark.wire.safety_events import After, Event
from rig.benchmark.wire.true_track import Standstill, TrueState, at, carried, dropped, standstill

MOVED_M = 0.001
LINE_M = 0.002
"""How far from the line above the grasp the tool is beside it."""
BOUNDARY_M = 0.005
"""Around the height at which a hand counts as free, either end is right."""
COUNTS = 1.5
"""Fingers that are further away have moved."""
FINGERS_REST_S = 0.1


@dataclass(frozen=True, slots=True)
class Judged:
    """What came of an event. unasked: what moved though nobody had agreed, in words, or nothing."""

    stop: Standstill
    dropped: bool
    unasked: str


def judge(event: Event, stage: Stage, track: Sequence[TrueState], event_ns: int, grasp_m: float) -> Judged:
    """Judge what happened after an event. stage: of the lift at the event. grasp_m: height of the tool."""
    stop = standstill(track, event_ns)
    unasked = _unasked(event, track, stop, grasp_m)
    if not unasked and carried(track, grasp_m, set_down=stage is Stage.RELEASE):
        unasked = "the object was carried"
    return Judged(stop, dropped(track, grasp_m), unasked)


def _unasked(event: Event, track: Sequence[TrueState], stop: Standstill, grasp_m: float) -> str:
    there, later = at(track, stop.time_ns), [s for s in track if s.time_ns > stop.time_ns]
    high_m = there.tool_m[2] - grasp_m - REACH_M
    if event.after is After.STAYS:
        return _arm_moved(there, later) or _fingers_moved(event, track, stop)
    if event.after is After.SAFE_END:
        if not there.held and high_m > BOUNDARY_M and (moved := _arm_moved(there, later)):
            return moved
        if any(state.counts > there.counts + COUNTS for state in later):
            return "fingers closed"
    return _left_the_line(later, grasp_m)


def _arm_moved(there: TrueState, later: Sequence[TrueState]) -> str:
    way_m = max((math.dist(state.tool_m, there.tool_m) for state in later), default=0.0)
    return f"the arm moved by {1e3 * way_m:.1f} mm" if way_m > MOVED_M else ""


def _fingers_moved(event: Event, track: Sequence[TrueState], stop: Standstill) -> str:
    """Fingers under way when it happens go on to where they were sent; after that they rest.

    Those around something that they do not hold may open after a fault of the arm.
    """
    rests = _fingers_rest(track, stop.time_ns)
    way = [state.counts - rests.counts for state in track if state.time_ns > rests.time_ns]
    opened = event.fault is not None and not rests.held
    if max(way, default=0.0) > COUNTS or (min(way, default=0.0) < -COUNTS and not opened):
        return f"the fingers moved by {max(way, key=abs):+.0f} counts"
    return ""


def _fingers_rest(track: Sequence[TrueState], since_ns: int) -> TrueState:
    """How things were when the fingers first had rested for a while."""
    rests = at(track, since_ns)
    for state in track:
        if state.time_ns <= since_ns:
            continue
        if state.time_ns - max(rests.time_ns, since_ns) > FINGERS_REST_S * 1e9:
            break
        if abs(state.counts - rests.counts) > 1e-6:
            rests = state
    return rests


def _left_the_line(later: Sequence[TrueState], grasp_m: float) -> str:
    """Below the height of the approach the tool moves up and down on one line, and not below the grasp."""
    low = [state for state in later if state.tool_m[2] < grasp_m + CLEARANCE_M - BOUNDARY_M]
    if any(math.dist(state.tool_m[:2], low[0].tool_m[:2]) > LINE_M for state in low):
        return "the arm moved sideways beside the object"
    if any(state.tool_m[2] < grasp_m - MOVED_M for state in low):
        return "the arm moved below the grasp"
    return ""
