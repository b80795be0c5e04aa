"""Texts about a lift of a trial: its row in the table of lifts, and the caption of its chart."""

from collections.abc import Sequence

from rig.report.curves import LiftCurves
from rig.report.parts import Table, linked
from rig.report.session import Lift, object_label


def anchor(lift: Lift) -> str:
    """Return a lift's id in the page."""
    return f"lift-{lift.row.number}"


def lift_table(lifts: Sequence[Lift]) -> Table:
    """Return a table with a row per lift and links to the charts."""
    columns = (
        "lift", "object", "outcome", "grasp", "grip", "mean error, °", "largest, °", "true turn, °",
        "answered", "onset seen, ms later",
    )  # fmt: skip
    rows = [_lift_row(lift) for lift in lifts]
    return Table(columns, rows, text=(0, 1, 2, 3), filters={1: "choose", 2: "choose", 5: "least"})


def _lift_row(lift: Lift) -> list[str]:
    row, late = lift.row, _onset_delay(lift.curves)
    return [
        linked(lift.name, {lift.name: anchor(lift)} if lift.curves else {}),
        object_label(row),
        row.outcome.value,
        row.position,
        str(row.grip_counts),
        *((f"{row.re.mean_deg:.2f}", f"{row.re.max_deg:.1f}") if row.re else ("no answer", "")),
        "" if row.final_truth_deg is None else f"{row.final_truth_deg:+.1f}",
        f"{row.answered:.0%}",
        "" if late is None else f"{late * 1e3:+.0f}",
    ]


def lift_caption(lift: Lift) -> str:
    """Return outcome, grip and error of a lift in one line."""
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
    """Return the delay of the estimated onset after that of the markers, s; None if either is missing."""
    if curves is None or curves.onset_truth_s is None or curves.onset_estimate_s is None:
        return None
    return curves.onset_estimate_s - curves.onset_truth_s
