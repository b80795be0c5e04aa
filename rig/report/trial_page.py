"""The report of a trial."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from drivers.errors import InputError, plural
from protocols.reaction import ReactionKind
from rig.experiments.process_pool import run_in_order
from rig.pages.page import render
from rig.report import charts
from rig.report.advice import calibration_table, trial_notices
from rig.report.charts import common_ranges, key, lift_chart
from rig.report.explored import angle_panels, explorer_data, film_mark, recorded_lift, with_films
from rig.report.parts import (
    Chart,
    Notice,
    ReportPage,
    Table,
    anchor,
    header,
    link_lifts,
    made_text,
    mare_tile,
    table_of,
)
from rig.report.session import UNREADABLE, Trial, with_angles
from rig.report.strips import Still, stored_images, strip
from rig.results.limits import LIMIT_HEADINGS, apply_limits, limit_rows
from rig.results.metrics import (
    FEWEST_LIFTS,
    INTERVAL,
    USEFUL_SIGMA_DEG,
    Floats,
    mare_of,
    mare_text,
    summarize,
)
from rig.results.summary import TrialSummary, summarize_trial
from rig.sessions.records import SHOWN, Lift, LiftOutcome, LiftTiming, StageTimes, totals
from rig.tactile.angles import FUSED

WORST_LIFTS = 3
MOST_PAIRS = 3


def trial_page(
    trial: Trial, other: Trial | None = None, now: datetime | None = None, jobs: int = 1
) -> ReportPage:
    """Return the report of a trial as one HTML page.

    other: the same lifts without a reaction to slip, or with one. jobs: processes that draw; with several,
    the charts of lifts have no figure. Raises `InputError` for any other session.
    """
    now = now or datetime.now(UTC)
    summary = summarize_trial(trial.rows)
    anchors = {lift.title: anchor(lift) for lift in with_angles(trial.lifts)}
    figures = _charts(trial)
    draw = partial(_drawn_lift, trial.folder, jobs == 1)
    lifts = list(run_in_order(draw, with_angles(trial.lifts), jobs))
    by_anchor = {chart.anchor: replace(chart, anchor="") for chart in lifts}
    objects = object_table(summary) if summary.objects else None
    known = [(lift.re.mean_deg, lift) for lift in with_angles(trial.lifts) if lift.re]
    worst = sorted(known, key=lambda entry: -entry[0])[:WORST_LIFTS]
    page = render(
        "rig.report",
        "trial.html",
        trial=trial,
        manifest=trial.manifest,
        head=header(trial.manifest, "Slip trial"),
        tiles=_tiles(trial, summary),
        warnings=[
            replace(notice, what=link_lifts(notice.what, anchors), advice=link_lifts(notice.advice, anchors))
            for notice in trial_notices(trial, now)
        ],
        objects=objects,
        limits=_limit_table(trial),
        fingertips=fingertip_table(trial.lifts) if lifts else None,
        reacted=None if other is None else beside(trial, other),
        charts=figures,
        worst=[_with_strips(trial, lift, by_anchor[anchor(lift)]) for _, lift in worst],
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
    return ReportPage(with_films(page, trial, jobs), [*figures, *lifts], objects, trial.manifest.simulated)


def _drawn_lift(folder: Path, keep_figure: bool, lift: Lift) -> Chart:
    """Return the chart of a lift, drawn, with the data for the page's program."""
    data = explorer_data(lift, angle_panels(lift))
    with suppress(*UNREADABLE):  # the page has a notice about the damaged recording
        data = recorded_lift(folder / lift.recording, lift, film_mark(lift))
    chart = lift_chart(lift, lift_caption(lift))
    figure = chart.figure if keep_figure else None
    return replace(chart, anchor=anchor(lift), explored=data, drawn=chart.draw(), figure=figure)


def _limit_table(trial: Trial) -> Table | None:
    """Return the table of limits, None without any."""
    found = apply_limits(trial.manifest.config.limits, trial.rows, trial.timing)
    return Table(LIMIT_HEADINGS, limit_rows(found), text=(0, 1, 3)) if found else None


def object_table(summary: TrialSummary) -> Table:
    return table_of(
        summary.objects,
        {
            "object": lambda o: o.name,
            "MARE in B, °": lambda o: mare_text(o.mare_b),
            "MARE in B and C, °": lambda o: mare_text(o.mare),
            "lifts": lambda o: str(o.lifts_accepted),
            "true turn, °": lambda o: o.turn_text,
            "answered": lambda o: f"{o.answered:.1%}",
            "outcomes": lambda o: o.outcomes_text,
        },
        ["all", mare_text(summary.mare_b), mare_text(summary.mare), str(summary.lifts_accepted), "",
         f"{summary.answered:.1%}", ""],
        text=(0, 6),
    )  # fmt: skip


def _tiles(trial: Trial, summary: TrialSummary) -> list[tuple[str, str]]:
    tiles = [(plural(summary.lifts_accepted, "lift"), f"of {plural(len(summary.objects), 'object')}")]
    if reacting := summary.reacting:
        what = (
            f"lifts caught by the reaction to slip '{reacting.kind}'; their MARE is separate from that "
            "of others"
        )
        tiles.append((f"{reacting.caught} of {reacting.lifts}", what))
    tiles += [
        mare_tile(summary.mare, "MARE in B and C"),
        mare_tile(summary.mare_b, "MARE in B (the paper, on its real bench: 1.85°)"),
        mare_tile(summary.mare_held, "MARE if refused frames keep the last angle"),
        (f"{summary.answered:.1%}", "of the frames answered"),
    ]
    shares = [share for lift in with_angles(trial.lifts) if (share := charts.useful_share(lift)) is not None]
    if shares:
        what = f"useful answers (sigma at most {USEFUL_SIGMA_DEG:g}°)"
        tiles.append((f"{np.mean(shares):.1%}", what))
    ratios = charts.sigma_ratios(with_angles(trial.lifts))
    if ratios.size:
        tiles.append((f"{np.mean(ratios <= 2.0):.1%}", "of the errors within 2 sigma; 95 % should be"))
    return tiles


def _charts(trial: Trial) -> list[Chart]:
    lifts = with_angles(trial.lifts)
    if not lifts:
        return []
    delays, onset_chart = onset_delays_ms(trial.lifts), None
    if any(late_ms.size for late_ms in delays.values()):
        caption = "Delay after the onset of the markers, over the lifts in which both were found."
        onset_chart = charts.boxes(
            delays, "Onset latency", caption, "later than the markers' onset, ms", least=None
        )
    found = [
        charts.object_chart(trial.lifts),
        charts.finals_chart(trial.lifts),
        charts.coverage_chart(lifts),
        *(charts.error_against(title, lifts) for title in charts.AGAINST),
        charts.grip_chart(trial.lifts),
        onset_chart,
        charts.surface_chart(trial.lifts, trial.manifest.config.objects),
    ]
    return [chart for chart in found if chart is not None]


def fingertip_table(lifts: Sequence[Lift]) -> Table:
    """Return a table with the MARE of the fused angle and of each fingertip, from the recorded curves."""
    lifts = with_angles(lifts)
    sources = {"both, fused": lifts}
    for serial in dict.fromkeys(serial for lift in lifts for serial in lift.tips):
        tips = ((lift, lift.tips.get(serial)) for lift in lifts)
        sources[serial] = [
            replace(of, angles={**(of.angles or {}), FUSED: tip}) for of, tip in tips if tip is not None
        ]
    rows = []
    for name, own in sources.items():
        mares = (mare_text(mare_of(summarize(c.errors(*phases)) for c in own)) for phases in ("B", "BC"))
        known = [np.isfinite(c.estimate.angle_deg[c.within("B", "C")]) for c in own]
        answered = [frames.mean() for frames in known if frames.size]
        rows.append([name, *mares, f"{np.mean(answered):.1%}" if answered else "-"])
    return Table(("angle of", "MARE in B, °", "MARE in B and C, °", "answered"), rows)


def _with_strips(trial: Trial, lift: Lift, chart: Chart) -> dict[str, object]:
    strips, problem = dict[str, list[Still]](), None
    path, signs = trial.folder / lift.recording, trial.manifest.signs
    for serial in trial.manifest.serials:
        name = serial if serial in signs else f"camera {serial}, marker angle"
        try:
            stored = stored_images(path, [serial])
            strips[name] = strip(path, stored, lift, serial, signs.get(serial))
        except UNREADABLE as error:
            problem = Notice("bad", f"The frames of {serial} cannot be shown.", str(error))
    return {"chart": chart, "strips": strips, "problem": problem, "anchor": anchor(lift)}


def lift_table(lifts: Sequence[Lift]) -> Table:
    """Return a table with a row per lift and links to the charts; `Lift` declares the further columns."""
    return table_of(
        lifts,
        {
            "lift": lambda lift: link_lifts(lift.title, {lift.title: anchor(lift)} if lift.angles else {}),
            "object": lambda lift: lift.label,
            **{column.heading: column.text for column in SHOWN},
        },
        text=(0, 1, 2, 3),
        filters={1: "choose"} | {2 + n: column.filter for n, column in enumerate(SHOWN) if column.filter},
    )


def lift_caption(lift: Lift) -> str:
    error = lift.re
    parts = [
        f"{lift.outcome}, {lift.position}, grip {lift.grip_counts}",
        f"error {error.mean_deg:.2f} ± {error.std_deg:.2f}°, at most {error.max_deg:.1f}°"
        if error
        else "no answer",
    ]
    if lift.answered < 1.0:
        parts.append(f"{lift.answered:.0%} answered")
    if (late := lift.onset_delay_s) is not None:
        parts.append(f"onset seen {late * 1e3:+z.0f} ms")
    return "; ".join(parts)


def stage_table(timing: Sequence[LiftTiming]) -> Table | None:
    """Return a table of the wall time per stage and frame: percentiles of the median and the worst lift."""
    stages: dict[str, list[StageTimes]] = {}
    for row in timing:
        for name, spent in row.stages.items():
            stages.setdefault(name, []).append(spent)
    if not stages:
        return None
    middle = {
        n: np.median([(s.p50_ms, s.p95_ms, s.p99_ms) for s in own], axis=0) for n, own in stages.items()
    }
    rows = [
        [name, *(f"{ms:.2f}" for ms in middle[name]), f"{max(spent.p99_ms for spent in stages[name]):.2f}"]
        for name in sorted(stages, key=lambda name: (name == "total", -middle[name][0]))
    ]
    columns = ("stage", "median, ms", "95 %, ms", "99 %, ms", "99 % in the worst lift, ms")
    return Table(columns, rows, total=True)


def counts_table(rows: Sequence[Lift]) -> Table | None:
    frames, dropped = totals(rows, "frames"), totals(rows, "dropped")
    cells = [[source, f"{frames[source]}", f"{dropped[source]}"] for source in frames]
    return Table(("source", "frames", "dropped"), cells) if frames else None


def onset_delays_ms(rows: Sequence[Lift]) -> dict[str, Floats]:
    """Return the delays of the estimated onset and of the slip event after the true onset, (N,) ms.

    The slip event is compared with `slip_start_s`, which also exists if a reaction stops the rotation early.
    """
    seen = {
        "estimated curve": [(row.onset_estimate_s, row.onset_truth_s) for row in rows],
        "slip event": [(row.onset_alarm_s, row.slip_start_s) for row in rows],
    }
    return {
        name: np.array([(s - t) * 1e3 for s, t in onsets if s is not None and t is not None], float)
        for name, onsets in seen.items()
    }


def onset_table(rows: Sequence[Lift]) -> Table | None:
    """Return a table of medians and 90 % ranges of `onset_delays_ms`; None if no lift has a true slip.

    Below `FEWEST_LIFTS` delays there is no range.
    """
    slips = [
        sum(row.onset_truth_s is not None for row in rows),
        sum(row.slip_start_s is not None for row in rows),
    ]
    if not any(slips):
        return None
    still = [row for row in rows if row.slip_start_s is None and not row.reactions]
    unasked = (
        sum(row.onset_estimate_s is not None for row in still),
        sum(row.onset_alarm_s is not None for row in still),
    )
    cells = []
    for (name, late_ms), true, false in zip(onset_delays_ms(rows).items(), slips, unasked, strict=True):
        middle, ends = f"{np.median(late_ms):+z.0f}" if late_ms.size else "-", ["-", "-"]
        if late_ms.size >= FEWEST_LIFTS:
            ends = [f"{v:+z.0f}" for v in np.percentile(late_ms, [5, 95])]
        cells.append([name, f"{late_ms.size} of {true}", middle, *ends, str(false)])
    columns = ("onset by", "slips seen", "median, ms", "5 %, ms", "95 %, ms", "in lifts without a slip")
    return Table(columns, cells)


def state_table(rows: Sequence[Lift]) -> Table | None:
    """Return a table of the estimator's states, its skipped stages, and disagreements of the fingertips."""
    kinds = {"state:": "states", "skipped:": "skipped", "fingertips apart:": "disagreements"}
    frames = totals(rows, "states").total()
    cells = [
        [f"{kind} {name.replace('_', ' ')}", f"{count}", f"{count / frames:.1%}"]
        for kind, figure in kinds.items()
        for name, count in (totals(rows, figure).items() if frames else ())
    ]
    return Table(("of all tactile frames", "frames", "share"), cells) if frames else None


def beside(trial: Trial, other: Trial) -> dict[str, object]:
    """Compare lifts of equal object, number and seed, of a trial that reacts to slip and one that does not.

    Returns the table of all lifts, the folders, and pairs of charts: without and with a reaction. Raises
    `InputError` if both or neither react, or if there is no pair.
    """
    reacts = [each.manifest.react is not ReactionKind.NONE for each in (trial, other)]
    if reacts[0] == reacts[1]:
        both = "both react" if reacts[0] else "neither reacts"
        raise InputError(
            f"{trial.folder}, {other.folder}: {both} to slip; give one with --react beside one without"
        )
    without, reacted = (other, trial) if reacts[0] else (trial, other)
    kept = {(lift.object, lift.lift, lift.seed): lift for lift in without.lifts}
    found = [(kept.get((lift.object, lift.lift, lift.seed)), lift) for lift in reacted.lifts]
    pairs = [(before, lift) for before, lift in found if before is not None]
    if not pairs:
        raise InputError(
            f"{other.folder}: no lift of the same object, number and seed as in {trial.folder}; repeat "
            "them with the same --seed"
        )
    table = table_of(
        pairs,
        {
            "lift": lambda pair: pair[1].title,
            "true end turn without, °": lambda pair: _turn(pair[0]),
            "with, °": lambda pair: _turn(pair[1]),
            "reactions": lambda pair: str(len(pair[1].reactions or ())),
            "grip steps added": lambda pair: str(pair[1].counts_added or 0),
            "outcome": lambda pair: pair[1].outcome.value,
        },
        text=(0, 5),
    )
    return {
        "table": table, "pairs": _pairs(pairs), "without": without.folder, "reacted": reacted.folder,
    }  # fmt: skip


def _pairs(both: Sequence[tuple[Lift, Lift]]) -> list[list[Chart]]:
    """Return the charts of caught lifts with the largest reduction of the final rotation."""
    caught = [pair for pair in both if pair[1].outcome is LiftOutcome.CAUGHT]
    caught.sort(key=lambda pair: abs(pair[1].final_truth_deg or 0.0) - abs(pair[0].final_truth_deg or 0.0))
    drawn = []
    for pair in caught:
        if len(with_angles(pair)) == len(pair) and len(drawn) < MOST_PAIRS:
            ranges = common_ranges(pair)
            drawn.append([lift_chart(lift, _reaction_caption(lift), ranges) for lift in pair])
    return drawn


def _reaction_caption(row: Lift) -> str:
    if not row.reactions:
        return f"without a reaction: turned {_turn(row)}°, {row.outcome.value}"
    return (
        f"with '{row.react.value}': turned {_turn(row)}°; {plural(len(row.reactions), 'reaction')}, "
        f"the first {row.reactions[0].command_s:.2f} s into the lift, "
        f"{plural(row.counts_added or 0, 'grip step')} added"
    )


def _turn(row: Lift) -> str:
    return "-" if row.final_truth_deg is None else f"{row.final_truth_deg:+.1f}"
