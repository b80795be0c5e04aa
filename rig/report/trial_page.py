"""The report of a trial."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from drivers.errors import counted
from drivers.progress import steps
from rig.pages.page import render
from rig.report.advice import trial_notices
from rig.report.calibrations import calibration_table
from rig.report.counts import counts_table, onset_delays_ms, onset_table, stage_table, state_table
from rig.report.curves import signed_errors
from rig.report.distributions import boxes, error_against_angle, error_against_rate, error_over_time
from rig.report.explored import angle_panels, explored, recorded_lift
from rig.report.groups import object_chart, surface_chart
from rig.report.lift_chart import key, lift_chart
from rig.report.lift_films import film_mark, with_films
from rig.report.lift_rows import anchor, lift_caption, lift_table
from rig.report.parts import Chart, Notice, ReportPage, Table, linked
from rig.report.reacted import beside
from rig.report.session import UNREADABLE, Trial, curves_of
from rig.report.strips import Still, strip
from rig.report.text import header, made_text, mare_tile
from rig.report.trial_charts import Final, coverage_chart, finals_chart, grip_chart, sigma_ratios
from rig.results.metrics import INTERVAL, mare_of, mare_text, summarize
from rig.results.summary import ObjectSummary, TrialSummary, summarize_trial
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.records import ErrorSummary, Lift

WORST_LIFTS = 3


def trial_page(trial: Trial, now: datetime | None = None, other: Trial | None = None) -> ReportPage:
    """Return the report of a trial as one HTML page.

    other: the same lifts without a reaction to slip, or with one. Raises `InputError` for any other session.
    """
    now = now or datetime.now(UTC)
    summary = summarize_trial(trial.rows)
    anchors = {lift.title: anchor(lift) for lift in trial.lifts if lift.curves is not None}
    charts, lifts = _charts(trial), _charts_of_lifts(trial)
    objects = object_table(summary) if summary.objects else None
    page = render(
        "rig.report",
        "trial.html",
        trial=trial,
        manifest=trial.manifest,
        head=header(trial.manifest, "Slip trial"),
        tiles=_tiles(trial, summary),
        warnings=[
            replace(notice, what=linked(notice.what, anchors), advice=linked(notice.advice, anchors))
            for notice in trial_notices(trial, now)
        ],
        objects=objects,
        fingertips=fingertip_table(trial.lifts) if lifts else None,
        reacted=None if other is None else beside(trial, other),
        charts=charts,
        worst=_worst(trial),
        lifts=lifts,
        lift_table=lift_table(trial.lifts),
        key=key(),
        interval=INTERVAL,
        stages=stage_table(trial.timing),
        counts=counts_table(trial.lifts),
        onsets=onset_table(trial.lifts),
        states=state_table(trial.lifts),
        calibrations=calibration_table(trial.manifest, now),
        made=made_text(now),
    )
    return ReportPage(with_films(page, trial), [*charts, *lifts], objects, trial.manifest.simulated)


def object_table(summary: TrialSummary) -> Table:
    """Return the table of the error per object over B, and over B and C."""
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
    what = (
        f"lifts caught by the reaction to slip '{reacting.kind}'; their MARE is separate from that of others"
    )
    return [(f"{reacting.caught} of {reacting.lifts}", what)]


def _tiles(trial: Trial, summary: TrialSummary) -> list[tuple[str, str]]:
    tiles = [
        (counted(summary.lifts_accepted, "lift"), f"of {counted(len(summary.objects), 'object')}"),
        *_reaction_tile(summary),
        mare_tile(summary.mare, "MARE in B and C"),
        mare_tile(summary.mare_b, "MARE in B (the paper, on its real bench: 1.85°)"),
        mare_tile(summary.mare_held, "MARE if refused frames keep the last angle"),
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
        Final(lift.title, anchor(lift), lift.final_estimate_deg, lift.final_truth_deg) for lift in trial.lifts
    ]
    charts = [
        object_chart(trial.lifts),
        finals_chart(finals),
        coverage_chart(lifts),
        error_over_time(lifts),
        error_against_angle(lifts),
        error_against_rate(lifts),
        grip_chart(trial.lifts),
        _onset_chart(trial.lifts),
        surface_chart(trial.lifts, trial.manifest.config.objects),
    ]
    return [chart for chart in charts if chart is not None]


def _onset_chart(rows: Sequence[Lift]) -> Chart | None:
    delays = onset_delays_ms(rows)
    if not any(late_ms.size for late_ms in delays.values()):
        return None
    caption = "Delay after the onset of the markers, over the lifts in which both were found."
    return boxes(delays, "Onset latency", caption, "later than the markers' onset, ms", least=None)


def fingertip_table(lifts: Sequence[Lift]) -> Table:
    """Return a table with the MARE of the fused angle and of each fingertip, from the recorded curves."""
    curves = curves_of(lifts)
    serials = dict.fromkeys(serial for lift in curves for serial in lift.tips)
    sources = {"both, fused": curves}
    sources |= {s: [replace(c, estimate=c.tips[s]) for c in curves if s in c.tips] for s in serials}
    rows = []
    for name, own in sources.items():
        mares = (mare_text(mare_of(_errors(lift, phases) for lift in own)) for phases in ("B", "BC"))
        known = [np.isfinite(c.estimate.angle_deg[c.within("B", "C")]) for c in own]
        answered = [frames.mean() for frames in known if frames.size]
        rows.append([name, *mares, f"{np.mean(answered):.1%}" if answered else "-"])
    return Table(("angle of", "MARE in B, °", "MARE in B and C, °", "answered"), rows)


def _errors(lift: LiftCurves, phases: str) -> ErrorSummary | None:
    errors = np.abs(signed_errors(lift)[lift.within(*phases)])
    return summarize(errors[np.isfinite(errors)])


def _worst(trial: Trial) -> list[dict[str, object]]:
    """Return the lifts with the largest mean error, with their frames."""
    known = [(lift.re.mean_deg, lift, lift.curves) for lift in trial.lifts if lift.re and lift.curves]
    ranked = sorted(known, key=lambda entry: -entry[0])
    return [_with_strips(trial, lift, curves) for _, lift, curves in ranked[:WORST_LIFTS]]


def _with_strips(trial: Trial, lift: Lift, curves: LiftCurves) -> dict[str, object]:
    strips: dict[str, list[Still]] = {}
    problem: Notice | None = None
    path, signs = trial.folder / lift.recording, trial.manifest.signs
    for serial in trial.manifest.serials:
        name = serial if serial in signs else f"camera {serial}, marker angle"
        try:
            strips[name] = strip(path, curves, lift.zero_ns, serial, signs.get(serial))
        except UNREADABLE as error:
            problem = Notice("bad", f"The frames of {serial} cannot be shown.", str(error))
    chart = lift_chart(curves, lift_caption(lift))
    return {"chart": chart, "strips": strips, "problem": problem, "anchor": anchor(lift)}


def _charts_of_lifts(trial: Trial) -> list[Chart]:
    lifts = steps(trial.lifts)
    return [_chart_of_lift(trial, lift, lift.curves) for lift in lifts if lift.curves is not None]


def _chart_of_lift(trial: Trial, lift: Lift, curves: LiftCurves) -> Chart:
    try:
        path = trial.folder / lift.recording
        data = recorded_lift(path, curves, lift.zero_ns, film_mark(lift))
    except UNREADABLE:  # the page has a notice about the damaged recording
        data = explored(curves, angle_panels(curves))
    return replace(lift_chart(curves, lift_caption(lift)), anchor=anchor(lift), explored=data)
