"""The report of lifts from CSV tables, such as old data or data of another lab."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from drivers.errors import counted
from rig.pages.page import render
from rig.report.coverage import sigma_notices
from rig.report.csv_lifts import CsvLift, Tables
from rig.report.curves import signed_errors
from rig.report.distributions import boxes, error_against_angle, error_against_rate
from rig.report.explored import angle_panels, explored
from rig.report.lift_chart import key, lift_chart
from rig.report.parts import Chart, Notice, ReportPage, Table, linked
from rig.report.text import angle_text, made_text, mare_tile
from rig.report.trial_charts import Final, coverage_chart, finals_chart
from rig.results.metrics import FEWEST_LIFTS, INTERVAL, Mare, mare_of, mare_text


def curves_page(tables: Tables) -> ReportPage:
    """Return the report of such lifts as one HTML page."""
    value = mare_of(lift.errors for lift in tables.lifts)
    charts, table = _charts(tables), _table(tables, value)
    lifts = [_chart_of_lift(number, lift) for number, lift in enumerate(tables.lifts, start=1)]
    page = render(
        "rig.report",
        "curves.html",
        tiles=_tiles(tables, value),
        warnings=_notices(tables),
        table=table,
        charts=charts,
        lifts=lifts,
        key=key(states=False),
        interval=INTERVAL,
        title=f"Rotation of {counted(len(tables.lifts), 'lift')}",
        made=made_text(datetime.now(UTC)),
    )
    return ReportPage(page, [*charts, *lifts], table)


def _chart_of_lift(number: int, lift: CsvLift) -> Chart:
    data = explored(lift.curves, angle_panels(lift.curves))
    return replace(lift_chart(lift.curves, _caption(lift)), anchor=f"lift-{number}", explored=data)


def _charts(tables: Tables) -> list[Chart]:
    curves = [lift.curves for lift in tables.lifts]
    errors = {lift.curves.name: np.abs(signed_errors(lift.curves)) for lift in tables.lifts}
    finals = [
        Final(lift.curves.name, f"lift-{number}", lift.final_estimate_deg, lift.final_truth_deg)
        for number, lift in enumerate(tables.lifts, start=1)
    ]
    charts = [
        boxes(
            {name: values[np.isfinite(values)] for name, values in errors.items()},
            "Error per lift",
            "All frames with both angles: median, quartiles, whiskers from least to most.",
        ),
        finals_chart(finals),
        error_against_angle(curves),
        error_against_rate(curves),
        coverage_chart(curves),
    ]
    return [chart for chart in charts if chart is not None]


def _tiles(tables: Tables, value: Mare | None) -> list[tuple[str, str]]:
    return [
        (str(len(tables.lifts)), "lift" if len(tables.lifts) == 1 else "lifts"),
        mare_tile(value, "MARE over all frames"),
        (f"{np.mean([_answered(lift) for lift in tables.lifts]):.1%}", "of the rows have an estimate"),
    ]


def _table(tables: Tables, value: Mare | None) -> Table:
    rows = [
        [
            linked(lift.curves.name, {lift.curves.name: f"lift-{number}"}),
            f"{lift.errors.mean_deg:.2f} ± {lift.errors.std_deg:.2f}" if lift.errors else "no answer",
            f"{lift.errors.max_deg:.1f}" if lift.errors else "",
            angle_text(lift.final_estimate_deg),
            angle_text(lift.final_truth_deg),
            f"{lift.curves.onset_truth_s:.2f}" if lift.curves.onset_truth_s is not None else "none",
            f"{_answered(lift):.0%}",
            f"{np.ptp(lift.curves.truth.time_s):.2f}",
        ]
        for number, lift in enumerate(tables.lifts, start=1)
    ]
    rows.append(["all", mare_text(value), "", "", "", "", "", ""])
    columns = (
        "lift", "mean error, °", "largest, °", "final estimate", "final reference",
        "onset after the first row, s", "answered", "duration, s",
    )  # fmt: skip
    return Table(columns, rows, total=True, filters={1: "least"})


def _notices(tables: Tables) -> list[Notice]:
    notices = [
        Notice("warn", "A file was left out.", note.removeprefix("left out: ")) for note in tables.notes
    ]
    if len(tables.lifts) < FEWEST_LIFTS:
        advice = f"Below {FEWEST_LIFTS} lifts the mean has no interval, and one lift can decide."
        notices.append(Notice("warn", f"Only {counted(len(tables.lifts), 'lift')}.", advice))
    silent = [lift.curves.name for lift in tables.lifts if lift.errors is None]
    if silent:
        advice = "No row has both angles: see that the columns are the right ones and in degrees."
        notices.append(Notice("bad", f"No error can be computed for {', '.join(silent)}.", advice))
    return [*notices, *sigma_notices([lift.curves for lift in tables.lifts])]


def _caption(lift: CsvLift) -> str:
    if lift.errors is None:
        return "no frame has both angles"
    error = lift.errors
    return f"error {error.mean_deg:.2f} ± {error.std_deg:.2f}°, at most {error.max_deg:.1f}°"


def _answered(lift: CsvLift) -> float:
    return float(np.mean(np.isfinite(lift.curves.estimate.angle_deg)))
