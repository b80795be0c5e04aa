"""Warnings about a session: observation, place and advice."""

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

from calibration.store import OLD_DAYS, age_days, age_text
from calibration.verdict import Verdict
from drivers.errors import plural, without_values
from protocols.reaction import ReactionKind
from rig.config.measured_values import FileInUse
from rig.report.charts import FEWEST_FRAMES, sigma_ratios, useful_share
from rig.report.parts import Notice, Table, join_items
from rig.report.session import Trial, with_angles
from rig.results.metrics import FEWEST_LIFTS, USEFUL_SIGMA_DEG
from rig.results.summary import ADVICE, main_refusal
from rig.sessions.manifest import BenchManifest
from rig.sessions.records import Lift, LiftOutcome, totals

LEAST_ANSWERED, LEAST_COVERED = 0.95, 0.90
MOST_DROPPED, MOST_UNSEEN = 0.001, 0.05
BIG_TURN_DEG, FEW_BIG_TURNS = 5.0, 0.3
MOST_BEYOND = 0.3
"""Accepted fraction of a lift's frames with an error beyond 2 sigma; the expected fraction is 5 %."""
MEDIAN_RATIO, MOST_TIMES = 0.67, 3.0
"""Median of |error| / sigma of normal errors, and how many times smaller it may be."""
LEAST_USEFUL = 0.7
"""Smallest share of useful angles in a lift without a warning."""
NEEDED = ("camera", "hand-eye")
"""Calibrations that the marker angle depends on."""


def trial_notices(trial: Trial, now: datetime | None = None) -> list[Notice]:
    """Return all notices about a trial, the most serious first."""
    parts = (_about_lifts, _about_angles, _about_setup, _about_frames, _about_slips)
    found = [*trial.problems, *(notice for part in parts for notice in part(trial))]
    found += calibration_notices(trial.manifest, now or datetime.now(UTC))
    found.sort(key=lambda notice: notice.level != "bad")
    return found or [Notice("good", "Nothing stands out.", "All checks of this page passed.")]


def _about_lifts(trial: Trial) -> Iterator[Notice]:
    lifts, manifest = trial.lifts, trial.manifest
    if manifest.status != "complete":
        advice = f"Continue with: rig trial --resume --out {trial.folder}. Only these lifts are shown."
        what = f"Unfinished: {len(lifts)} of {plural(manifest.wanted, 'lift')} accepted."
        yield Notice("bad", what, advice)
    if failed := [(row.title, row.fault) for row in trial.rows if row.fault is not None]:
        causes = Counter(without_values(fault) for _, fault in failed)
        (often, times), *others = causes.most_common()
        fault = next(fault for _, fault in failed if without_values(fault) == often)
        names = join_items(list(dict.fromkeys(title for title, _ in failed)))
        which = f"The most frequent of {len(causes)} causes ({times} times)" if others else "The cause of all"
        advice = f"They were repeated and are not in any figure. {which}: {fault}"
        yield Notice("warn", f"{plural(len(failed), 'attempt')} ended in a rig fault: {names}.", advice)
    if fallen := [lift.title for lift in lifts if lift.outcome is LiftOutcome.FALLEN]:
        advice = (
            "Grip more firmly (grip_mm in the object's file) or lift less high, to measure the "
            "whole rotation."
        )
        yield Notice("warn", f"The object fell in {join_items(fallen)}.", advice)
    counts = Counter(lift.name for lift in lifts)
    if few := [f"{name} ({count})" for name, count in counts.items() if count < FEWEST_LIFTS]:
        advice = (
            f"Their mean has no interval, and one lift can dominate it. Use --lifts {FEWEST_LIFTS} or more."
        )
        yield Notice("warn", f"Few lifts of {join_items(few)}.", advice)
    turns = [abs(t) for lift in lifts if (t := lift.final_truth_deg) is not None]
    big = sum(turn >= BIG_TURN_DEG for turn in turns)
    # reactions keep rotations small on purpose
    if manifest.react is ReactionKind.NONE and turns and big < FEW_BIG_TURNS * len(turns):
        what = f"Only {big} of {plural(len(turns), 'lift')} turned by {BIG_TURN_DEG:g} degrees or more."
        advice = "Small rotations give small errors in any case: grip less firmly or lift higher."
        yield Notice("warn", what, advice)


def _about_angles(trial: Trial) -> Iterator[Notice]:
    if bad := [lift for lift in trial.lifts if lift.answered < LEAST_ANSWERED]:
        why = main_refusal(lift.states for lift in bad)
        worst = min(bad, key=lambda lift: lift.answered)
        what = (
            f"Angles for less than {LEAST_ANSWERED:.0%} of the frames in {plural(len(bad), 'lift')}, "
            f"least in {worst.title} with {worst.answered:.0%}; most often '{why}'."
        )
        yield Notice("warn", what, ADVICE[why])
    yield from sigma_notices(with_angles(trial.lifts))
    known = [(_unseen(lift), lift) for lift in with_angles(trial.lifts)]
    if missing := [(share, lift) for share, lift in known if share > MOST_UNSEEN]:
        share, worst = max(missing, key=lambda pair: pair[0])
        what = (
            f"The markers were lost for more than {MOST_UNSEEN:.0%} of {plural(len(missing), 'lift')}, "
            f"most in {worst.title} ({share:.0%})."
        )
        advice = (
            "These frames have no error. Check that hand and object hide no marker, and that the "
            "light is even."
        )
        yield Notice("warn", what, advice)
    if found := [(lift, turned) for lift in trial.lifts if (turned := lift.turns_against)]:
        worst, turned = max(found, key=lambda pair: abs(pair[1].truth_deg))
        many = plural(len(found), "lift")
        what = f"The estimate turns against the markers in {many}. In {worst.title}, {turned}."
        advice = (
            "Compare the serial printed on each sensor with finger and sign of its [[tactile]] in the "
            "bench file."
        )
        yield Notice("bad", what, advice)


def _unseen(lift: Lift) -> float:
    """Return the fraction of the frames of B and C without a marker angle."""
    truth = lift.truth.at(lift.estimate.time_s[lift.within("B", "C")])
    return float(np.mean(np.isnan(truth))) if truth.size else 1.0


def sigma_notices(lifts: Sequence[Lift]) -> Iterator[Notice]:
    """Yield warnings about sigmas that are too small or too large, first of all lifts, then of single ones.

    The fraction over all lifts can hide single ones. Lifts without a sigma give none.
    """
    ratios = sigma_ratios(lifts)
    if ratios.size >= FEWEST_FRAMES and (covered := float(np.mean(ratios <= 2.0))) < LEAST_COVERED:
        factor = float(np.percentile(ratios, 95.0)) / 2.0
        what = f"Sigma is too small: {covered:.0%} of the errors are within 2 sigma, 95 % should be."
        yield Notice("warn", what, f"Read the bands as if they were {factor:.1f} times as wide.")
    median = float(np.median(ratios)) if ratios.size >= FEWEST_FRAMES else MEDIAN_RATIO
    if median < MEDIAN_RATIO / MOST_TIMES:
        what = f"Sigma is too large: half of the errors are below {median:.2f} sigma, normal ones below"
        advice = f"Read the bands as if they were {MEDIAN_RATIO / max(median, 0.01):.0f} times as narrow."
        yield Notice("warn", f"{what} {MEDIAN_RATIO:.2f}.", advice)
    useful = [(share, lift.title) for lift in lifts if (share := useful_share(lift)) is not None]
    if vague := sorted(each for each in useful if each[0] < LEAST_USEFUL):
        named = join_items([f"{name} ({share:.0%})" for share, name in vague])
        what = (
            f"Less than {LEAST_USEFUL:.0%} of the angles have a sigma of at most {USEFUL_SIGMA_DEG:g} degrees"
        )
        advice = (
            "The estimator does not know these angles, even if they are right: grasp where there are edges."
        )
        yield Notice("warn", f"{what} in {named}.", advice)
    shares = [
        (float(np.mean(own > 2.0)), lift.title)
        for lift in lifts
        if (own := sigma_ratios([lift])).size >= FEWEST_FRAMES
    ]
    if beyond := sorted((each for each in shares if each[0] > MOST_BEYOND), reverse=True):
        named = join_items([f"{name} ({share:.0%})" for share, name in beyond])
        what = f"More than {MOST_BEYOND:.0%} of the frames are beyond 2 sigma in {named}."
        advice = (
            "Their errors are larger than their sigmas: inspect the curves and frames of these lifts before "
            "using their angles."
        )
        yield Notice("warn", what, advice)


def _about_setup(trial: Trial) -> Iterator[Notice]:
    clock_advice = (
        "In rig doctor, capture time must be 'kernel'. rig calibrate sync measures a constant delay."
    )
    if lags := [(lift, lag) for lift in trial.lifts if (lag := lift.lag) and lag.large]:
        worst, lag = max(lags, key=lambda pair: abs(pair[1].lag_s))
        what = f"Estimate and markers do not turn at the same time in {plural(len(lags), 'lift')}"
        yield Notice("bad", f"{what}, most in {worst.title}: {lag}.", clock_advice)
    if distances := [(lift, off) for lift in trial.lifts if (off := lift.marker_distance)]:
        worst, off = max(distances, key=lambda pair: abs(pair[1].seen_m / pair[1].placed_m - 1.0))
        where = f"{plural(len(distances), 'lift')}; most in {worst.title}"
        what = f"Size and position of the markers are inconsistent in {where}: {off}."
        advice = (
            "Check marker_side_m and position_m of [camera] and position_m of [table] in the bench file, or "
            "run rig calibrate camera and hand-eye; and check that objects are placed on their mark."
        )
        yield Notice("warn", what, advice)
    if failed := [(lift, faults) for lift in trial.lifts if (faults := lift.estimator_faults)]:
        worst, faults = max(failed, key=lambda pair: pair[1].frames)
        where = f"{plural(len(failed), 'lift')}, most in {worst.title}"
        advice = "The frames are stored: correct the estimator's code, then run rig replay with --estimator."
        yield Notice("bad", f"The estimator itself failed in {where}: {faults}.", advice)


def _about_frames(trial: Trial) -> Iterator[Notice]:
    if frozen := [lift.title for lift in trial.lifts if lift.states.get("frozen")]:
        yield Notice("bad", f"A fingertip repeated its picture in {join_items(frozen)}.", ADVICE["frozen"])
    frames, dropped, jumped = (totals(trial.lifts, name) for name in ("frames", "dropped", "jumped"))
    bad = [
        f"{source} {count} of {count + frames[source]}"
        for source, count in dropped.items()
        if count > MOST_DROPPED * max(frames[source], 1)
    ]
    if bad:
        advice = "rig doctor measures all cameras at once and reports which of them share a USB bus."
        yield Notice("warn", f"Frames were dropped: {join_items(bad)}.", advice)
    if jumped:
        times = join_items([f"{count} of {source}" for source, count in jumped.items()])
        advice = "They have no angle. Check the clock of the device that stamps these frames."
        yield Notice("warn", f"The times of frames jumped: {times}.", advice)
    totals_ms = [row.stages["total"].p99_ms for row in trial.timing if "total" in row.stages]
    period_ms = 1000.0 / sum(tactile.rate_hz for tactile in trial.manifest.config.tactile)
    if totals_ms and (slow := float(np.median(totals_ms))) > period_ms:
        what = (
            f"1 frame in 100 takes {slow:.0f} ms, and a frame of some fingertip comes every "
            f"{period_ms:.1f} ms."
        )
        advice = (
            "In real time angles would be late. Run nothing else on this computer (parallel simulated lifts "
            "slow each other down); the table of stages below shows which stage is slow."
        )
        yield Notice("warn", what, advice)


def _about_slips(trial: Trial) -> Iterator[Notice]:
    one_sided = []
    for lift in trial.lifts:
        tactile = sum(count for source, count in lift.frames.items() if source != "camera")
        if lift.disagreements.get("one pad slips", 0) > 0.2 * tactile:
            one_sided.append(lift.title)
    if one_sided:
        advice = "One fingertip sticks while the other slips: centre the grasp, clean the gels."
        yield Notice("warn", f"The fingertips disagree during much of {join_items(one_sided)}.", advice)
    still = [lift for lift in trial.lifts if lift.slip_start_s is None]
    # after a reaction it is unknown whether a slip began
    if early := [lift.title for lift in still if lift.onset_alarm_s is not None and not lift.reactions]:
        what = f"A slip event was reported although nothing slipped in {join_items(early)}."
        advice = (
            "A controller that grips more firmly on a slip event would have done so unnecessarily in "
            "these lifts."
        )
        yield Notice("warn", what, advice)


def calibration_table(manifest: BenchManifest, now: datetime) -> Table | None:
    """Return a row per calibration in the manifest; None if there is none."""
    rows = [
        [name, about.file, about.verdict, _age(about, now)] for name, about in manifest.calibration.items()
    ]
    return Table(("calibration", "file", "verdict", "age"), rows, text=(0, 1, 2, 3)) if rows else None


def calibration_notices(manifest: BenchManifest, now: datetime) -> Iterator[Notice]:
    """Yield notices about calibrations that are old, weak, or missing on a real bench."""
    named = manifest.calibration
    missing = [kind for kind in NEEDED if not any(name.startswith(kind) for name in named)]
    if missing and not manifest.simulated:
        advice = (
            "The values in the bench file are used instead, and limit the accuracy of the marker angle. Run "
            f"rig calibrate {missing[0]}."
        )
        yield Notice("warn", f"No calibration of {join_items(missing)} is in use.", advice)
    ages = {name: _days(about, now) or 0.0 for name, about in named.items()}
    if old := [f"{name} ({_age(named[name], now)})" for name, days in ages.items() if days > OLD_DAYS]:
        advice = "Check that they are still valid with rig calibrate compare, or calibrate again."
        yield Notice("warn", f"Old calibrations: {join_items(old)}.", advice)
    if weak := [name for name, about in named.items() if about.verdict == Verdict.WEAK]:
        advice = "Their pages state the reasons; more or better samples improve them."
        yield Notice("warn", f"Weak calibrations: {join_items(weak)}.", advice)


def _days(about: FileInUse, now: datetime) -> float | None:
    try:
        return age_days(about.created, now)
    except ValueError:
        return None


def _age(about: FileInUse, now: datetime) -> str:
    days = _days(about, now)
    return "unknown" if days is None else age_text(days)
