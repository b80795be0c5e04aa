"""Whether the samples of a calibration agree with each other, whatever order they are put in.

A fit believes that its samples are exchangeable. If a focus moves, a target slips or a clock is set between
two of them, the residuals stay small, the parameters lie between both states, and sigma knows nothing of it.
So the samples are cut in two, at each place of the order in which they were taken and of each quantity that
a calibration names (distance, tilt, size), and the parameters of both parts are compared: a test for a change
of the parameters at an unknown place (Andrews 1993, Econometrica 61). The fit is linear near its solution, so
both parts are solved without fitting again.

Samples may have errors of their own that all their points share (a robot's pose). The noise is therefore at
least that of whole samples, as clustered standard errors are (Liang and Zeger 1986, Biometrika 73).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f as f_distribution

from calibration.verdict import Assessment, Check, Verdict

Array = NDArray[np.floating]
Name = tuple[str, float, str, float]
"""Label, scale and unit of a parameter in messages, and the least difference in that unit that matters."""

FEWEST = 3
"""Fewest samples of a part."""
CHANCE = 0.0027
"""Probability that samples without a change seem to have one, over all cuts: three sigma."""
LIMITS = ("within three sigma, or too little to matter", "any")
"""Limits of good and of usable, as text."""
_LEAST_LEFT = 0.2
"""Share of the noise that must be left in the residuals of two parts that are fitted apart, to measure it."""
_RIDGE = 1e-9
"""Information on a direction that a part does not determine, as a share of that of all samples."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Two parts of the samples that disagree.

    by: "" if the samples are in the order in which they were taken, else the quantity that orders them. last:
    id of the last sample of the first part. difference, sigma: (P,) parameters of the second part minus those
    of the first, and one sigma of it. spread: (P, P), to be added to a covariance so that it covers both.
    """

    by: str
    last: str
    difference: Array
    sigma: Array
    spread: Array

    def matters(self, names: Sequence[Name]) -> bool:
        """Whether a parameter differs by more than a good calibration may be wrong."""
        differences = zip(names, self.difference, strict=False)
        return any(scale * abs(difference) > least for (_, scale, _, least), difference in differences)

    def text(self, names: Sequence[Name], cure: str) -> str:
        """Return the change of the parameter that differs most. names: of the first parameters."""
        shown = slice(0, len(names))
        most = int(np.argmax(np.abs(self.difference[shown]) / self.sigma[shown]))
        label, scale, unit, _ = names[most]
        one, other = (
            (f"up to {self.last}", "later samples")
            if not self.by
            else (f"with the smallest {self.by}, up to {self.last},", "the others")
        )
        value, sigma = scale * self.difference[most], scale * self.sigma[most]
        differs = f"{label} differs by {value:+.3g} ± {sigma:.2g} {unit}"
        return f"samples {one} and {other} disagree: {differs}; {cure}"


def assess_order(change: Change | None, count: int, names: Sequence[Name], cure: str) -> Assessment:
    """Doubt a calibration whose samples disagree. count: of samples. names, cure: see `Change.text`."""
    if count < 2 * FEWEST:
        return Assessment()
    if change is None or not change.matters(names):
        return Assessment(checks=(Check("parts of the samples agree", *LIMITS, Verdict.GOOD),))
    check = Check("parts of the samples disagree", *LIMITS, Verdict.WEAK)
    return Assessment(doubts=(change.text(names, cure),), checks=(check,))


def find_change(
    ids: Sequence[str],
    jacobians: Sequence[Array],
    residuals: Sequence[Array],
    quantities: Mapping[str, ArrayLike] | None = None,
) -> Change | None:
    """Return the two parts of the samples that disagree most; None if no two disagree by more than chance.

    ids: of the samples, in the order in which they were taken. jacobians: (rows, P) per sample, derivatives
    of its predictions by the parameters; what belongs to the sample alone is removed. residuals: (rows,) per
    sample, measured minus predicted, with equal noise. quantities: by name, a value per sample to order them.
    """
    count = len(ids)
    if count < 2 * FEWEST:
        return None
    stacked = np.vstack(jacobians)
    rows, many = stacked.shape
    scale = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    scaled = [np.asarray(jacobian) / scale for jacobian in jacobians]
    known = np.array([jacobian.T @ jacobian for jacobian in scaled])
    pulls = np.array([j.T @ r for j, r in zip(scaled, residuals, strict=True)])
    whole = known.sum(axis=0) + _RIDGE * np.eye(many)
    rest = np.linalg.solve(whole, pulls.sum(axis=0))  # a robust fit does not end at the least squares
    squares = float(sum(((r - j @ rest) ** 2).sum() for j, r in zip(scaled, residuals, strict=True)))
    pulls = pulls - known @ rest
    fit = _Fit(known, pulls, squares, rows, np.linalg.inv(whole))
    orders = {"": np.arange(count), **{name: np.asarray(each) for name, each in (quantities or {}).items()}}
    tests = len(orders) * (count - 2 * FEWEST + 1)
    least, best = CHANCE / tests, None
    for by, values in orders.items():
        order = np.argsort(values, kind="stable")
        for cut in range(FEWEST, count - FEWEST + 1):
            found = fit.compare(order[:cut], order[cut:])
            if found is not None and found[0] < least:
                least, (first, second), covariance = found
                first, second, sigma = first / scale, second / scale, np.sqrt(np.diag(covariance)) / scale
                spread = np.outer(first, first) + np.outer(second, second)
                best = Change(by, ids[int(order[cut - 1])], second - first, sigma, spread)
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The linear fit to all samples, at its solution.

    known: (N, P, P), information of each sample. pulls: (N, P), its gradient. squares: sum of squares of all
    residuals. rows: their number. inverse: (P, P) of the information of all samples, to weigh directions.
    """

    known: Array
    pulls: Array
    squares: float
    rows: int
    inverse: Array

    def compare(self, *parts: NDArray[np.integer]) -> tuple[float, list[Array], Array] | None:
        """Fit two parts of the samples apart; None if too little residual is left to measure the noise.

        Returns the probability that they differ as much by chance, the step of each part from the common
        solution, and the covariance of the difference.
        """
        many = len(self.inverse)
        own = [self.known[part].sum(axis=0) + _RIDGE * np.eye(many) for part in parts]
        forces = [self.pulls[part].sum(axis=0) for part in parts]
        steps = [np.linalg.solve(a, force) for a, force in zip(own, forces, strict=True)]
        gained = sum(float(force @ step) for force, step in zip(forces, steps, strict=True))
        freedom = self.rows - 2 * many
        noise = (self.squares - gained) / max(freedom, 1)
        left, shared = 0.0, 0.0
        for part, a, step in zip(parts, own, steps, strict=True):
            rests = self.pulls[part] - self.known[part] @ step
            shared += float(np.einsum("ni,ij,nj->", rests, self.inverse, rests))
            explained = self.known[part] @ np.linalg.solve(a, self.known[part])
            left += float(np.einsum("ij,nji->", self.inverse, self.known[part] - explained))
        if noise <= 0.0 or left < _LEAST_LEFT * many or freedom <= 0:
            return None
        if shared / left > noise:
            noise, freedom = shared / left, len(self.known) - 2
        chance = float(f_distribution.sf(gained / noise / many, many, freedom))
        return chance, steps, noise * (np.linalg.inv(own[0]) + np.linalg.inv(own[1]))
