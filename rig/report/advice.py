"""Warnings about a trial: observation, place and advice."""

from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np

from drivers.errors import counted, without_values
from protocols.reaction import ReactionKind
from rig.report.calibrations import calibration_notices
from rig.report.coverage import sigma_notices
from rig.report.curves import truth_at
from rig.report.parts import Notice, joined
from rig.report.session import Lift, Trial, curves_of, lift_name
from rig.results.metrics import FEWEST_LIFTS
from rig.results.summary import ADVICE, main_refusal
from rig.sessions.records import FailedLift, FinishedLift, LiftOutcome

LEAST_ANSWERED = 0.95
MOST_DROPPED, MOST_UNSEEN = 0.001, 0.05
BIG_TURN_DEG, FEW_BIG_TURNS = 5.0, 0.3


def trial_notices(trial: Trial, now: datetime | None = None) -> list[Notice]:
    """Return all notices about a trial, the most serious first."""
    checks: tuple[Callable[[Trial], list[Notice]], ...] = (
        _unfinished, _faults, _fallen, _few_lifts, _small_turns, _refused, _sigma, _unseen_markers,
        _against_truth, _clocks, _marker_distance, _estimator_faults, _frozen, _drops, _jumps, _slow,
        _one_sided, _false_alarms,
    )  # fmt: skip
    found = [*trial.problems, *(notice for check in checks for notice in check(trial))]
    found += calibration_notices(trial.manifest, now or datetime.now(UTC))
    found.sort(key=lambda notice: notice.level != "bad")
    if not found:
        found = [Notice("good", "Nothing stands out.", "All checks of this page passed.")]
    return found


def _unfinished(trial: Trial) -> list[Notice]:
    if trial.manifest.status == "complete":
        return []
    advice = f"Continue with: rig trial --resume --out {trial.folder}. Only these lifts are shown."
    what = f"Unfinished: {len(trial.lifts)} of {counted(trial.manifest.wanted, 'lift')} accepted."
    return [Notice("bad", what, advice)]


def _faults(trial: Trial) -> list[Notice]:
    failed = [row for row in trial.rows if isinstance(row, FailedLift)]
    if not failed:
        return []
    causes = Counter(without_values(row.fault) for row in failed)
    (often, times), *others = causes.most_common()
    fault = next(row.fault for row in failed if without_values(row.fault) == often)
    names = joined(list(dict.fromkeys(lift_name(row) for row in failed)))
    which = f"The most frequent of {len(causes)} causes ({times} times)" if others else "The cause of all"
    advice = f"They were repeated and are not in any figure. {which}: {fault}"
    return [Notice("warn", f"{counted(len(failed), 'attempt')} ended in a rig fault: {names}.", advice)]


def _fallen(trial: Trial) -> list[Notice]:
    names = [lift.name for lift in trial.lifts if lift.row.outcome is LiftOutcome.FALLEN]
    advice = (
        "Grip more firmly (grip_mm in the object's file) or lift less high, to measure the whole rotation."
    )
    return [Notice("warn", f"The object fell in {joined(names)}.", advice)] if names else []


def _few_lifts(trial: Trial) -> list[Notice]:
    counts = Counter(lift.row.name for lift in trial.lifts)
    few = [f"{name} ({count})" for name, count in counts.items() if count < FEWEST_LIFTS]
    if not few:
        return []
    advice = f"Their mean has no interval, and one lift can dominate it. Use --lifts {FEWEST_LIFTS} or more."
    return [Notice("warn", f"Few lifts of {joined(few)}.", advice)]


def _small_turns(trial: Trial) -> list[Notice]:
    if trial.manifest.react is not ReactionKind.NONE:  # reactions keep rotations small on purpose
        return []
    turns = [abs(t) for lift in trial.lifts if (t := lift.row.final_truth_deg) is not None]
    big = sum(turn >= BIG_TURN_DEG for turn in turns)
    if not turns or big >= FEW_BIG_TURNS * len(turns):
        return []
    what = f"Only {big} of {counted(len(turns), 'lift')} turned by {BIG_TURN_DEG:g} degrees or more."
    return [
        Notice(
            "warn", what, "Small rotations give small errors in any case: grip less firmly or lift higher."
        )
    ]


def _refused(trial: Trial) -> list[Notice]:
    bad = [lift for lift in trial.lifts if lift.row.answered < LEAST_ANSWERED]
    if not bad:
        return []
    why = main_refusal(lift.row.states for lift in bad)
    worst = min(bad, key=lambda lift: lift.row.answered)
    what = (
        f"Angles for less than {LEAST_ANSWERED:.0%} of the frames in {counted(len(bad), 'lift')}, least in "
        f"{worst.name} with {worst.row.answered:.0%}; most often '{why}'."
    )
    return [Notice("warn", what, ADVICE[why])]


def _sigma(trial: Trial) -> list[Notice]:
    return sigma_notices(curves_of(trial.lifts))


def _unseen_markers(trial: Trial) -> list[Notice]:
    missing: list[tuple[float, Lift]] = []
    for lift in trial.lifts:
        if lift.curves is None:
            continue
        inside = lift.curves.within("B", "C")
        truth = truth_at(lift.curves.truth, lift.curves.estimate.time_s[inside])
        share = float(np.mean(np.isnan(truth))) if truth.size else 1.0
        if share > MOST_UNSEEN:
            missing.append((share, lift))
    if not missing:
        return []
    share, worst = max(missing, key=lambda pair: pair[0])
    what = (
        f"The markers were lost for more than {MOST_UNSEEN:.0%} of {counted(len(missing), 'lift')}, most in "
        f"{worst.name} ({share:.0%})."
    )
    advice = (
        "These frames have no error. Check that hand and object hide no marker, and that the light is even."
    )
    return [Notice("warn", what, advice)]


def _against_truth(trial: Trial) -> list[Notice]:
    found = [(lift, turned) for lift in trial.lifts if (turned := lift.row.turns_against)]
    if not found:
        return []
    worst, turned = max(found, key=lambda pair: abs(pair[1].truth_deg))
    what = (
        f"The estimate turns against the markers in {counted(len(found), 'lift')}. In {worst.name}, {turned}."
    )
    advice = (
        "Compare the serial printed on each sensor with finger and sign of its [[tactile]] in the bench file."
    )
    return [Notice("bad", what, advice)]


def _clocks(trial: Trial) -> list[Notice]:
    lags = [(lift, lag) for lift in trial.lifts if (lag := lift.row.lag)]
    rates = [lift for lift in trial.lifts if lift.row.clock_rates]
    advice = "In rig doctor, capture time must be 'kernel'. rig calibrate sync measures a constant delay."
    found = []
    if lags:
        worst, lag = max(lags, key=lambda pair: abs(pair[1].lag_s))
        what = f"Estimate and markers do not turn at the same time in {counted(len(lags), 'lift')}"
        found.append(Notice("bad", f"{what}, most in {worst.name}: {lag}.", advice))
    if rates:
        warning = rates[0].row.warnings[0]
        what = f"Clocks run at a wrong speed in {counted(len(rates), 'lift')}. In {rates[0].name}: {warning}."
        found.append(Notice("bad", what, advice))
    return found


def _marker_distance(trial: Trial) -> list[Notice]:
    found = [(lift, off) for lift in trial.lifts if (off := lift.row.marker_distance)]
    if not found:
        return []
    worst, off = max(found, key=lambda pair: abs(pair[1].seen_m / pair[1].placed_m - 1.0))
    where = f"{counted(len(found), 'lift')}; most in {worst.name}"
    what = f"Size and position of the markers are inconsistent in {where}: {off}."
    advice = (
        "Check marker_side_m and position_m of [camera] and position_m of [table] in the bench file, or run "
        "rig calibrate camera and hand-eye; and check that objects are placed on their mark."
    )
    return [Notice("warn", what, advice)]


def _estimator_faults(trial: Trial) -> list[Notice]:
    found = [(lift, faults) for lift in trial.lifts if (faults := lift.row.estimator_faults)]
    if not found:
        return []
    worst, faults = max(found, key=lambda pair: pair[1].frames)
    what = f"The estimator itself failed in {counted(len(found), 'lift')}, most in {worst.name}: {faults}."
    advice = "The frames are stored: correct the estimator's code, then run rig replay with --estimator."
    return [Notice("bad", what, advice)]


def _frozen(trial: Trial) -> list[Notice]:
    found = [lift.name for lift in trial.lifts if lift.row.states.get("frozen")]
    what = f"A fingertip repeated its picture in {joined(found)}."
    return [Notice("bad", what, ADVICE["frozen"])] if found else []


def _drops(trial: Trial) -> list[Notice]:
    frames: Counter[str] = Counter()
    dropped: Counter[str] = Counter()
    for lift in trial.lifts:
        frames.update(lift.row.frames)
        dropped.update(lift.row.dropped)
    bad = [
        f"{source} {count} of {count + frames[source]}"
        for source, count in dropped.items()
        if count > MOST_DROPPED * max(frames[source], 1)
    ]
    if not bad:
        return []
    advice = "rig doctor measures all cameras at once and reports which of them share a USB bus."
    return [Notice("warn", f"Frames were dropped: {joined(bad)}.", advice)]


def _jumps(trial: Trial) -> list[Notice]:
    jumped: Counter[str] = Counter()
    for lift in trial.lifts:
        jumped.update(lift.row.jumped or {})
    if not jumped:
        return []
    counted = joined([f"{count} of {source}" for source, count in jumped.items()])
    advice = "They have no angle. Check the clock of the device that stamps these frames."
    return [Notice("warn", f"The times of frames jumped: {counted}.", advice)]


def _slow(trial: Trial) -> list[Notice]:
    totals = [row.stages["total"].p99_ms for row in trial.timing if "total" in row.stages]
    if not totals:
        return []
    period_ms = 1000.0 / sum(tactile.rate_hz for tactile in trial.manifest.config.tactile)
    slow = float(np.median(totals))
    if slow <= period_ms:
        return []
    what = (
        f"1 frame in 100 takes {slow:.0f} ms, and a frame of some fingertip comes every {period_ms:.1f} ms."
    )
    advice = (
        "In real time angles would be late. Run nothing else on this computer (parallel simulated lifts slow "
        "each other down); the table of stages below shows which stage is slow."
    )
    return [Notice("warn", what, advice)]


def _one_sided(trial: Trial) -> list[Notice]:
    many = [
        lift.name
        for lift in trial.lifts
        if lift.row.disagreements.get("one pad slips", 0) > 0.2 * _tactile_frames(lift.row)
    ]
    if not many:
        return []
    advice = "One fingertip sticks while the other slips: centre the grasp, clean the gels."
    return [Notice("warn", f"The fingertips disagree during much of {joined(many)}.", advice)]


def _false_alarms(trial: Trial) -> list[Notice]:
    """Return a notice about slip events without a slip. After a reaction it is unknown whether one began."""
    early = [
        lift.name
        for lift in trial.lifts
        if lift.row.onset_alarm_s is not None and lift.row.slip_start_s is None and not lift.row.reactions
    ]
    if not early:
        return []
    advice = (
        "A controller that grips more firmly on a slip event would have done so unnecessarily in these lifts."
    )
    return [Notice("warn", f"A slip event was reported although nothing slipped in {joined(early)}.", advice)]


def _tactile_frames(row: FinishedLift) -> int:
    return sum(count for source, count in row.frames.items() if source != "camera")
