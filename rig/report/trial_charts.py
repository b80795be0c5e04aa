"""Figures over all lifts of a trial: grip and outcome, coverage of sigma, final angles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import MaxNLocator

from rig.pages.figure import drawing, legend_above
from rig.pages.palette import BAD, ESTIMATE, GOOD, MUTED, SECOND, TRUTH
from rig.pages.plot_data import Spot
from rig.report.curves import signed_errors
from rig.report.distributions import FEWEST_FRAMES
from rig.report.lift_rows import anchor
from rig.report.parts import Chart
from rig.results.metrics import Floats
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.records import Lift, LiftOutcome

_OUTCOMES = {
    LiftOutcome.SLIPPED: ESTIMATE,
    LiftOutcome.HELD: GOOD,
    LiftOutcome.CAUGHT: SECOND,
    LiftOutcome.FALLEN: BAD,
}


def grip_chart(lifts: Sequence[Lift]) -> Chart | None:
    """Draw the true final rotation of each lift over its grip, by outcome; None without ground truth."""
    known = [(lift, abs(turn)) for lift in lifts if (turn := lift.final_truth_deg)]
    if not known:
        return None
    with drawing(250) as figure:
        axes = figure.subplots()
        for (outcome, colour), marker in zip(_OUTCOMES.items(), "osD^", strict=True):
            own = [(lift.grip_counts, turn) for lift, turn in known if lift.outcome is outcome]
            if own:
                axes.plot(*zip(*own, strict=True), marker, color=colour.light, markersize=5, alpha=0.75,
                          label=outcome.value)  # fmt: skip
        axes.set(xlabel="grip, steps past first contact", ylabel="true turn at the end, degrees")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        legend_above(axes, 4)
        caption = "One symbol per lift: the absolute true turn at its end."
        spots = [
            Spot(lift.grip_counts, turn, f"{lift.title}: grip {lift.grip_counts}, turned {turn:.1f}°, "
                 f"{lift.outcome.value}", anchor(lift))
            for lift, turn in known
        ]  # fmt: skip
        return Chart("Grip and outcome", figure, caption, spots=spots)


def coverage_chart(lifts: Sequence[LiftCurves]) -> Chart | None:
    """Draw the fraction of errors within multiples of the reported sigma; None without sigmas."""
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return None
    from scipy.stats import norm

    multiples = np.linspace(0.0, 4.0, 41)
    seen = [float(np.mean(ratios <= m)) * 100.0 for m in multiples]
    normal = (2 * norm.cdf(multiples) - 1) * 100.0
    with drawing(250) as figure:
        axes = figure.subplots()
        axes.plot(multiples, normal, color=MUTED.light, dashes=(2, 2), label="normal errors")
        axes.plot(multiples, seen, color=ESTIMATE.light, label="this trial")
        axes.set(
            xlabel="multiple of the reported sigma", ylabel="frames within, %", xlim=(0, 4), ylim=(0, 102)
        )
        legend_above(axes, 2)
        title = "Does sigma cover the error?"
        caption = "Below the dashed line sigma is too small, above it too large. Frames of B and C."
        spots = [
            Spot(
                float(m),
                share,
                f"within {m:.1f} sigma: {share:.1f} % of the frames; normal errors: {n:.1f} %",
            )
            for m, share, n in zip(multiples, seen, normal, strict=True)
        ]
        return Chart(title, figure, caption, spots=spots)


def sigma_ratios(lifts: Sequence[LiftCurves]) -> Floats:
    """Return |error| / sigma of all frames with an angle in B and C, (N,)."""
    parts = [np.zeros(0)]
    for lift in lifts:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(signed_errors(lift)) / lift.estimate.sigma_deg
        parts.append(ratio[lift.within("B", "C") & np.isfinite(ratio)])
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True)
class Final:
    """Angles at the end of a lift in deg, None if unknown. anchor: the lift's id in the page."""

    name: str
    anchor: str
    estimate_deg: float | None
    truth_deg: float | None


def finals_chart(lifts: Sequence[Final]) -> Chart | None:
    """Final estimate against final marker angle of each lift that has both; None if no lift has both."""
    spots = [
        Spot(lift.truth_deg, lift.estimate_deg, f"{lift.name}: estimate {lift.estimate_deg:+.1f}°, markers "
             f"{lift.truth_deg:+.1f}°", lift.anchor)
        for lift in lifts
        if lift.estimate_deg is not None and lift.truth_deg is not None
    ]  # fmt: skip
    if not spots:
        return None
    pairs = np.array([(spot.y, spot.x) for spot in spots])
    estimates, truths = pairs.T
    with drawing(290) as figure:
        axes = figure.subplots()
        low, high = min(0.0, float(np.min(pairs))), max(0.0, float(np.max(pairs)))
        room = 0.05 * max(high - low, 2.0)
        reach = (low - room, high + room)
        axes.plot(reach, reach, color=TRUTH.light, dashes=(4, 1.2), label="marker angle")
        axes.plot(
            truths, estimates, "o", markersize=5, color=ESTIMATE.light, alpha=0.75,
            label="estimate, one per lift",
        )  # fmt: skip
        axes.set(xlabel="final marker angle, degrees", ylabel="final estimate, degrees", aspect="equal")
        axes.set(xlim=reach, ylim=reach)
        legend_above(axes, 2)
        title = "Final angles"
        caption = "Means over the end of C. Points on the line have no error."
        return Chart(title, figure, caption, spots=spots)
