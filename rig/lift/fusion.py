"""Two fingertips, one object: their answers in one angle (contract, angles and frames)."""

import math
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

from drivers.clock import NS_PER_S
from rig.tactile.sample import SlipSample, State

MAX_SKEW_NS = 40_000_000
"""How old the other fingertip's answer may be: two frames at 60 Hz and some jitter."""
MAX_GAP_NS = 200_000_000
"""How old it may be where the newest fingertip has looked before it: a camera's period, 5 frames a second."""
SURER = 4.0
"""So many times as unsure as another, a fingertip's own turns are noise beside the other's rate."""
STICKS = 0.02
"""How often an estimator sticks to what rests on the gel: a few fingertips in a hundred on hard lifts."""
ANYTHING = 0.1
"""Share of those that answer anything, not something between rest and the turn."""
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
    is surer than their rates unless it is far less sure than they are. Where every answer has a sigma
    the likeliest of `_hypotheses` is told; otherwise the mean (the paper's methods have no sigma). An
    answer older than `MAX_SKEW_NS` counts only where the newest fingertip has looked before it, as
    cameras of a few frames a second do.
    """
    time_ns = now.sample.time_ns
    answers = [a for a in (now, *others) if a.angle_deg is not None and _counts(a, now)]
    if not answers:
        return FusedSample(time_ns, None, None, now.sample.state)
    angles = [a.at(time_ns, _turned_since(a, now)) for a in answers]
    known = [a.sigma_deg for a in answers if a.sigma_deg]
    if len(known) < len(answers):
        told = _Hypothesis(1.0, sum(angles) / len(angles), 0.0, tuple(range(len(angles))))
        sigma, gap = None, None
    else:
        told, sigma = _believed(_hypotheses(angles, known))
        gap = _disagreement(angles, known) if len(answers) == 2 else None
    rates = [rate for i in told.turned if (rate := answers[i].rate_deg_s) is not None]
    rate = sum(rates) / len(rates) if rates else None
    return FusedSample(time_ns, told.angle_deg, sigma, answers[0].sample.state, rate, gap)


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """That some fingertips (by index) have turned with the object, and the others stick to what rests."""

    weight: float
    angle_deg: float
    sigma_deg: float
    turned: tuple[int, ...]


def _turned_since(answer: TipAnswer, now: TipAnswer) -> float | None:
    """Return by what the newest fingertip saw the object turn since an answer; None where that is no help."""
    noisy = answer.sigma_deg and now.sigma_deg and now.sigma_deg > SURER * answer.sigma_deg
    return None if noisy else now.turned_since(answer.sample.time_ns)


def _counts(answer: TipAnswer, now: TipAnswer) -> bool:
    """Whether an answer is recent enough to be brought to the newest one's time.

    Without a sigma nothing weighs it against the newest one: then it has to be as new.
    """
    age_ns = now.sample.time_ns - answer.sample.time_ns
    seen_since = answer.sigma_deg and now.turned_since(answer.sample.time_ns) is not None
    return age_ns <= (MAX_GAP_NS if seen_since else MAX_SKEW_NS)


def _believed(hypotheses: list[_Hypothesis]) -> tuple[_Hypothesis, float]:
    """Return the likeliest hypothesis, and a sigma around it to which all the others add."""
    best = max(hypotheses, key=lambda h: h.weight)
    squares = sum(h.weight * (h.sigma_deg**2 + (h.angle_deg - best.angle_deg) ** 2) for h in hypotheses)
    return best, math.sqrt(squares / sum(h.weight for h in hypotheses))


def _hypotheses(angles: list[float], sigmas: list[float]) -> list[_Hypothesis]:
    """Return what fingertips may have seen, each with its likelihood.

    An answer is normal around the object's turn by its sigma; but now and then an estimator sticks to what
    rests on the gel, and answers anything between rest and that turn. The mean of one that turned and one
    that stuck would be right for neither.
    """
    all_of = range(len(angles))
    chosen = (turned for count in range(len(angles), 0, -1) for turned in combinations(all_of, count))
    return [_hypothesis(turned, angles, sigmas) for turned in chosen]


def _hypothesis(turned: tuple[int, ...], angles: list[float], sigmas: list[float]) -> _Hypothesis:
    weights = [1.0 / sigmas[i] ** 2 for i in turned]
    angle = sum(w * angles[i] for w, i in zip(weights, turned, strict=True)) / sum(weights)
    # of the answers, whatever the turn is: the normal densities' product over that of their mean
    agree = math.prod(_normal(angles[i] - angle, sigmas[i]) for i in turned)
    agree /= _normal(0.0, sum(weights) ** -0.5)
    stuck = [i for i in range(len(angles)) if i not in turned]
    sigma = _sigma(weights, [sigmas[i] for i in turned])
    likelihood = agree * math.prod(_stuck(angles[i], math.hypot(sigmas[i], sigma), angle) for i in stuck)
    prior = (1.0 - STICKS) ** len(turned) * STICKS ** len(stuck)
    return _Hypothesis(prior * likelihood, angle, sigma, turned)


def _stuck(angle_deg: float, sigma_deg: float, turn_deg: float) -> float:
    """Return the likelihood of an answer that stuck while the object turned: between rest and the turn.

    sigma_deg: of the answer and the turn together. A few of them are anything.
    """
    if abs(turn_deg) < sigma_deg / 100.0:
        between = _normal(angle_deg, sigma_deg)
    else:
        low, high = (math.erf((x - angle_deg) / (sigma_deg * math.sqrt(2.0))) for x in (0.0, turn_deg))
        between = (high - low) / (2.0 * turn_deg)
    return (1.0 - ANYTHING) * between + ANYTHING / 360.0


def _normal(gap_deg: float, sigma_deg: float) -> float:
    return math.exp(-0.5 * (gap_deg / sigma_deg) ** 2) / (sigma_deg * math.sqrt(2.0 * math.pi))


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
