"""The report of a trial."""

from datetime import UTC, datetime

import numpy as np

from drivers.errors import counted
from rig.pages.page import render
from rig.report.advice import trial_notices
from rig.report.calibrations import calibration_table
from rig.report.counts import counts_table, onset_table, stage_table, state_table
from rig.report.curves import LiftCurves
from rig.report.groups import object_chart, surface_chart
from rig.report.header import header
from rig.report.lift_chart import key, lift_chart
from rig.report.parts import Chart, Notice, Table
from rig.report.reacted import beside
from rig.report.session import UNREADABLE, Lift, Trial, curves_of, object_label
from rig.report.strips import Still, camera_strip, strip
from rig.report.text import made_text, mare_tile
from rig.report.trial_charts import (
    coverage_chart,
    error_against_angle,
    error_against_rate,
    finals_chart,
    sigma_ratios,
)
from rig.results.metrics import INTERVAL, mare_text
from rig.results.summary import ObjectSummary, TrialSummary, summarize_trial

WORST_LIFTS = 3


def trial_page(trial: Trial, now: datetime | None = None, other: Trial | None = None) -> str:
    """Return the report of a trial as one HTML page.

    other: the same lifts without a reaction to slip, or with one. Raises `InputError` for any other.
    """
    now = now or datetime.now(UTC)
    summary = summarize_trial(trial.rows)
    return render(
        "rig.report",
        "trial.html",
        trial=trial,
        manifest=trial.manifest,
        head=header(trial.manifest, "Slip trial"),
        tiles=_tiles(trial, summary),
        warnings=trial_notices(trial, now),
        objects=object_table(summary) if summary.objects else None,
        reacted=None if other is None else beside(trial, other),
        charts=_charts(trial),
        worst=_worst(trial),
        groups=_by_object(trial),
        key=key(),
        interval=INTERVAL,
        stages=stage_table(trial.timing),
        counts=counts_table([lift.row for lift in trial.lifts]),
        onsets=onset_table([lift.row for lift in trial.lifts]),
        states=state_table([lift.row for lift in trial.lifts]),
        calibrations=calibration_table(trial.manifest, now),
        made=made_text(now),
    )


def object_table(summary: TrialSummary) -> Table:
    """The paper's table: error per object over B, and over B and C."""
    columns = (
        "object",
        "MARE in B, °",
        "MARE in B and C, °",
        "lifts",
        "true turn, °",
        "answered",
        "outcomes",
    )
    rows = [_object_row(o) for o in summary.objects]
    overall = [mare_text(summary.mare_b), mare_text(summary.mare), str(summary.lifts_accepted)]
    rows.append(["all", *overall, "", f"{summary.answered:.1%}", ""])
    return Table(columns, rows, text=(0, 6), total=True)


def _object_row(o: ObjectSummary) -> list[str]:
    outcomes = ", ".join(f"{count} {name}" for name, count in o.outcomes.items())
    errors = [mare_text(o.mare_b), mare_text(o.mare)]
    return [f"{o.object_id} {o.name}", *errors, str(o.lifts), o.turn_text, f"{o.answered:.1%}", outcomes]


def _reaction_tile(summary: TrialSummary) -> list[tuple[str, str]]:
    reacting = summary.reacting
    if reacting is None:
        return []
    what = f"lifts caught by reaction to slip '{reacting.kind}'; their MARE stands apart from others'"
    return [(f"{reacting.caught} of {reacting.lifts}", what)]


def _tiles(trial: Trial, summary: TrialSummary) -> list[tuple[str, str]]:
    tiles = [
        (counted(summary.lifts_accepted, "lift"), f"of {counted(len(summary.objects), 'object')}"),
        *_reaction_tile(summary),
        mare_tile(summary.mare, "MARE in B and C"),
        mare_tile(summary.mare_b, "MARE in B (the paper, on its real bench: 1.85°)"),
        mare_tile(summary.mare_held, "MARE with refused frames held at the last answer"),
        (f"{summary.answered:.1%}", "of the frames answered"),
    ]
    ratios = sigma_ratios(curves_of(trial.lifts))
    if ratios.size:
        tiles.append((f"{np.mean(ratios <= 2.0):.1%}", "of the errors within 2 sigma; 95 % should be"))
    return tiles


def _charts(trial: Trial) -> list[Chart]:
    lifts = curves_of(trial.lifts)
    if not lifts:
        return []
    finals = [
        (row.final_estimate_deg, row.final_truth_deg)
        for row in (lift.row for lift in trial.lifts)
        if row.final_estimate_deg is not None and row.final_truth_deg is not None
    ]
    charts = [
        object_chart(trial.lifts),
        finals_chart(finals),
        coverage_chart(lifts),
        error_against_angle(lifts),
        error_against_rate(lifts),
        surface_chart(trial.lifts, trial.manifest.config.objects),
    ]
    return [chart for chart in charts if chart is not None]


def _worst(trial: Trial) -> list[dict[str, object]]:
    """The lifts with the largest mean error, with their frames."""
    known = [(lift.row.re.mean_deg, lift, lift.curves) for lift in trial.lifts if lift.row.re and lift.curves]
    ranked = sorted(known, key=lambda entry: -entry[0])
    return [_with_strips(trial, lift, curves) for _, lift, curves in ranked[:WORST_LIFTS]]


def _with_strips(trial: Trial, lift: Lift, curves: LiftCurves) -> dict[str, object]:
    strips: dict[str, list[Still]] = {}
    problem: Notice | None = None
    path, signs = trial.folder / lift.row.recording, trial.manifest.signs
    for serial in trial.manifest.serials:
        try:
            if serial in signs:
                strips[serial] = strip(path, curves, lift.zero_ns, serial, signs[serial])
            else:
                strips[f"camera {serial}, marker angle"] = camera_strip(path, curves, lift.zero_ns, serial)
        except UNREADABLE as error:
            problem = Notice("bad", f"The frames of {serial} cannot be shown.", str(error))
    return {"chart": lift_chart(curves, _lift_caption(lift)), "strips": strips, "problem": problem}


def _by_object(trial: Trial) -> list[dict[str, object]]:
    groups: dict[str, list[Chart]] = {}
    for lift in trial.lifts:
        if lift.curves is not None:
            groups.setdefault(object_label(lift.row), []).append(lift_chart(lift.curves, _lift_caption(lift)))
    return [{"title": title, "charts": charts} for title, charts in groups.items()]


def _lift_caption(lift: Lift) -> str:
    row = lift.row
    error = row.re
    parts = [
        f"{row.outcome}, {row.position}, grip {row.grip_counts}",
        f"error {error.mean_deg:.2f} ± {error.std_deg:.2f}°, at most {error.max_deg:.1f}°"
        if error
        else "no answer",
    ]
    if row.answered < 1.0:
        parts.append(f"{row.answered:.0%} answered")
    if (late := _onset_delay(lift.curves)) is not None:
        parts.append(f"onset seen {late * 1e3:+.0f} ms")
    return "; ".join(parts)


def _onset_delay(curves: LiftCurves | None) -> float | None:
    if curves is None or curves.onset_truth_s is None or curves.onset_estimate_s is None:
        return None
    return curves.onset_estimate_s - curves.onset_truth_s
