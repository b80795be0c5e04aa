"""Two fingertips, one object: their answers in one angle (contract, angles and frames)."""

import math
from dataclasses import dataclass
from enum import StrEnum

from drivers.clock import NS_PER_S
from rig.tactile.sample import SlipSample, State

MAX_SKEW_NS = 40_000_000
"""How old the other fingertip's answer may be: two frames at 60 Hz and some jitter."""
CORRELATION = 0.7
"""Of the two fingertips' errors: they touch the same object under the same load, so what the gel
hides from one it mostly hides from the other (0.6 to 0.9 on simulated lifts)."""
LEAST_GAP_DEG, GAP_SIGMAS = 1.0, 3.0
"""Fingertips disagree when they are so far apart, in degrees and in multiples of the gap's sigma."""
STUCK_SHARE = 0.35
"""A pad that shows less than this share of the other's turn sticks while the other slips."""


class Disagreement(StrEnum):
    """Why two fingertips see different turns."""

    TILT = "tilt"
    ONE_PAD_SLIPS = "one pad slips"


@dataclass(frozen=True, slots=True)
class FusedSample:
    """The object's angle at a tactile frame's time, deg, None where no fingertip answers.

    rate_deg_s: mean of the answering fingertips. disagreement: why the two do not agree, if so.
    """

    time_ns: int
    angle_deg: float | None
    sigma_deg: float | None
    state: State
    rate_deg_s: float | None = None
    disagreement: Disagreement | None = None


@dataclass(frozen=True, slots=True)
class TipAnswer:
    """One fingertip's sample, its angle and rate signed and relative to its zero.

    before: time in ns and angle of the answer before, None where there was none.
    """

    sample: SlipSample
    angle_deg: float | None
    sigma_deg: float | None
    rate_deg_s: float | None = None
    before: tuple[int, float] | None = None

    def turned_since(self, time_ns: int) -> float | None:
        """Return how far it has turned since a time between its last two frames, None if unknown."""
        if self.angle_deg is None or self.before is None or not self.before[0] <= time_ns:
            return None
        before_ns, before_deg = self.before
        share = (self.sample.time_ns - time_ns) / max(self.sample.time_ns - before_ns, 1)
        return share * (self.angle_deg - before_deg)

    def at(self, time_ns: int, turned_deg: float | None = None) -> float:
        """Return the angle at a later time: by what the object turned, else by its own rate."""
        if turned_deg is None:
            turned_deg = (self.rate_deg_s or 0.0) * (time_ns - self.sample.time_ns) / NS_PER_S
        return (self.angle_deg or 0.0) + turned_deg


def fuse(now: TipAnswer, others: list[TipAnswer]) -> FusedSample:
    """Combine a fingertip's newest answer with the others' recent ones, brought to its time.

    The newest fingertip itself has seen how far the object turned since the others' frames, which
    is surer than their rates. Weights are inverse variances where every answer has a sigma, equal
    otherwise (the paper's methods have none). An answer older than `MAX_SKEW_NS` does not count.
    """
    time_ns = now.sample.time_ns
    recent = [a for a in others if time_ns - a.sample.time_ns <= MAX_SKEW_NS]
    answers = [a for a in (now, *recent) if a.angle_deg is not None]
    if not answers:
        return FusedSample(time_ns, None, None, now.sample.state)
    angles = [a.at(time_ns, now.turned_since(a.sample.time_ns)) for a in answers]
    sigmas = [a.sigma_deg for a in answers]
    known = [s for s in sigmas if s is not None and s > 0.0]
    complete = len(known) == len(answers)
    weights = [1.0 / s**2 for s in known] if complete else [1.0] * len(answers)
    angle = sum(w * a for w, a in zip(weights, angles, strict=True)) / sum(weights)
    sigma = _sigma(weights, known) if complete else None
    rates = [a.rate_deg_s for a in answers if a.rate_deg_s is not None]
    rate = sum(rates) / len(rates) if rates else None
    gap = _disagreement(angles, known) if complete and len(answers) == 2 else None
    return FusedSample(time_ns, angle, sigma, answers[0].sample.state, rate, gap)


def _sigma(weights: list[float], sigmas: list[float]) -> float:
    """Return the sigma of the weighted mean of answers whose errors are correlated."""
    shares = [w / sum(weights) * s for w, s in zip(weights, sigmas, strict=True)]
    apart = sum(share**2 for share in shares)
    return math.sqrt((1.0 - CORRELATION) * apart + CORRELATION * sum(shares) ** 2)


def _disagreement(angles: list[float], sigmas: list[float]) -> Disagreement | None:
    gap = abs(angles[0] - angles[1])
    if gap < LEAST_GAP_DEG or gap < GAP_SIGMAS * math.hypot(*sigmas):
        return None
    less, more = sorted(abs(angle) for angle in angles)
    same_side = angles[0] * angles[1] > 0.0
    return Disagreement.ONE_PAD_SLIPS if not same_side or less < STUCK_SHARE * more else Disagreement.TILT
