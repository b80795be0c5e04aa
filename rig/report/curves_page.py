"""The report of lifts from CSV tables with two angle curves each, from any tool."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import FormatError, InputError, plural
from drivers.formats import CsvTable, parse_number, quote, read_csv
from rig.lift.onset import slip_onset_ns
from rig.lift.result import FINAL_S
from rig.pages.page import render
from rig.report.advice import sigma_notices
from rig.report.charts import boxes, coverage_chart, error_against, finals_chart, key, lift_chart
from rig.report.explored import angle_panels, explorer_data
from rig.report.parts import (
    Notice,
    ReportPage,
    Table,
    anchor,
    angle_text,
    link_lifts,
    made_text,
    mare_tile,
    table_of,
)
from rig.results.metrics import FEWEST_LIFTS, INTERVAL, Floats, Mare, mare_of, mare_text, summarize
from rig.results.scores import AXIS_DEG, TURN_DEG, unwrap
from rig.sessions.records import Lift, lift_of_table
from rig.tactile.angles import FUSED, MARKERS, Angles

COLUMNS = {
    "time": ("t_s", "time_s", "time"),
    "estimate": ("estimate_deg", "pred_deg", "angle_deg"),
    "truth": ("truth_deg", "aruco_gt_deg", "aruco_deg", "marker_deg"),
    "sigma": ("sigma_deg",),
}
"""Accepted headings of each column; all but the sigma are needed."""
SETTLED_DEG, SETTLED_SHARE = 0.5, 0.05
"""Phase C begins when the reference stays within this distance of its final angle; or within this fraction of
its rotation."""
_REFUSED = ("", "nan", "none", "null", "na", "<na>")
_LARGEST = 9e9
"""Largest accepted number; larger times in s do not fit 64-bit integer nanoseconds."""


def read_tables(sources: Sequence[Path]) -> tuple[list[Lift], list[str]]:
    """Read CSV files, and the CSV files in folders; return the lifts, and notes.

    A given file without a lift is an error; for a file without a lift in a given folder a note is added.
    Raises `InputError` for that, and if there is no lift.
    """
    lifts, notes = [], []
    for source in sources:
        for path in sorted(source.glob("*.csv")) if source.is_dir() else [source]:
            try:
                lifts.append(read_table(path, len(lifts) + 1))
            except InputError as error:
                if path is source:
                    raise
                notes.append(f"left out: {error}")
    if not lifts:
        why = f"; {notes[0]}" if notes else ""
        needed = ", ".join(names[0] for what, names in COLUMNS.items() if what != "sigma")
        raise InputError(f"{sources[0]}: neither a session nor CSV files with columns {needed}{why}")
    return lifts, [*notes, *(note for lift in lifts for note in lift.notes)]


def read_table(path: Path, number: int = 1) -> Lift:
    """Read one CSV file as a lift with curves; its error is over all frames.

    number: of the lift in the report. Raises `InputError` naming the invalid column or line.
    """
    columns = _columns(path)
    time_s = columns["time"]
    if not np.isfinite(time_s).all() or (np.diff(time_s) <= 0.0).any():
        line = 2 + int(np.argmin(np.append(True, np.diff(time_s) > 0.0) & np.isfinite(time_s)))
        raise InputError(
            f"{path}: line {line}: the times do not increase; sort the rows and drop repeated ones"
        )
    time_s = time_s - time_s[0]  # tables may hold the time of day
    try:
        truth = Angles(time_s, columns["truth"])
        estimate = Angles(time_s, columns["estimate"], columns.get("sigma", np.empty(0)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    truth, notes = unwrap(f"{path}: the true angle", truth, AXIS_DEG)
    phases, onset_s = detected_phases(truth)
    estimate, more = unwrap(f"{path}: the estimate", estimate, TURN_DEG)
    lift = lift_of_table(
        number=number,
        name=path.stem.replace("_", " "),
        phases_s=phases,
        onset_truth_s=onset_s,
        onset_estimate_s=_onset_s(estimate),
        answered=float(np.mean(np.isfinite(estimate.angle_deg))),
        final_estimate_deg=_final_deg(estimate),
        final_truth_deg=_final_deg(truth),
        angles={FUSED: estimate, MARKERS: truth},
        notes=(*notes, *more),
    )
    return replace(lift, re=summarize(lift.errors()))


def detected_phases(truth: Angles) -> tuple[dict[str, float], float | None]:
    """Return the starts of phases A, B and C and the onset, from the reference only; none without a slip.

    B begins with the slip, and C when the angle stays near its final value.
    """
    onset_s, known, final = _onset_s(truth), truth.known, _final_deg(truth) or 0.0
    if onset_s is None:
        return {}, None
    away = np.abs(known.angle_deg - final) > max(SETTLED_DEG, SETTLED_SHARE * abs(final))
    settled_s = float(known.time_s[away].max(initial=onset_s))
    start_s, end_s = min(float(known.time_s[0]), onset_s), float(known.time_s[-1])
    return {"A": start_s, "B": onset_s, "C": settled_s, "lower": end_s + 1e-6}, onset_s


def _columns(path: Path) -> dict[str, Floats]:
    table = read_csv(path)
    heads = [head.lower() for head in table.columns]
    found: dict[str, Floats] = {}
    for what, names in COLUMNS.items():
        index = next((heads.index(name) for name in names if name in heads), None)
        if index is not None:
            found[what] = _numbers(table, index)
        elif what != "sigma":
            there = ", ".join(map(quote, heads[:8])) or "nothing"
            raise InputError(f"{path}: no column {' or '.join(names)}; it has {there}")
    if len(table.lines) < 2:
        raise InputError(f"{path}: holds {plural(len(table.lines), 'row')}; a curve needs at least two")
    return found


def _numbers(table: CsvTable, index: int) -> Floats:
    """Return the numbers of a column, NaN for refused frames. Raises `InputError` for an invalid number."""
    values = np.full(len(table.lines), np.nan)
    for number, (line, row) in enumerate(table.lines):
        cell = row[index] if index < len(row) else ""
        if cell.lower() in _REFUSED:
            continue
        try:
            values[number] = parse_number(cell)
        except FormatError as error:
            raise InputError(f"{table.where}: line {line}: {table.columns[index]} {error}") from error
        if abs(values[number]) > _LARGEST:
            raise InputError(f"{table.where}: line {line}: {quote(cell)} is beyond {_LARGEST:g}")
    return values


def _onset_s(curve: Angles) -> float | None:
    known, times_ns = curve.known, curve.known.time_ns
    if times_ns.size < 2 or (np.diff(times_ns) <= 0).any():
        return None
    onset_ns = slip_onset_ns(times_ns, known.angle_deg)
    return None if onset_ns is None else onset_ns / NS_PER_S


def _final_deg(curve: Angles) -> float | None:
    late = curve.angle_deg[curve.time_s >= curve.time_s[-1] - FINAL_S]
    late = late[np.isfinite(late)]
    return float(late.mean()) if late.size else None


def curves_page(lifts: Sequence[Lift], notes: Sequence[str]) -> ReportPage:
    """Return the report of lifts from tables. notes: see `read_tables`."""
    value = mare_of(lift.re for lift in lifts)
    about = "All frames with both angles: median, quartiles, whiskers from least to most."
    charts = [
        boxes({lift.name: lift.errors() for lift in lifts}, "Error per lift", about),
        finals_chart(lifts),
        error_against("Error against angle", lifts),
        error_against("Error against rate", lifts),
        coverage_chart(lifts),
    ]
    charts, table = [chart for chart in charts if chart is not None], _table(lifts, value)
    drawn = []
    for lift in lifts:
        chart, data = lift_chart(lift, _caption(lift)), explorer_data(lift, angle_panels(lift))
        drawn.append(replace(chart, anchor=anchor(lift), explored=data))
    page = render(
        "rig.report",
        "curves.html",
        tiles=[
            (str(len(lifts)), "lift" if len(lifts) == 1 else "lifts"),
            mare_tile(value, "MARE over all frames"),
            (f"{np.mean([lift.answered for lift in lifts]):.1%}", "of the rows have an estimate"),
        ],
        warnings=_notices(lifts, notes),
        table=table,
        charts=charts,
        lifts=drawn,
        key=key(states=False),
        interval=INTERVAL,
        title=f"Rotation of {plural(len(lifts), 'lift')}",
        made=made_text(),
    )
    return ReportPage(page, [*charts, *drawn], table)


def _table(lifts: Sequence[Lift], value: Mare | None) -> Table:
    return table_of(
        lifts,
        {
            "lift": lambda of: link_lifts(of.name, {of.name: anchor(of)}),
            "mean error, °": lambda of: (
                f"{e.mean_deg:.2f} ± {e.std_deg:.2f}" if (e := of.re) else "no answer"
            ),
            "largest, °": lambda of: f"{of.re.max_deg:.1f}" if of.re else "",
            "final estimate": lambda of: angle_text(of.final_estimate_deg),
            "final reference": lambda of: angle_text(of.final_truth_deg),
            "onset after the first row, s": lambda of: (
                "none" if of.onset_truth_s is None else f"{of.onset_truth_s:.2f}"
            ),
            "answered": lambda of: f"{of.answered:.0%}",
            "duration, s": lambda of: f"{np.ptp(of.truth.time_s):.2f}",
        },
        ["all", mare_text(value), *[""] * 6],
        filters={1: "least"},
    )


def _notices(lifts: Sequence[Lift], notes: Sequence[str]) -> list[Notice]:
    notices = [Notice("warn", "A file was left out.", note.removeprefix("left out: ")) for note in notes]
    if len(lifts) < FEWEST_LIFTS:
        advice = f"Below {FEWEST_LIFTS} lifts the mean has no interval, and one lift can decide."
        notices.append(Notice("warn", f"Only {plural(len(lifts), 'lift')}.", advice))
    if silent := [lift.name for lift in lifts if lift.re is None]:
        advice = "No row has both angles: see that the columns are the right ones and in degrees."
        notices.append(Notice("bad", f"No error can be computed for {', '.join(silent)}.", advice))
    return [*notices, *sigma_notices(lifts)]


def _caption(lift: Lift) -> str:
    if (error := lift.re) is None:
        return "no frame has both angles"
    return f"error {error.mean_deg:.2f} ± {error.std_deg:.2f}°, at most {error.max_deg:.1f}°"
