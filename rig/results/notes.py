"""Make the printed lines about lifts and trials."""

from pathlib import Path
from statistics import median

from drivers.errors import counted
from rig.results.summary import ADVICE, ReactingSummary, TrialSummary, main_refusal
from rig.results.table import TableLift, table_lift
from rig.sessions.records import FailedLift, FinishedLift, LiftRow
from rig.sessions.table_files import ReplayRow


def lift_fault(row: LiftRow) -> str | None:
    """Return the fault that ended a lift; None without a fault."""
    return row.fault if isinstance(row, FailedLift) else None


def lift_note(row: LiftRow | TableLift) -> str:
    """Return a one-line summary of a lift's outcome."""
    head = f"{row.object} {row.name} lift {row.lift}: {row.outcome}"
    if isinstance(row, FailedLift):
        return f"{head}: {row.fault}"
    turn = row.final_truth_deg
    parts = [] if turn is None else [f"turned {turn:+.1f} deg"]
    parts.append(_without_error(row) if row.re is None else f"mean error {row.re.mean_deg:.2f} deg")
    if isinstance(row, FinishedLift):
        if row.reactions:
            parts.append(counted(len(row.reactions), "reaction"))
        parts += [f"WARNING: {warning}" for warning in row.warnings]
    return f"{head}, {', '.join(parts)}"


def _without_error(row: FinishedLift | TableLift) -> str:
    """Return why a lift has no error. A results table does not contain the states of the frames."""
    if row.answered:
        return "no error: no frame has both an estimate and a marker angle"
    if isinstance(row, TableLift):
        return "no answer"
    why = main_refusal([row.states])
    return f"no answer, most frames are '{why}': {ADVICE[why]}"


def row_note(row: ReplayRow) -> str:
    """Return a one-line summary of a replayed lift, with its session."""
    where = Path(row.session).name
    if row.problem:
        return f"{where}: {row.problem}"
    warning = f", WARNING: {row.estimator_fault}" if row.estimator_fault else ""
    return f"{where}: {lift_note(table_lift(row))}{warning}"


def reaction_text(reacting: ReactingSummary) -> str:
    """Return the line about the effect of reactions to slip."""
    added = reacting.added_counts
    grip = f", added grip: median {median(added):g}, at most {counted(max(added), 'step')}" if added else ""
    turn = f", median final turn {median(reacting.turns_deg):.1f} deg" if reacting.turns_deg else ""
    return (
        f"reaction to slip '{reacting.kind}': {reacting.caught} of {counted(reacting.lifts, 'lift')} caught, "
        f"{counted(reacting.reactions, 'reaction')}, {reacting.early} of them before half a degree"
        f"{grip}{turn}; "
        "these lifts turn less, so their MARE is listed separately from that of lifts without reaction"
    )


def turn_distribution(summary: TrialSummary) -> str:
    """Return a text with the histogram of the true turns in steps of 5 degrees, and their directions."""
    sizes = [abs(turn) for turn in summary.turns_deg]
    top = max(int(max(sizes, default=0.0) // 5) + 1, 1)
    counts = [sum(5 * i <= size < 5 * (i + 1) for size in sizes) for i in range(top)]
    steps = ", ".join(f"{5 * i}-{5 * i + 5}: {count}" for i, count in enumerate(counts))
    left = sum(turn > 0 for turn in summary.turns_deg)
    at_least_5 = sum(size >= 5.0 for size in sizes)
    return (
        f"lifts by true turn, degrees: {steps} ({at_least_5} of {len(sizes)} turned by 5 or more; "
        f"{left} counter-clockwise, {len(sizes) - left} clockwise)"
    )
