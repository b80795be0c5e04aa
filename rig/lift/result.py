"""Evaluate a measured lift, with its reactions to slip, to the row and the records that are stored."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from protocols.observer import Phase, ReactionStep
from rig.lift.agreement import Answers, clock_lag, turns_against
from rig.lift.fusion import Disagreement
from rig.lift.marker_truth import TruthSeries, interpolate
from rig.lift.measurement import LiftMeasurement
from rig.lift.object_angle import ZERO_S
from rig.lift.onset import departure_ns, estimated_onset_ns, slip_onset_ns
from rig.lift.slip_watch import CAUGHT_DEG, SlipEvent, SlipWatch
from rig.results.scores import score_angles
from rig.sessions.records import LiftFigures, LiftOutcome, ReactionRecord, SlipThreshold
from rig.sessions.timing import StageTimes
from rig.tactile.sample import SlipSample, State, faults_of

Step = tuple[ReactionStep, int, int]
LAST = (ReactionStep.REST, ReactionStep.ENDS)
REST_NS = 100_000_000
"""Length of the interval before a reaction over which the true angle at rest is averaged."""
FRAME_NS = 50_000_000
"""Longest time between an event and the camera frame that shows it (contract: longer gaps have no truth)."""


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


FINAL_S = 0.3
"""Length of the interval at the end over which final angles are averaged, s."""


def lift_result(measurement: LiftMeasurement) -> tuple[LiftFigures, TruthSeries]:
    """Evaluate a lift that reached its end: errors, angles, onset, counts (contract, metrics).

    Returns the measured part of the row, and the true angle. If the object falls, both end at the fall,
    because after it the camera sees an object that lies somewhere.
    """
    lift_ns, hold_ns = measurement.phases[Phase.LIFT], measurement.phases[Phase.HOLD]
    end_ns = measurement.phases[Phase.LOWER]
    fall_ns = measurement.fall_ns(end_ns)
    held_ns = end_ns if fall_ns is None else fall_ns
    series, since_zero = measurement.truth.series(), measurement.truth.series_since_zero()
    if fall_ns is not None:
        series, since_zero = series.before(fall_ns), since_zero.before(fall_ns)
    angle = measurement.angle
    fused = [s for s in angle.fused if s.time_ns < end_ns]
    true_deg = [interpolate(series, s.time_ns) for s in fused]
    score = score_angles("", fused, true_deg, hold_ns)
    onset = slip_onset_ns(since_zero.time_ns, since_zero.angle_deg)
    answers = [(s.time_ns, s.angle_deg) for s in angle.fused]
    samples = angle.samples
    watch = measurement.watch
    reactions = None if watch is None else reaction_records(watch, since_zero, lift_ns)
    final_truth = _final(
        [(int(t), float(a)) for t, a in zip(series.time_ns, series.angle_deg, strict=True)], held_ns
    )
    figures = LiftFigures(
        outcome=_outcome(measurement, onset, fall_ns, reactions or (), final_truth),
        re_b=score.re_b,
        re=score.re,
        re_held=score.re_held,
        contact_area_px=_contact_areas(measurement, lift_ns),
        answered=score.answered,
        final_estimate_deg=_final([(s.time_ns, s.angle_deg) for s in fused], held_ns),
        final_truth_deg=final_truth,
        onset_truth_s=_since(onset, lift_ns),
        onset_estimate_s=_since(estimated_onset_ns(answers), lift_ns),
        onset_alarm_s=_since(angle.alarm.raised_ns, lift_ns),
        phases_s={phase.value: time_ns / NS_PER_S for phase, time_ns in measurement.phases.items()},
        frames={name: tally.frames for name, tally in measurement.tallies.items()},
        dropped={name: tally.dropped for name, tally in measurement.tallies.items()},
        jumped={name: tally.jumped for name, tally in measurement.tallies.items() if tally.jumped} or None,
        states=_states(samples),
        skipped=dict(Counter(stage for sample in samples for stage in sample.skipped)),
        disagreements={why.value: sum(s.disagreement is why for s in angle.fused) for why in Disagreement},
        marker_distance=measurement.marker_distance(),
        turns_against=turns_against(_answers(measurement, lift_ns, held_ns), series),
        lag=clock_lag([(s.time_ns, s.angle_deg) for s in fused if s.time_ns < held_ns], series),
        reactions=reactions,
        slip_thresholds=None if watch is None else slip_thresholds(watch),
        estimator_faults=faults_of(samples),
    )
    return figures, series


def _states(samples: Sequence[SlipSample]) -> dict[str, int]:
    """Return the number of samples by state; `frozen` only if there are any."""
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


def _answers(measurement: LiftMeasurement, from_ns: int, until_ns: int) -> dict[str, Answers]:
    """Return the signed angles of each fingertip between two times, by serial."""
    return {
        serial: [(s.time_ns, tip.answer(s).angle_deg) for s in tip.samples if from_ns <= s.time_ns < until_ns]
        for serial, tip in measurement.angle.tips.items()
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


def _final(values: list[tuple[int, float | None]], end_ns: int) -> float | None:
    late = [a for t, a in values if end_ns - to_ns(FINAL_S) <= t < end_ns and a is not None]
    return float(np.mean(late)) if late else None


def _since(time_ns: int | None, start_ns: int) -> float | None:
    return None if time_ns is None else (time_ns - start_ns) / NS_PER_S


def _contact_areas(measurement: LiftMeasurement, lift_ns: int) -> dict[str, float]:
    """Return the mean contact area of each fingertip at the end of phase A, as a measure of the grip, px."""
    since = lift_ns - to_ns(ZERO_S)
    areas = {
        serial: [s.contact_area_px for s in tip.samples if since <= s.time_ns < lift_ns]
        for serial, tip in measurement.angle.tips.items()
    }
    return {serial: float(np.mean(values)) if values else 0.0 for serial, values in areas.items()}
