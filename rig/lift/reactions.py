"""Evaluate a lift's reactions to slip: from the steps taken to the stored records."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from drivers.clock import NS_PER_S
from protocols.observer import ReactionStep
from rig.lift.marker_truth import TruthSeries, interpolate
from rig.lift.onset import departure_ns
from rig.lift.slip_watch import SlipEvent, SlipWatch
from rig.sessions.records import ReactionRecord, SlipThreshold

Step = tuple[ReactionStep, int, int]
LAST = (ReactionStep.REST, ReactionStep.ENDS)
REST_NS = 100_000_000
"""Length of the interval before a reaction over which the true angle at rest is averaged."""
FRAME_NS = 50_000_000
"""Time within which a camera frame shows what has happened (contract: longer gaps have no truth)."""


def reaction_records(watch: SlipWatch, truth: TruthSeries, lift_ns: int) -> tuple[ReactionRecord, ...]:
    """Return a record of each reaction of a lift.

    truth: since the zero. lift_ns: when phase B began.
    """
    reactions = list(_reactions(watch.steps))
    began_ns = [lift_ns, *(steps[-1][1] for steps in reactions)]
    return tuple(
        _record(steps, _event(watch.events, *span), truth, lift_ns, span)
        for steps, span in zip(reactions, pairwise(began_ns), strict=True)
    )


def slip_thresholds(watch: SlipWatch) -> dict[str, SlipThreshold]:
    """Return the thresholds of angle and rate at which each fingertip reports a slip, by serial."""
    return {serial: SlipThreshold(*values) for serial, values in watch.thresholds().items()}


def _reactions(steps: Sequence[Step]) -> Iterator[list[Step]]:
    """Yield the steps of each completed reaction."""
    taken: list[Step] = []
    for step in steps:
        taken.append(step)
        if step[0] in LAST:
            yield taken
            taken = []


def _event(events: Sequence[SlipEvent], since_ns: int, until_ns: int) -> SlipEvent | None:
    return next((event for event in events if since_ns <= event.due_ns <= until_ns), None)


def _record(
    steps: Sequence[Step], event: SlipEvent | None, truth: TruthSeries, lift_ns: int, span: tuple[int, int]
) -> ReactionRecord:
    (_, command_ns, position), (last, end_ns, end_position) = steps[0], steps[-1]
    onset_ns = _onset_ns(truth, *span)
    event_ns = None if event is None else event.raised_ns
    still_ns = max(t for s, t, _ in steps if s in (ReactionStep.STANDS, ReactionStep.CLOSED))
    rest_ns = end_ns if last is ReactionStep.REST else None
    return ReactionRecord(
        serial=None if event is None else event.serial,
        onset_s=_since(onset_ns, lift_ns),
        event_s=_since(event_ns, lift_ns),
        command_s=(command_ns - lift_ns) / NS_PER_S,
        standstill_s=(still_ns - lift_ns) / NS_PER_S,
        rest_s=_since(rest_ns, lift_ns),
        counts_added=end_position - position,
        onset_turn_deg=_turn(truth, onset_ns),
        event_turn_deg=_turn(truth, event_ns),
        command_turn_deg=_turn(truth, command_ns),
        standstill_turn_deg=_turn(truth, still_ns),
        rest_turn_deg=_turn(truth, rest_ns),
    )


def _onset_ns(truth: TruthSeries, since_ns: int, until_ns: int) -> int | None:
    """Return when the object had rotated 0.5 degrees from its rest before, within a span."""
    before = (truth.time_ns <= since_ns) & (truth.time_ns > since_ns - REST_NS)
    rest_deg = float(np.mean(truth.angle_deg[before])) if before.any() else 0.0
    during = (truth.time_ns > since_ns) & (truth.time_ns <= until_ns + FRAME_NS)
    return departure_ns(truth.time_ns[during], truth.angle_deg[during], rest_deg)


def _turn(truth: TruthSeries, time_ns: int | None) -> float | None:
    return None if time_ns is None else interpolate(truth, time_ns)


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S
