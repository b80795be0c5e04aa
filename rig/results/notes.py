"""Make the printed lines about lifts and trials."""

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from drivers.errors import plural
from rig.results.summary import ADVICE, ReactingSummary, TrialSummary, main_refusal
from rig.results.table import Agreement, table_lift
from rig.sessions.manifest import Manifest, TrialManifest, begin_manifest
from rig.sessions.records import Lift
from rig.sessions.table_files import Line

SAME_DEG = 0.05
"""Largest difference of a replay on another kind of processor (contract). With the libraries' code for
processors without AVX, an easy and a hard lift of each object: slip 0.0013; pca, skeleton, ellipse 1e-8."""


def lift_note(lift: Lift) -> str:
    head = f"{lift.object} {lift.name} lift {lift.lift}: {lift.outcome}"
    if not lift.accepted:
        return f"{head}: {lift.fault}"
    turn = lift.final_truth_deg
    parts = [] if turn is None else [f"turned {turn:+.1f} deg"]
    parts.append(_without_error(lift) if lift.re is None else f"mean error {lift.re.mean_deg:.2f} deg")
    if lift.reactions:
        parts.append(plural(len(lift.reactions), "reaction"))
    parts += [f"WARNING: {warning}" for warning in lift.warnings]
    return f"{head}, {', '.join(parts)}"


def _without_error(lift: Lift) -> str:
    """Return why a lift has no error. A results table does not contain the states of the frames."""
    if lift.answered:
        return "no error: no frame has both an estimate and a marker angle"
    if not lift.states:
        return "no answer"
    why = main_refusal([lift.states])
    return f"no answer, most frames are '{why}': {ADVICE[why]}"


def row_note(row: Line) -> str:
    where = Path(str(row["session"])).name
    if row["problem"]:
        return f"{where}: {row['problem']}"
    warning = f", WARNING: {row['estimator_fault']}" if row["estimator_fault"] else ""
    return f"{where}: {lift_note(table_lift(row))}{warning}"


def agreement_text(found: Agreement, stored: Sequence[TrialManifest] = ()) -> str:
    """Return how replayed lifts agree with the stored ones, and what differs between session and replay.

    stored: manifests of the sessions, if they are known.
    """
    text = f"{found.identical} of {plural(found.lifts, 'lift')} exactly as stored"
    if found.identical == found.lifts:
        return text
    if found.difference_deg is None:
        text += ", an angle is missing in a stored or a replayed lift"
    elif found.difference_deg <= SAME_DEG:
        text += f", the others within {SAME_DEG:g} degrees ({found.difference_deg:.2g})"
    else:
        text += f", others differ by up to {found.difference_deg:.2g} degrees"
    if not stored:
        return text
    there, here = sorted({*map(_origin, stored)}), _origin(begin_manifest("replay"))
    if there == [here]:
        text += f"; both by {here}: another commit or another version of a library"
    else:
        text += f"; stored by {', '.join(there)}, replayed by {here}"
    if any(manifest.markers_only for manifest in stored):
        text += "; --markers-only has stored parts of the camera's pictures, so true angles differ slightly"
    return text


def _origin(manifest: Manifest) -> str:
    return f"version {manifest.tool_version} on {manifest.processor or 'an unknown processor'}"


def reaction_text(reacting: ReactingSummary) -> str:
    added = reacting.added_counts
    grip = f", added grip: median {median(added):g}, at most {plural(max(added), 'step')}" if added else ""
    turn = f", median final turn {median(reacting.turns_deg):.1f} deg" if reacting.turns_deg else ""
    return (
        f"reaction to slip '{reacting.kind}': {reacting.caught} of {plural(reacting.lifts, 'lift')} caught, "
        f"{plural(reacting.reactions, 'reaction')}, {reacting.early} of them before half a degree"
        f"{grip}{turn}; "
        "these lifts turn less, so their MARE is listed separately from that of lifts without reaction"
    )


def turn_distribution(summary: TrialSummary) -> str:
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
