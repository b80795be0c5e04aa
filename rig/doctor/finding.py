"""What the doctor found: one line each, with what to do about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike


class Severity(StrEnum):
    """How a finding is to be taken."""

    GOOD = "good"
    WARNING = "warning"
    FAILURE = "failure"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at: on which device, what was seen, what to do (empty when nothing).

    figures: the numbers behind `seen`, for scripts; units are in the names.
    """

    device: str
    check: str
    verdict: Severity
    seen: str
    todo: str = ""
    figures: Mapping[str, float | int | str | None] = field(default_factory=dict)


def percentiles_ms(durations_s: ArrayLike) -> dict[str, float]:
    """Return median, 95th and 99th percentile and the longest of some durations, in ms."""
    values = np.asarray(durations_s, float) * 1e3
    p50, p95, p99, longest = np.percentile(values, [50, 95, 99, 100])
    return {"p50_ms": float(p50), "p95_ms": float(p95), "p99_ms": float(p99), "max_ms": float(longest)}


def percentiles_text(figures: Mapping[str, float]) -> str:
    """Return percentiles as a person reads them."""
    return "p50/p95/p99/max {p50_ms:.1f}/{p95_ms:.1f}/{p99_ms:.1f}/{max_ms:.1f} ms".format(**figures)
