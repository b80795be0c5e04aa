"""Evaluate a measured lift: its outcome, and the figures that `Lift` declares."""

from dataclasses import fields, replace

import numpy as np

from drivers.clock import to_ns
from protocols.observer import Phase
from rig.lift.agreement import clock_lag, distance_warning, find_turning_against
from rig.lift.measurement import LiftMeasurement
from rig.lift.object_angle import ZERO_S, Disagreement
from rig.lift.onset import estimated_onset_ns, slip_onset_ns
from rig.lift.slip_watch import CAUGHT_DEG, seconds_since
from rig.results.scores import score_angles
from rig.sessions.records import ClockLag, Lift, LiftOutcome, MarkerDistance, TurnsAgainst
from rig.tactile.angles import FUSED, MARKERS, Angles, Floats

FINAL_S = 0.3
"""Length of the interval at the end over which final angles are averaged, s."""


def evaluate_lift(measurement: LiftMeasurement, lift: Lift) -> Lift:
    """Evaluate a lift that reached its end: outcome, figures (contract, metrics) and angles.

    Its angles are those of each fingertip, fused, and of the markers.
    """
    measured = MeasuredLift(measurement)
    figures = {of.name: of.metadata["figure"](measured) for of in fields(Lift) if "figure" in of.metadata}
    angles = {**measured.tips, FUSED: measured.whole, MARKERS: measured.truth}
    return replace(lift, angles=angles, accepted=True, fault=None, outcome=measured.outcome, **figures)


class MeasuredLift:
    """Values of a measured lift from which its figures are computed (`Lift` in `rig.sessions.records`).

    lift_ns: start of phase B. until_ns: end of phase C, or the fall: the figures end there, because after it
    the camera sees an object that lies somewhere. truth: the true angle until the fall. tips, whole: the
    angle of each fingertip, and the fused one, over all frames. fused, in_b: the fused one until the end of
    phase C, and in phase B. onset_ns: true onset of slip. reactions: None in a lift without reactions.
    """

    def __init__(self, measurement: LiftMeasurement) -> None:
        self.measurement = measurement
        lift_ns, hold_ns, end_ns = (measurement.phases[p] for p in (Phase.LIFT, Phase.HOLD, Phase.LOWER))
        fall_ns, truth = measurement.fall_ns(end_ns), measurement.truth.series(lift_ns)
        self.lift_ns, self.fallen = lift_ns, fall_ns is not None
        self.until_ns = end_ns if fall_ns is None else fall_ns
        self.truth = truth if fall_ns is None else truth.select(truth.time_ns < fall_ns)
        self.tips = {
            serial: Angles.of(map(tip.answer, tip.samples), serial, lift_ns)
            for serial, tip in measurement.angle.tips.items()
        }
        self.whole = Angles.of(measurement.angle.fused, FUSED, lift_ns)
        self.fused = self.whole.select(self.whole.time_ns < end_ns)
        self.in_b = self.fused.between(lift_ns, min(hold_ns, self.until_ns))
        self.score = score_angles("", self.fused, self.truth.at(self.fused.time_s), hold_ns)
        since_zero = self.truth.select(self.truth.time_ns >= measurement.truth.rests_from_ns)
        self.onset_ns = slip_onset_ns(since_zero.time_ns, since_zero.angle_deg)
        self.reactions = measurement.watch and measurement.watch.records(since_zero, lift_ns)

    @property
    def outcome(self) -> LiftOutcome:
        if self.fallen:
            return LiftOutcome.FALLEN
        measurement, turn_deg = self.measurement, self.final_deg(self.truth)
        limit = (measurement.watch.max_turn_deg if measurement.watch else None) or CAUGHT_DEG
        kept = turn_deg is not None and abs(turn_deg) <= limit
        if self.reactions and kept and measurement.risen:
            return LiftOutcome.CAUGHT
        slips = self.onset_ns is not None or any(of.onset_s is not None for of in self.reactions or ())
        return LiftOutcome.SLIPPED if slips else LiftOutcome.HELD

    def final_deg(self, angles: Angles) -> float | None:
        """Return the mean angle over the last `FINAL_S`; None without an angle."""
        late = angles.known.between(self.until_ns - to_ns(FINAL_S), self.until_ns).angle_deg
        return float(np.mean(late)) if late.size else None

    @property
    def estimated_onset_ns(self) -> int | None:
        return estimated_onset_ns(self.whole)

    def since_lift_s(self, time_ns: int | None) -> float | None:
        return seconds_since(self.lift_ns, time_ns)

    @property
    def rest_areas_px(self) -> dict[str, Floats]:
        """Contact areas at the end of phase A by serial: a measure of the grip."""
        rest = (self.lift_ns - to_ns(ZERO_S), self.lift_ns)
        return {serial: of.between(*rest).contact_area_px for serial, of in self.tips.items()}

    @property
    def disagreements(self) -> dict[str, int]:
        fused = self.measurement.angle.fused
        return {why.value: sum(sample.disagreement is why for sample in fused) for why in Disagreement}

    @property
    def marker_distance(self) -> MarkerDistance | None:
        return distance_warning(self.measurement.bench, self.measurement.truth.distance_sides())

    @property
    def turns_against(self) -> TurnsAgainst | None:
        tips = {serial: of.between(self.lift_ns, self.until_ns) for serial, of in self.tips.items()}
        return find_turning_against(tips, self.truth)

    @property
    def lag(self) -> ClockLag | None:
        return clock_lag(self.fused.select(self.fused.time_ns < self.until_ns), self.truth)
