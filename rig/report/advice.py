"""Warnings about a session: observation, place and advice."""

from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from calibration.store import age_days, age_text
from calibration.verdict import Verdict
from drivers.errors import counted, without_values
from protocols.reaction import ReactionKind
from rig.config.in_use import FileInUse
from rig.report.charts import FEWEST_FRAMES, sigma_ratios
from rig.report.parts import Notice, Table, joined
from rig.report.session import Trial, curves_of
from rig.results.metrics import FEWEST_LIFTS
from rig.results.summary import ADVICE, main_refusal
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.manifest import BenchManifest
from rig.sessions.records import Lift, LiftOutcome

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
    failed = [(row.title, row.fault) for row in trial.rows if row.fault is not None]
    if not failed:
        return []
    causes = Counter(without_values(fault) for _, fault in failed)
    (often, times), *others = causes.most_common()
    fault = next(fault for _, fault in failed if without_values(fault) == often)
    names = joined(list(dict.fromkeys(title for title, _ in failed)))
    which = f"The most frequent of {len(causes)} causes ({times} times)" if others else "The cause of all"
    advice = f"They were repeated and are not in any figure. {which}: {fault}"
    return [Notice("warn", f"{counted(len(failed), 'attempt')} ended in a rig fault: {names}.", advice)]


def _fallen(trial: Trial) -> list[Notice]:
    names = [lift.title for lift in trial.lifts if lift.outcome is LiftOutcome.FALLEN]
    advice = (
        "Grip more firmly (grip_mm in the object's file) or lift less high, to measure the whole rotation."
    )
    return [Notice("warn", f"The object fell in {joined(names)}.", advice)] if names else []


def _few_lifts(trial: Trial) -> list[Notice]:
    counts = Counter(lift.name for lift in trial.lifts)
    few = [f"{name} ({count})" for name, count in counts.items() if count < FEWEST_LIFTS]
    if not few:
        return []
    advice = f"Their mean has no interval, and one lift can dominate it. Use --lifts {FEWEST_LIFTS} or more."
    return [Notice("warn", f"Few lifts of {joined(few)}.", advice)]


def _small_turns(trial: Trial) -> list[Notice]:
    if trial.manifest.react is not ReactionKind.NONE:  # reactions keep rotations small on purpose
        return []
    turns = [abs(t) for lift in trial.lifts if (t := lift.final_truth_deg) is not None]
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
    bad = [lift for lift in trial.lifts if lift.answered < LEAST_ANSWERED]
    if not bad:
        return []
    why = main_refusal(lift.states for lift in bad)
    worst = min(bad, key=lambda lift: lift.answered)
    what = (
        f"Angles for less than {LEAST_ANSWERED:.0%} of the frames in {counted(len(bad), 'lift')}, least in "
        f"{worst.title} with {worst.answered:.0%}; most often '{why}'."
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
        truth = lift.curves.truth.at(lift.curves.estimate.time_s[inside])
        share = float(np.mean(np.isnan(truth))) if truth.size else 1.0
        if share > MOST_UNSEEN:
            missing.append((share, lift))
    if not missing:
        return []
    share, worst = max(missing, key=lambda pair: pair[0])
    what = (
        f"The markers were lost for more than {MOST_UNSEEN:.0%} of {counted(len(missing), 'lift')}, most in "
        f"{worst.title} ({share:.0%})."
    )
    advice = (
        "These frames have no error. Check that hand and object hide no marker, and that the light is even."
    )
    return [Notice("warn", what, advice)]


def _against_truth(trial: Trial) -> list[Notice]:
    found = [(lift, turned) for lift in trial.lifts if (turned := lift.turns_against)]
    if not found:
        return []
    worst, turned = max(found, key=lambda pair: abs(pair[1].truth_deg))
    many = counted(len(found), "lift")
    what = f"The estimate turns against the markers in {many}. In {worst.title}, {turned}."
    advice = (
        "Compare the serial printed on each sensor with finger and sign of its [[tactile]] in the bench file."
    )
    return [Notice("bad", what, advice)]


def _clocks(trial: Trial) -> list[Notice]:
    lags = [(lift, lag) for lift in trial.lifts if (lag := lift.lag)]
    rates = [lift for lift in trial.lifts if lift.clock_rates]
    advice = "In rig doctor, capture time must be 'kernel'. rig calibrate sync measures a constant delay."
    found = []
    if lags:
        worst, lag = max(lags, key=lambda pair: abs(pair[1].lag_s))
        what = f"Estimate and markers do not turn at the same time in {counted(len(lags), 'lift')}"
        found.append(Notice("bad", f"{what}, most in {worst.title}: {lag}.", advice))
    if rates:
        warning = rates[0].warnings[0]
        what = (
            f"Clocks run at a wrong speed in {counted(len(rates), 'lift')}. In {rates[0].title}: {warning}."
        )
        found.append(Notice("bad", what, advice))
    return found


def _marker_distance(trial: Trial) -> list[Notice]:
    found = [(lift, off) for lift in trial.lifts if (off := lift.marker_distance)]
    if not found:
        return []
    worst, off = max(found, key=lambda pair: abs(pair[1].seen_m / pair[1].placed_m - 1.0))
    where = f"{counted(len(found), 'lift')}; most in {worst.title}"
    what = f"Size and position of the markers are inconsistent in {where}: {off}."
    advice = (
        "Check marker_side_m and position_m of [camera] and position_m of [table] in the bench file, or run "
        "rig calibrate camera and hand-eye; and check that objects are placed on their mark."
    )
    return [Notice("warn", what, advice)]


def _estimator_faults(trial: Trial) -> list[Notice]:
    found = [(lift, faults) for lift in trial.lifts if (faults := lift.estimator_faults)]
    if not found:
        return []
    worst, faults = max(found, key=lambda pair: pair[1].frames)
    what = f"The estimator itself failed in {counted(len(found), 'lift')}, most in {worst.title}: {faults}."
    advice = "The frames are stored: correct the estimator's code, then run rig replay with --estimator."
    return [Notice("bad", what, advice)]


def _frozen(trial: Trial) -> list[Notice]:
    found = [lift.title for lift in trial.lifts if lift.states.get("frozen")]
    what = f"A fingertip repeated its picture in {joined(found)}."
    return [Notice("bad", what, ADVICE["frozen"])] if found else []


def _drops(trial: Trial) -> list[Notice]:
    frames: Counter[str] = Counter()
    dropped: Counter[str] = Counter()
    for lift in trial.lifts:
        frames.update(lift.frames)
        dropped.update(lift.dropped)
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
        jumped.update(lift.jumped or {})
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
        lift.title
        for lift in trial.lifts
        if lift.disagreements.get("one pad slips", 0) > 0.2 * _tactile_frames(lift)
    ]
    if not many:
        return []
    advice = "One fingertip sticks while the other slips: centre the grasp, clean the gels."
    return [Notice("warn", f"The fingertips disagree during much of {joined(many)}.", advice)]


def _false_alarms(trial: Trial) -> list[Notice]:
    """Return a notice about slip events without a slip. After a reaction it is unknown whether one began."""
    early = [
        lift.title
        for lift in trial.lifts
        if lift.onset_alarm_s is not None and lift.slip_start_s is None and not lift.reactions
    ]
    if not early:
        return []
    advice = (
        "A controller that grips more firmly on a slip event would have done so unnecessarily in these lifts."
    )
    return [Notice("warn", f"A slip event was reported although nothing slipped in {joined(early)}.", advice)]


def _tactile_frames(row: Lift) -> int:
    return sum(count for source, count in row.frames.items() if source != "camera")


LEAST_COVERED = 0.90
MOST_BEYOND = 0.3
"""Accepted fraction of a lift's frames with an error beyond 2 sigma; the expected fraction is 5 %."""


def sigma_notices(lifts: Sequence[LiftCurves]) -> list[Notice]:
    """Return the warnings; none for lifts without a sigma."""
    return [*_overall(lifts), *_single(lifts)]


def _overall(lifts: Sequence[LiftCurves]) -> list[Notice]:
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return []
    covered = float(np.mean(ratios <= 2.0))
    if covered >= LEAST_COVERED:
        return []
    factor = float(np.percentile(ratios, 95.0)) / 2.0
    what = f"Sigma is too small: {covered:.0%} of the errors are within 2 sigma, 95 % should be."
    return [Notice("warn", what, f"Read the bands as if they were {factor:.1f} times as wide.")]


def _single(lifts: Sequence[LiftCurves]) -> list[Notice]:
    """Warn of single lifts, worst first, because the fraction over all lifts can hide them."""
    shares: list[tuple[float, str]] = []
    for lift in lifts:
        ratios = sigma_ratios([lift])
        if ratios.size >= FEWEST_FRAMES and (beyond := float(np.mean(ratios > 2.0))) > MOST_BEYOND:
            shares.append((beyond, lift.name))
    if not shares:
        return []
    named = joined([f"{name} ({share:.0%})" for share, name in sorted(shares, reverse=True)])
    what = f"More than {MOST_BEYOND:.0%} of the frames are beyond 2 sigma in {named}."
    advice = (
        "Their errors are larger than their sigmas: inspect the curves and frames of these lifts before "
        "using their angles."
    )
    return [Notice("warn", what, advice)]


OLD_DAYS = 30.0
NEEDED = ("camera", "hand-eye")
"""Calibrations that the marker angle depends on."""


def calibration_table(manifest: BenchManifest, now: datetime) -> Table | None:
    """Return a row per calibration in the manifest; None if there is none."""
    rows = [
        [name, about.file, about.verdict, _age(about, now)] for name, about in manifest.calibration.items()
    ]
    return Table(("calibration", "file", "verdict", "age"), rows, text=(0, 1, 2, 3)) if rows else None


def calibration_notices(manifest: BenchManifest, now: datetime) -> list[Notice]:
    """Return notices about calibrations that are old, weak, or missing on a real bench."""
    named = manifest.calibration
    notices = []
    missing = [kind for kind in NEEDED if not any(name.startswith(kind) for name in named)]
    if missing and not manifest.simulated:
        advice = (
            "The values in the bench file are used instead, and limit the accuracy of the marker angle. Run "
            f"rig calibrate {missing[0]}."
        )
        notices.append(Notice("warn", f"No calibration of {joined(missing)} is in use.", advice))
    old = [
        f"{name} ({_age(about, now)})"
        for name, about in named.items()
        if (_days(about, now) or 0.0) > OLD_DAYS
    ]
    if old:
        advice = "Check that they are still valid with rig calibrate compare, or calibrate again."
        notices.append(Notice("warn", f"Old calibrations: {joined(old)}.", advice))
    weak = [name for name, about in named.items() if about.verdict == Verdict.WEAK]
    if weak:
        advice = "Their pages state the reasons; more or better samples improve them."
        notices.append(Notice("warn", f"Weak calibrations: {joined(weak)}.", advice))
    return notices


def _days(about: FileInUse, now: datetime) -> float | None:
    try:
        return age_days(about.created, now)
    except ValueError:
        return None


def _age(about: FileInUse, now: datetime) -> str:
    days = _days(about, now)
    return "unknown" if days is None else age_text(days)
