"""Texts about a lift of a trial: its row in the table of lifts, and the caption of its chart."""

from collections.abc import Sequence

from rig.report.parts import Table, linked
from rig.sessions.records import SHOWN, Lift


def anchor(lift: Lift) -> str:
    """Return a lift's id in the page."""
    return f"lift-{lift.number}"


def lift_table(lifts: Sequence[Lift]) -> Table:
    """Return a table with a row per lift and links to the charts; `Lift` declares the further columns."""
    filters = {2 + number: column.filter for number, column in enumerate(SHOWN) if column.filter}
    rows = [
        [
            linked(lift.title, {lift.title: anchor(lift)} if lift.curves else {}),
            lift.label,
            *(column.text(lift) for column in SHOWN),
        ]
        for lift in lifts
    ]
    columns = ("lift", "object", *(column.heading for column in SHOWN))
    return Table(columns, rows, text=(0, 1, 2, 3), filters={1: "choose", **filters})


def lift_caption(lift: Lift) -> str:
    """Return outcome, grip and error of a lift in one line."""
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
        parts.append(f"onset seen {late * 1e3:+.0f} ms")
    return "; ".join(parts)
