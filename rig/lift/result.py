"""Evaluate a measured lift to the row that is stored."""

from collections import Counter

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from protocols.observer import Phase
from rig.lift.fusion import Disagreement
from rig.lift.marker_truth import TruthSeries, interpolate
from rig.lift.measurement import LiftMeasurement
from rig.lift.object_angle import ZERO_S
from rig.lift.onset import estimated_onset_ns, slip_onset_ns
from rig.lift.reactions import reaction_records, slip_thresholds
from rig.lift.slip_watch import CAUGHT_DEG
from rig.results.scores import score_angles
from rig.sessions.records import LiftFigures, LiftOutcome, ReactionRecord
from rig.sessions.timing import StageTimes
from rig.tactile.foreign import faults_of
from rig.tactile.sample import State

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
        states={state.value: sum(s.state is state for s in samples) for state in State},
        skipped=dict(Counter(stage for sample in samples for stage in sample.skipped)),
        disagreements={why.value: sum(s.disagreement is why for s in angle.fused) for why in Disagreement},
        marker_distance=measurement.marker_distance(),
        reactions=reactions,
        slip_thresholds=None if watch is None else slip_thresholds(watch),
        estimator_faults=faults_of(samples),
    )
    return figures, series


def stage_times(measurement: LiftMeasurement) -> dict[str, StageTimes]:
    """Return the computing time per stage and tactile frame, ms: median, 95th and 99th percentile."""
    stages: dict[str, list[float]] = {}
    for sample in measurement.angle.samples:
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
