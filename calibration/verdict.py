"""What a calibration is worth, in words: good, weak or refused, and why."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

T = TypeVar("T")


class Verdict(StrEnum):
    """Good: use it. Weak: usable, with the stated doubts. Refused: no answer is better than this one."""

    GOOD = "good"
    WEAK = "weak"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Assessment:
    """Reasons to refuse, and doubts; each says what was seen and what to do."""

    refusals: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst of what was found."""
        if self.refusals:
            return Verdict.REFUSED
        return Verdict.WEAK if self.doubts else Verdict.GOOD

    @property
    def reasons(self) -> tuple[str, ...]:
        """All reasons, the worst first."""
        return self.refusals + self.doubts

    def __add__(self, other: "Assessment") -> "Assessment":
        """Both judgements' reasons."""
        return Assessment(self.refusals + other.refusals, self.doubts + other.doubts)

    def __str__(self) -> str:
        """One line for people."""
        return str(self.verdict) + (": " + "; ".join(self.reasons) if self.reasons else "")


@dataclass(frozen=True, slots=True)
class Rejected:
    """A sample that was left out, by its id, and why."""

    id: str
    reason: str


def sift(
    samples: Iterable[T], name: Callable[[T], str], fault: Callable[[T, list[T]], str | None]
) -> tuple[list[T], list[Rejected]]:
    """Return the samples that no fault is found in, and the others by their id.

    fault: says what is wrong with a sample, or None; it is also given the samples kept so far.
    """
    kept: list[T] = []
    rejected: list[Rejected] = []
    for sample in samples:
        reason = fault(sample, kept)
        if reason is None:
            kept.append(sample)
        else:
            rejected.append(Rejected(name(sample), reason))
    return kept, rejected


def limit(value: float, weak_above: float, refuse_above: float, text: str) -> Assessment:
    """Judge a number that should be small; one that is not finite is refused. `text` takes `{value}`."""
    said = text.format(value=value)
    if not value <= refuse_above:
        return Assessment(refusals=(said,))
    return Assessment(doubts=(said,)) if value > weak_above else Assessment()


def floor(value: float, weak_below: float, refuse_below: float, text: str) -> Assessment:
    """Judge a number that should be large; one that is not finite is refused. `text` takes `{value}`."""
    said = text.format(value=value)
    if not value >= refuse_below:
        return Assessment(refusals=(said,))
    return Assessment(doubts=(said,)) if value < weak_below else Assessment()
