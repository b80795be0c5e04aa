"""Findings of the doctor: one line each, with advice."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike


class Severity(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    WARNING = "warning"
    FAILURE = "failure"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check: device, check, observation and advice (empty if none is needed).

    figures: the numbers in `seen`, for scripts; units are in the names.
    """

    device: str
    check: str
    verdict: Severity
    seen: str
    todo: str = ""
    figures: Mapping[str, float | int | str | None] = field(default_factory=dict)


def judged(
    device: str,
    check: str,
    good: bool,
    seen: str,
    todo: str,
    figures: Mapping[str, float | int | str | None] | None = None,
    otherwise: Severity = Severity.WARNING,
) -> Finding:
    """Return a good finding, or one of severity `otherwise` with advice `todo`."""
    verdict = Severity.GOOD if good else otherwise
    return Finding(device, check, verdict, seen, "" if good else todo, figures or {})


def percentiles_ms(durations_s: ArrayLike) -> dict[str, float]:
    """Return median, 95th and 99th percentile and the longest of some durations, in ms."""
    values = np.asarray(durations_s, float) * 1e3
    p50, p95, p99, longest = np.percentile(values, [50, 95, 99, 100])
    return {"p50_ms": float(p50), "p95_ms": float(p95), "p99_ms": float(p99), "max_ms": float(longest)}


def percentiles_text(figures: Mapping[str, float]) -> str:
    """Return percentiles as text."""
    return "p50/p95/p99/max {p50_ms:.1f}/{p95_ms:.1f}/{p99_ms:.1f}/{max_ms:.1f} ms".format(**figures)
