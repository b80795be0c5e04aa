"""Bad data for the calibrations: each case is refused with the right reason, or answered right.

A case that does neither is silent, and fails: a NaN, a crash, a number that is wrong without saying
so. An answer counts as right within its stated tolerance, or inside its own reported uncertainty
where it was called weak.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import RigError


@dataclass(frozen=True, slots=True)
class CaseAnswer:
    """What a calibration made of a case: refused with a reason, or an error against the truth."""

    refused: str | None = None
    error: float | None = None
    allowed: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """A case of bad data.

    run: takes a generator, gives the finding. reasons: a refusal must hold one of these words;
    none: the case must be answered. draws: how often it is drawn anew.
    """

    group: str
    name: str
    run: Callable[[np.random.Generator], CaseAnswer]
    reasons: tuple[str, ...] = ()
    draws: int = 1


@dataclass(frozen=True, slots=True)
class CaseResult:
    """Counts over the draws, and an example of what was said."""

    case: Case
    refused: int
    right: int
    wrong: int
    said: str


def run_cases(cases: Sequence[Case], seed: int = 0) -> list[CaseResult]:
    """Run all cases, each draw with its own generator; warnings count as errors."""
    return [_run(case, seed, number) for number, case in enumerate(cases)]


def refused(*reasons: str) -> CaseAnswer:
    """A refusal with these reasons."""
    return CaseAnswer(refused="; ".join(reasons) or "refused")


def answered(error: float, allowed: float) -> CaseAnswer:
    """An answer with its error and what is allowed."""
    return CaseAnswer(error=float(error), allowed=float(allowed))


def _run(case: Case, seed: int, number: int) -> CaseResult:
    counts = {"refused": 0, "right": 0, "wrong": 0}
    said = ""
    for draw in range(case.draws):
        kind, text = _one(case, np.random.default_rng((seed, number, draw)))
        counts[kind] += 1
        said = text if kind == "wrong" or not said else said
    return CaseResult(case, counts["refused"], counts["right"], counts["wrong"], said)


def _one(case: Case, rng: np.random.Generator) -> tuple[str, str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            finding = case.run(rng)
    except RigError as error:
        finding = CaseAnswer(refused=str(error))
    except Exception as error:  # a crash is what this table looks for
        return "wrong", f"crashed: {error!r}"
    if finding.refused is not None:
        fits = any(reason in finding.refused for reason in case.reasons)
        return (
            ("refused", finding.refused)
            if fits
            else ("wrong", f"refused for another reason: {finding.refused}")
        )
    if finding.error is not None and finding.error <= finding.allowed:
        return "right", f"right: off by {finding.error:.3g}, allowed {finding.allowed:.3g}"
    return "wrong", f"silent: off by {finding.error}, allowed {finding.allowed:.3g}"
