"""The verdict on a calibration: good, weak or refused, with its reasons."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

T = TypeVar("T")
Limit = tuple[float, float, float, str] | tuple[float, float, float, str, str]
"""A value, its limits of good and of usable, and the reason if it exceeds one, containing `{value}`.

The limits are upper ones unless that of usable is the smaller one. The last entry names the
value, containing `{value}`; by default it is the reason up to its first colon, semicolon or "only".
"""
_NAMED = 3
"""Most ids that a line of counted reasons names."""


class Verdict(StrEnum):
    """Good: use it. Weak: usable, with the stated doubts. Refused: worse than no calibration."""

    GOOD = "good"
    WEAK = "weak"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class Check:
    """A value compared with its limits. what: the value in words; good, usable: the limits as text."""

    what: str
    good: str
    usable: str
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class Assessment:
    """Reasons for a verdict: refusals and doubts, each with advice. checks: all compared values."""

    refusals: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    checks: tuple[Check, ...] = ()

    @property
    def verdict(self) -> Verdict:
        if self.refusals:
            return Verdict.REFUSED
        return Verdict.WEAK if self.doubts else Verdict.GOOD

    @property
    def reasons(self) -> tuple[str, ...]:
        return self.refusals + self.doubts

    def __add__(self, other: "Assessment") -> "Assessment":
        return Assessment(
            self.refusals + other.refusals, self.doubts + other.doubts, self.checks + other.checks
        )

    def __str__(self) -> str:
        return str(self.verdict) + (": " + "; ".join(self.reasons) if self.reasons else "")


@dataclass(frozen=True, slots=True)
class Rejected:
    """A rejected sample: its id, and the reason."""

    id: str
    reason: str


def counted_reasons(rejected: Sequence[Rejected]) -> list[str]:
    """Return a line for each kind of reason: number and ids of the samples, and the reason.

    Reasons that differ only in words with digits (values, ids, line numbers) are of one kind; such words are
    shown as "...".
    """
    kinds: dict[str, list[Rejected]] = {}
    for each in rejected:
        kinds.setdefault(re.sub(r"\S*\d\S*", "...", each.reason), []).append(each)
    lines = []
    for kind, found in kinds.items():
        reason = found[0].reason if len({each.reason for each in found}) == 1 else kind
        names = ", ".join(each.id for each in found[:_NAMED])
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        lines.append(f"{names}: {reason}" if len(found) == 1 else f"{len(found)} ({names}{more}): {reason}")
    return lines


def sift(
    samples: Iterable[T], name: Callable[[T], str], fault: Callable[[T, list[T]], str | None]
) -> tuple[list[T], list[Rejected]]:
    """Separate usable samples from faulty ones; return the usable ones, and id and reason of the others.

    fault: receives a sample and the samples accepted so far; returns what is wrong with it, or None.
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


def limits(*rows: Limit) -> Assessment:
    """Assess values by their limits; NaN is refused. rows: see `Limit`."""
    total = Assessment()
    for value, good, usable, text, *what in rows:
        said = text.format(value=value)
        bound, sense = ("at most", 1.0) if usable >= good else ("at least", -1.0)
        refused, weak = not sense * value <= sense * usable, not sense * value <= sense * good
        verdict = Verdict.REFUSED if refused else Verdict.WEAK if weak else Verdict.GOOD
        named = what[0].format(value=value) if what else re.split("[:;]| only", said, maxsplit=1)[0]
        good_text, usable_text = (f"{bound} {e:.3g}" if math.isfinite(e) else "any" for e in (good, usable))
        check = Check(named, good_text, usable_text, verdict)
        total += Assessment((said,) if refused else (), (said,) if weak and not refused else (), (check,))
    return total


def rests_on(what: str, doubts: tuple[str, ...]) -> Assessment:
    """Return one doubt that names an input and its doubts: a verdict is never better than its inputs."""
    if not doubts:
        return Assessment()
    return Assessment(doubts=(f"depends on a {what} that is not good ({'; '.join(doubts)})",))


_LENGTHS_M = {"metres": 1.0, "cm": 0.01, "mm": 1e-3, "inches": 0.0254, "micrometres": 1e-6}


def length_guess(value_m: float, stated: str, low_m: float, high_m: float) -> str:
    """Return "; in inches?", with the units that put a length within low_m and high_m; "" if none does.

    value_m: the length in m if its unit is `stated` ("metres", "mm").
    """
    number = abs(value_m) / _LENGTHS_M[stated]
    fitting = [
        name for name, scale in _LENGTHS_M.items() if name != stated and low_m <= number * scale <= high_m
    ]
    return f"; in {' or '.join(fitting)}?" if fitting else ""
