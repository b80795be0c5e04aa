"""Warnings about a sigma that is too small, over all lifts and for single lifts."""

from collections.abc import Sequence

import numpy as np

from rig.report.distributions import FEWEST_FRAMES
from rig.report.parts import Notice, joined
from rig.report.trial_charts import sigma_ratios
from rig.sessions.lift_curves import LiftCurves

LEAST_COVERED = 0.90
MOST_BEYOND = 0.3
"""Accepted fraction of a lift's frames with an error beyond 2 sigma; the expected fraction is 5 %."""


def sigma_notices(lifts: Sequence[LiftCurves]) -> list[Notice]:
    """Return the warnings; none for lifts without a sigma."""
    return [*_overall(lifts), *_single(lifts)]


def _overall(lifts: Sequence[LiftCurves]) -> list[Notice]:
    ratios = sigma_ratios(lifts)
    if ratios.size < FEWEST_FRAMES:
        return []
    covered = float(np.mean(ratios <= 2.0))
    if covered >= LEAST_COVERED:
        return []
    factor = float(np.percentile(ratios, 95.0)) / 2.0
    what = f"Sigma is too small: {covered:.0%} of the errors are within 2 sigma, 95 % should be."
    return [Notice("warn", what, f"Read the bands as if they were {factor:.1f} times as wide.")]


def _single(lifts: Sequence[LiftCurves]) -> list[Notice]:
    """Warn of single lifts, worst first, because the fraction over all lifts can hide them."""
    shares: list[tuple[float, str]] = []
    for lift in lifts:
        ratios = sigma_ratios([lift])
        if ratios.size >= FEWEST_FRAMES and (beyond := float(np.mean(ratios > 2.0))) > MOST_BEYOND:
            shares.append((beyond, lift.name))
    if not shares:
        return []
    named = joined([f"{name} ({share:.0%})" for share, name in sorted(shares, reverse=True)])
    what = f"More than {MOST_BEYOND:.0%} of the frames are beyond 2 sigma in {named}."
    advice = (
        "Their errors are larger than their sigmas: inspect the curves and frames of these lifts before "
        "using their angles."
    )
    return [Notice("warn", what, advice)]
