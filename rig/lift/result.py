"""Evaluate a measured lift, with its reactions to slip, to the row and the records that are stored."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from calibration.time_offset import FEWEST, TimedSignal, time_offset
from drivers.clock import NS_PER_S, to_ns
from protocols.observer import Phase, ReactionStep
from rig.lift.measurement import LiftMeasurement, distance_warning
from rig.lift.object_angle import ZERO_S, Disagreement
from rig.lift.onset import departure_ns, estimated_onset_ns, slip_onset_ns
from rig.lift.slip_watch import CAUGHT_DEG, SlipEvent, SlipWatch
from rig.results.scores import score_angles
from rig.sessions.records import (
    ClockLag,
    Lift,
    LiftOutcome,
    ReactionRecord,
    SlipThreshold,
    StageTimes,
    TurnsAgainst,
)
from rig.tactile.angles import FUSED, MARKERS, Angles
from rig.tactile.sample import SlipSample, State, faults_of

LEAST_TURN_DEG = 5.0
"""Least range of both angles over a lift; over less, noise and drift may correlate."""
OPPOSED = -0.9
"""Correlation with the true angle below which an angle turns against it."""
WORST_SIGMA_MS = 15.0
"""Largest standard deviation of a lag that is considered."""


def turns_against(tips: Mapping[str, Angles], truth: Angles) -> TurnsAgainst | None:
    """Return which fingertips turn against the true angle over a lift; None if none does.

    tips: signed angles since the zero during the lift, by serial; their `zero_ns` is that of `truth`.
    """
    found = {serial: ends for serial, angles in tips.items() if (ends := _opposed(angles, truth))}
    if not found:
        return None
    estimate_deg, truth_deg = max(found.values(), key=lambda ends: abs(ends[0]))
    return TurnsAgainst(tuple(found), len(found) == len(tips) > 1, estimate_deg, truth_deg)


def clock_lag(angles: Angles, truth: Angles) -> ClockLag | None:
    """Return by how much the estimate is late compared with the true angle.

    None if it cannot be determined, because one of them turns too little or otherwise.
    angles: the fused estimate during the lift.
    """
    known = angles.known
    times, first = np.unique(known.time_ns, return_index=True)  # two fingertips may have the same times
    estimate = TimedSignal(times, known.angle_deg[first])
    true = TimedSignal(truth.time_ns, truth.angle_deg)
    if any(len(s.time_ns) < FEWEST or np.ptp(s.values) < LEAST_TURN_DEG for s in (estimate, true)):
        return None
    found = time_offset(true, estimate, worst_ms=WORST_SIGMA_MS)
    if found.offset_s is None or found.sigma_s is None or not found.gain or found.gain < 0.0:
        return None
    return ClockLag(-found.offset_s, found.sigma_s)


def _opposed(angles: Angles, truth: Angles) -> tuple[float, float] | None:
    """Return the last angle and the last true angle if both turn far enough in opposite directions."""
    ours, true = angles.angle_deg, truth.at(angles.time_s)
    both = np.isfinite(ours) & np.isfinite(true)
    ours, true = ours[both], true[both]
    if len(ours) < FEWEST or min(np.ptp(ours), np.ptp(true)) < LEAST_TURN_DEG:
        return None
    return (float(ours[-1]), float(true[-1])) if np.corrcoef(ours, true)[0, 1] <= OPPOSED else None


Step = tuple[ReactionStep, int, int]
LAST = (ReactionStep.REST, ReactionStep.ENDS)
REST_NS = 100_000_000
"""Length of the interval before a reaction over which the true angle at rest is averaged."""
FRAME_NS = 50_000_000
"""Longest time between an event and the camera frame that shows it (contract: longer gaps have no truth)."""


def reaction_records(watch: SlipWatch, truth: Angles, lift_ns: int) -> tuple[ReactionRecord, ...]:
    """Return a record of each reaction of a lift.

    truth: since the zero. lift_ns: when phase B began.
    """
    reactions = list(_reactions(watch.steps))
    began_ns = [lift_ns, *(steps[-1][1] for steps in reactions)]
    return tuple(
        _record(steps, watch.events, truth, lift_ns, span)
        for steps, span in zip(reactions, pairwise(began_ns), strict=True)
    )


def _reactions(steps: Sequence[Step]) -> Iterator[list[Step]]:
    """Yield the steps of each completed reaction."""
    taken: list[Step] = []
    for step in steps:
        taken.append(step)
        if step[0] in LAST:
            yield taken
            taken = []


def _record(
    steps: Sequence[Step], events: Sequence[SlipEvent], truth: Angles, lift_ns: int, span: tuple[int, int]
) -> ReactionRecord:
    (_, command_ns, position), (last, end_ns, end_position) = steps[0], steps[-1]
    onset_ns = _onset_ns(truth, *span)
    event = next((event for event in events if span[0] <= event.due_ns <= span[1]), None)
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


def _onset_ns(truth: Angles, since_ns: int, until_ns: int) -> int | None:
    """Return when the object had rotated 0.5 degrees from its rest before, within a span."""
    before = (truth.time_ns <= since_ns) & (truth.time_ns > since_ns - REST_NS)
    rest_deg = float(np.mean(truth.angle_deg[before])) if before.any() else 0.0
    during = (truth.time_ns > since_ns) & (truth.time_ns <= until_ns + FRAME_NS)
    return departure_ns(truth.time_ns[during], truth.angle_deg[during], rest_deg)


def _turn(truth: Angles, time_ns: int | None) -> float | None:
    return None if time_ns is None else truth.at_ns(time_ns)


FINAL_S = 0.3
"""Length of the interval at the end over which final angles are averaged, s."""


def lift_result(measurement: LiftMeasurement, lift: Lift) -> Lift:
    """Evaluate a lift that reached its end: errors, angles, onset, counts (contract, metrics).

    Returns the lift with its figures and its angles: of each fingertip, fused, of the markers. If the object
    falls, the figures and the true angle end at the fall, because after it the camera sees an object that
    lies somewhere.
    """
    lift_ns, hold_ns = measurement.phases[Phase.LIFT], measurement.phases[Phase.HOLD]
    end_ns = measurement.phases[Phase.LOWER]
    fall_ns = measurement.fall_ns(end_ns)
    held_ns = end_ns if fall_ns is None else fall_ns
    truth = measurement.truth.series(lift_ns)
    if fall_ns is not None:
        truth = truth.picked(truth.time_ns < fall_ns)
    since_zero = truth.picked(truth.time_ns >= measurement.truth.rests_from_ns)
    angle = measurement.angle
    tips = {
        serial: Angles.of(map(tip.answer, tip.samples), serial, lift_ns) for serial, tip in angle.tips.items()
    }
    rest = (lift_ns - to_ns(ZERO_S), lift_ns)  # the area at rest is a measure of the grip
    areas = {serial: of.between(*rest).contact_area_px for serial, of in tips.items()}
    whole = Angles.of(angle.fused, FUSED, lift_ns)
    fused = whole.picked(whole.time_ns < end_ns)
    score = score_angles("", fused, truth.at(fused.time_s), hold_ns)
    onset = slip_onset_ns(since_zero.time_ns, since_zero.angle_deg)
    samples = angle.samples
    watch = measurement.watch
    reactions = None if watch is None else reaction_records(watch, since_zero, lift_ns)
    final_truth = _final(truth, held_ns)
    return replace(
        lift,
        angles={**tips, FUSED: whole, MARKERS: truth},
        accepted=True,
        fault=None,
        outcome=_outcome(measurement, onset, fall_ns, reactions or (), final_truth),
        re_b=score.re_b,
        re=score.re,
        re_held=score.re_held,
        sigma_b_p95_deg=_sigma_p95(fused.between(lift_ns, min(hold_ns, held_ns))),
        contact_area_px={serial: float(np.mean(of)) if of.size else 0.0 for serial, of in areas.items()},
        answered=score.answered,
        final_estimate_deg=_final(fused, held_ns),
        final_truth_deg=final_truth,
        onset_truth_s=_since(onset, lift_ns),
        onset_estimate_s=_since(estimated_onset_ns(whole), lift_ns),
        onset_alarm_s=_since(angle.alarm_ns, lift_ns),
        phases_s={phase.value: time_ns / NS_PER_S for phase, time_ns in measurement.phases.items()},
        frames={name: tally.frames for name, tally in measurement.tallies.items()},
        dropped={name: tally.dropped for name, tally in measurement.tallies.items()},
        jumped={name: tally.jumped for name, tally in measurement.tallies.items() if tally.jumped} or None,
        states=_states(samples),
        skipped=dict(Counter(stage for sample in samples for stage in sample.skipped)),
        disagreements={why.value: sum(s.disagreement is why for s in angle.fused) for why in Disagreement},
        marker_distance=distance_warning(measurement.bench, measurement.truth.distance_sides()),
        turns_against=turns_against({n: of.between(lift_ns, held_ns) for n, of in tips.items()}, truth),
        lag=clock_lag(fused.picked(fused.time_ns < held_ns), truth),
        reactions=reactions,
        slip_thresholds=watch and {s: SlipThreshold(*values) for s, values in watch.thresholds().items()},
        estimator_faults=faults_of(samples),
    )


def _states(samples: Sequence[SlipSample]) -> dict[str, int]:
    counts = Counter(sample.state for sample in samples)
    return {state.value: counts[state] for state in State if counts[state] or state is not State.FROZEN}


def stage_times(measurement: LiftMeasurement) -> dict[str, StageTimes]:
    """Return the computing time per stage and frame with contact, ms: median, 95th and 99th percentile."""
    stages: dict[str, list[float]] = {}
    for sample in measurement.angle.samples:
        if not sample.estimated:
            continue
        for stage, spent_s in sample.stage_s.items():
            stages.setdefault(stage, []).append(spent_s * 1e3)
        stages.setdefault("total", []).append(sum(sample.stage_s.values()) * 1e3)
    return {
        name: StageTimes(*np.percentile(spent_ms, [50, 95, 99]).tolist()) for name, spent_ms in stages.items()
    }


def _outcome(
    measurement: LiftMeasurement,
    onset_ns: int | None,
    fall_ns: int | None,
    reactions: tuple[ReactionRecord, ...],
    turn_deg: float | None,
) -> LiftOutcome:
    if fall_ns is not None:
        return LiftOutcome.FALLEN
    limit = (measurement.watch.max_turn_deg if measurement.watch else None) or CAUGHT_DEG
    kept = turn_deg is not None and abs(turn_deg) <= limit
    if reactions and kept and measurement.risen:
        return LiftOutcome.CAUGHT
    slips = onset_ns is not None or any(reaction.onset_s is not None for reaction in reactions)
    return LiftOutcome.SLIPPED if slips else LiftOutcome.HELD


def _final(angles: Angles, end_ns: int) -> float | None:
    late = angles.known.between(end_ns - to_ns(FINAL_S), end_ns).angle_deg
    return float(np.mean(late)) if late.size else None


def _sigma_p95(angles: Angles) -> float | None:
    sigmas = angles.sigma_deg[np.isfinite(angles.sigma_deg)]
    return float(np.percentile(sigmas, 95)) if sigmas.size else None


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S
