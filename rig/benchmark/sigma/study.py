"""`rig benchmark sigma`: fits the standard deviation that slip reports while the texture leads."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.optimize import minimize

from drivers.errors import InputError, unknown_name
from rig.benchmark.clips.augmented import augmented
from rig.benchmark.clips.labelled import ClipVersion, read_clips
from rig.benchmark.clips.scores import USEFUL_SIGMA_DEG
from rig.benchmark.harness import Report, Run, Study, column, option, table_of
from rig.benchmark.sigma.samples import KnownError, clip_errors, lift_errors
from rig.results.scores import is_confidently_wrong
from rig.tactile.slip.fused_angle import TERMS, coefficients

FLOOR = 0.03
"""Fraction of outliers in the likelihood: their error is uniform up to `ANY_ERROR_DEG`."""
ANY_ERROR_DEG = 60.0
COVERED = 0.96
"""Required fraction of the clips' labels within two sigma; the fitted sigma is enlarged to reach it."""
MOST_LARGER = 4.0
"""Largest factor by which sigma is enlarged."""
FIRST_LIFT = 900
"""First lift used for the fit; `rig benchmark renderer` uses lifts with lower numbers."""
EXPECTED, INDEPENDENT_CLIPS = (0.8, 0.6, 0.2, 0.3, 1.0), 12.0
"""Centres of the coefficients' log-normal prior, whose width is a factor e; the first three are those of a
prototype. Number of independent errors: the errors in a clip and its versions are correlated."""
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SigmaOptions:
    """Options of `rig benchmark sigma`."""

    folder: Annotated[Path, typer.Argument(help="Labelled clips, as of rig benchmark clips.")]
    groups: Annotated[
        Path | None, typer.Option("--groups", help="CSV with columns clip,group, as of rig benchmark clips.")
    ] = None
    group: Annotated[
        str | None, typer.Option("--group", help="Only the clips of this group. Default: all clips.")
    ] = None
    lifts: int = option(20, "Number of simulated lifts of the second renderer.", min=0, max=1000)
    save: Annotated[
        Path | None, typer.Option("--save", help="File for the fitted coefficients and their card.")
    ] = None


@dataclass(frozen=True, slots=True)
class SigmaRow:
    """Fit of the coefficients to the errors of clips or lifts: a row of the table."""

    coefficients: str = column("coefficients")
    data: str = column("data")
    answers: int = column("answers")
    useful: float = column("useful", ".1%", "share with a sigma of at most 5 degrees")
    two_sigma: float = column("within 2 sigma", ".1%")
    wrong: float = column("confidently wrong", ".1%")
    median_deg: float = column("median sigma", ".2f", "degrees")


def measure(options: SigmaOptions, run: Run) -> Report:
    """Fit the standard deviation that slip reports to known errors, by maximum likelihood.

    The errors are those at the labels of clips, in all versions of `rig benchmark clips --augment`, and those
    of SIMULATED lifts of the second renderer. In the likelihood, errors are normal with the variance of
    answer and label, with a few outliers of any size. A prior determines coefficients that the errors do not.
    Then sigma is enlarged until 96 % of the labels are within two sigma. Clips and lifts have equal weight.
    Fit to development clips only, and test with others.

    Examples:
      rig benchmark sigma clips --groups halves.csv --group development --save fusion.json

    """
    clips = augmented(read_clips(options.folder, options.groups), [*ClipVersion])
    names = sorted({clip.group for clip in clips})
    if options.group is not None and options.group not in names:
        raise InputError(unknown_name("group", options.group, names))
    chosen = [clip for clip in clips if options.group in (None, clip.group)]
    at_labels = [e for of in run.each(clip_errors, chosen, attrgetter("name"), workers=1) for e in of]
    numbers = range(FIRST_LIFT, FIRST_LIFT + options.lifts)
    in_lifts = [e for of in run.each(lift_errors, numbers, lambda lift: f"lift {lift}") for e in of]
    fitted = fit(at_labels, in_lifts)
    rows = [
        _row(which, data, roots, errors)
        for which, roots in (("shipped", np.sqrt(coefficients())), ("fitted", fitted))
        for data, errors in (("labels of clips", at_labels), ("SIMULATED lifts", in_lifts))
        if errors
    ]
    found: dict[str, float] = {name: round(float(c), 4) for name, c in zip(TERMS, fitted, strict=True)}
    if options.save is not None:
        options.save.write_text(json.dumps(_card(found, options, len(chosen), rows), indent=2) + "\n")
    return Report(
        tables=(table_of("Standard deviation where the texture leads", SigmaRow, rows, left=2),),
        notes=(f"Fitted: {', '.join(f'{name} {value:.3f}' for name, value in found.items())}",),
        figures={"coefficients": found},
    )


def fit(at_labels: Sequence[KnownError], in_lifts: Sequence[KnownError]) -> Values:
    """Return the square roots of the coefficients, in the order of `TERMS`. at_labels: not empty."""
    groups = [errors for errors in (at_labels, in_lifts) if errors]
    found = minimize(
        lambda logs: sum(_surprise(np.exp(logs), errors) for errors in groups) + _unlikely(logs),
        np.log(EXPECTED),
        method="Nelder-Mead",
        options={"maxiter": 4000, "maxfev": 4000},
    )
    roots = np.asarray(np.exp(found.x), np.float64)
    errors, label = (np.array([getattr(e, name) for e in at_labels]) for name in ("error_deg", "label_deg"))

    def covered(larger: float) -> bool:
        joint = np.sqrt(variances(larger * roots, at_labels) + label**2)
        return bool((np.abs(errors) <= 2.0 * joint).mean() >= COVERED)

    factors = np.geomspace(1.0, MOST_LARGER, 60)
    return roots * next((factor for factor in factors if covered(factor)), MOST_LARGER)


def variances(roots: Values, errors: Sequence[KnownError]) -> Values:
    """Return the variance of each answer, squared degrees."""
    terms = np.array([error.terms for error in errors])
    return np.array([error.known for error in errors]) + terms @ np.square(roots)


def _unlikely(logs: Values) -> float:
    """Return the negative log prior of the coefficients' logarithms, per independent error."""
    return float(0.5 * np.square(logs - np.log(EXPECTED)).sum() / INDEPENDENT_CLIPS)


def _surprise(roots: Values, errors: Sequence[KnownError]) -> float:
    """Return the mean negative log likelihood of errors."""
    size = np.array([error.error_deg for error in errors])
    variance = variances(roots, errors) + np.square([error.label_deg for error in errors]) + 1e-6
    normal = np.exp(-0.5 * size**2 / variance) / np.sqrt(2.0 * math.pi * variance)
    return float(-np.log((1.0 - FLOOR) * normal + FLOOR / ANY_ERROR_DEG).mean())


def _row(which: str, data: str, roots: Values, errors: Sequence[KnownError]) -> SigmaRow:
    sigma = np.sqrt(variances(roots, errors))
    joint = np.hypot(sigma, [error.label_deg for error in errors])
    size = np.abs([error.error_deg for error in errors])
    wrong = [is_confidently_wrong(one, other) for one, other in zip(size, joint, strict=True)]
    return SigmaRow(
        which,
        data,
        len(errors),
        float((sigma <= USEFUL_SIGMA_DEG).mean()),
        float((size <= 2.0 * joint).mean()),
        float(np.mean(wrong)),
        float(np.median(sigma)),
    )


def _card(
    found: dict[str, float], options: SigmaOptions, clips: int, rows: Sequence[SigmaRow]
) -> dict[str, object]:
    """Return the coefficients and a description of the data that they were fitted to."""
    return {
        "title": "standard deviation of the fused slip angle where the texture leads",
        "coefficients": found,
        "made_with": "rig benchmark sigma",
        "clips": {"group": options.group or "all", "versions": [*ClipVersion], "number": clips},
        "simulated_lifts": {"first": FIRST_LIFT, "number": options.lifts},
        "figures": [
            {"data": r.data, "answers": r.answers, "useful": r.useful, "two_sigma": r.two_sigma}
            for r in rows
            if r.coefficients == "fitted"
        ],
    }


STUDY = Study(name="sigma", options=SigmaOptions, measure=measure, cases="clips and lifts", shared=("jobs",))
