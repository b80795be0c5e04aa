"""The angle of the object: fuse the samples of the fingertips as they arrive (contract, angles)."""

import heapq
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import combinations

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from rig.lift.onset import leaves_rest
from rig.tactile.sample import SlipSample
from rig.tactile.slip.parameters import FUSION, MOST_RATE_RAD_S

MAX_SKEW_NS = 40_000_000
"""Largest age of the other fingertip's angle: two frames at 60 Hz and some jitter."""
MAX_GAP_NS = 200_000_000
"""Largest age if the newest fingertip has an earlier frame than it: one period at 5 frames per second."""
SURER = 4.0
"""If sigma of a fingertip exceeds that of another by this factor, the other's rate is used between frames."""
LEAST_GAP_DEG, GAP_SIGMAS = 1.0, 3.0
"""Fingertips disagree if their difference exceeds both limits, in degrees and in sigmas of the difference."""
STUCK_SHARE = 0.35
"""If one fingertip shows less than this fraction of the other's rotation, only the other one slips."""


class Disagreement(StrEnum):
    """Reason for different rotations of two fingertips."""

    TILT = "tilt"
    ONE_PAD_SLIPS = "one pad slips"


def fuse(now: SlipSample, others: list[SlipSample], before: SlipSample | None = None) -> SlipSample:
    """Fuse a fingertip's newest sample with recent samples of the others, extrapolated to its time.

    All angles are signed rotations since the zero. before: the previous sample of the newest fingertip. The
    fused rate is the mean of the fingertips that contribute.

    The other samples are extrapolated by the rotation that the newest fingertip has measured since their
    frames, or by their own rates if its sigma is much larger than theirs. If every sample has a sigma, the
    result is the likeliest of `_hypotheses`, else the mean (the paper's methods have no sigma). A sample
    older than `MAX_SKEW_NS` counts only if the newest fingertip has an earlier frame than it, as with cameras
    of a few frames per second.
    """
    turns = [(a, _turned_since(a.time_ns, now, before)) for a in (now, *others) if a.angle_deg is not None]
    turns = [(a, turn) for a, turn in turns if _counts(a, now, turn)]
    if not turns:
        return SlipSample(now.time_ns, now.state)
    answers = [a for a, _ in turns]
    angles = [_extrapolate(a, now, turn) for a, turn in turns]
    known = [a.sigma_deg for a in answers if a.sigma_deg]
    if len(known) < len(answers):
        best = _Hypothesis(1.0, sum(angles) / len(angles), 0.0, tuple(range(len(angles))))
        sigma, gap = None, None
    else:
        hypotheses = _hypotheses(angles, known)
        best = max(hypotheses, key=lambda h: h.weight)
        squares = [h.weight * (h.sigma_deg**2 + (h.angle_deg - best.angle_deg) ** 2) for h in hypotheses]
        sigma = math.sqrt(sum(squares) / sum(h.weight for h in hypotheses))  # of all hypotheses
        gap = _disagreement(angles, known) if len(answers) == 2 else None
    rates = [rate for i in best.turned if (rate := answers[i].rate_deg_s) is not None]
    rate = sum(rates) / len(rates) if rates else None
    return SlipSample(now.time_ns, answers[0].state, best.angle_deg, sigma, rate_deg_s=rate, disagreement=gap)


class FusedAngles:
    """Fuses answers one after the other; the angle turns no faster than an object in a gripper can.

    Another hypothesis may become the likeliest one from one frame to the next, but an object does not jump.
    Sigma includes the difference. Answers without sigma are not limited.
    """

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None

    def restart(self) -> None:
        """Forget the last angle, because the next one counts from another zero."""
        self._last = None

    def update(
        self, now: SlipSample, others: list[SlipSample], before: SlipSample | None = None
    ) -> SlipSample:
        fused = fuse(now, others, before)
        angle = fused.angle_deg
        if angle is None:
            return fused
        if self._last is not None and fused.sigma_deg is not None:
            time_ns, last_deg = self._last
            most = math.degrees(MOST_RATE_RAD_S) * abs(fused.time_ns - time_ns) / NS_PER_S
            limited = min(max(angle, last_deg - most), last_deg + most)
            sigma = math.hypot(fused.sigma_deg, angle - limited)
            fused, angle = replace(fused, angle_deg=limited, sigma_deg=sigma), limited
        self._last = fused.time_ns, angle
        return fused


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """Some fingertips (by index) have measured the rotation, and the others follow the resting gel."""

    weight: float
    angle_deg: float
    sigma_deg: float
    turned: tuple[int, ...]


def _turned_since(time_ns: int, now: SlipSample, before: SlipSample | None) -> float | None:
    """Return the rotation between the last two samples of a fingertip since a time, deg; None if unknown."""
    if now.angle_deg is None or before is None or before.angle_deg is None or time_ns < before.time_ns:
        return None
    share = (now.time_ns - time_ns) / max(now.time_ns - before.time_ns, 1)
    return share * (now.angle_deg - before.angle_deg)


def _extrapolate(answer: SlipSample, now: SlipSample, turn_deg: float | None) -> float:
    """Return an angle at the time of the newest sample.

    It is extrapolated by the rotation since then that the newest fingertip has measured, turn_deg, or by its
    own rate if that rotation is unknown or too noisy.
    """
    if turn_deg is None or (answer.sigma_deg and now.sigma_deg and now.sigma_deg > SURER * answer.sigma_deg):
        turn_deg = (answer.rate_deg_s or 0.0) * (now.time_ns - answer.time_ns) / NS_PER_S
    return (answer.angle_deg or 0.0) + turn_deg


def _counts(answer: SlipSample, now: SlipSample, turn_deg: float | None) -> bool:
    """Whether an answer is recent enough to be extrapolated to the time of the newest one.

    An answer without sigma cannot be weighted, so its age is limited to `MAX_SKEW_NS`.
    """
    age_ns = now.time_ns - answer.time_ns
    return age_ns <= (MAX_GAP_NS if answer.sigma_deg and turn_deg is not None else MAX_SKEW_NS)


def _hypotheses(angles: list[float], sigmas: list[float]) -> list[_Hypothesis]:
    """Return all hypotheses with their likelihoods.

    An angle is normally distributed around the rotation of the object. But sometimes an estimator follows the
    resting gel; its angle is then between rest and that rotation. The mean of a correct and such an angle
    would be wrong.
    """
    all_of = range(len(angles))
    chosen = (turned for count in range(len(angles), 0, -1) for turned in combinations(all_of, count))
    return [_hypothesis(turned, angles, sigmas) for turned in chosen]


def _hypothesis(turned: tuple[int, ...], angles: list[float], sigmas: list[float]) -> _Hypothesis:
    weights = [1.0 / sigmas[i] ** 2 for i in turned]
    angle = sum(w * angles[i] for w, i in zip(weights, turned, strict=True)) / sum(weights)
    # likelihood of the angles for an unknown rotation: product of the normal densities over that of their
    # mean
    agree = math.prod(_normal(angles[i] - angle, sigmas[i]) for i in turned)
    agree /= _normal(0.0, sum(weights) ** -0.5)
    stuck = [i for i in range(len(angles)) if i not in turned]
    sigma = _sigma(weights, [sigmas[i] for i in turned])
    likelihood = agree * math.prod(_stuck(angles[i], math.hypot(sigmas[i], sigma), angle) for i in stuck)
    sticks = FUSION.sticks
    prior = (1.0 - sticks) ** len(turned) * sticks ** len(stuck)
    return _Hypothesis(prior * likelihood, angle, sigma, turned)


def _stuck(angle_deg: float, sigma_deg: float, turn_deg: float) -> float:
    """Return the likelihood of an angle that follows the resting gel: between rest and the rotation.

    sigma_deg: of the angle and the rotation together. The fraction `anything` is uniformly distributed.
    """
    if abs(turn_deg) < sigma_deg / 100.0:
        between = _normal(angle_deg, sigma_deg)
    else:
        low, high = (math.erf((x - angle_deg) / (sigma_deg * math.sqrt(2.0))) for x in (0.0, turn_deg))
        between = (high - low) / (2.0 * turn_deg)
    anything = FUSION.anything
    return (1.0 - anything) * between + anything / 360.0


def _normal(gap_deg: float, sigma_deg: float) -> float:
    return math.exp(-0.5 * (gap_deg / sigma_deg) ** 2) / (sigma_deg * math.sqrt(2.0 * math.pi))


def _sigma(weights: list[float], sigmas: list[float]) -> float:
    """Return the sigma of the weighted mean of answers whose errors are correlated."""
    shares = [w / sum(weights) * s for w, s in zip(weights, sigmas, strict=True)]
    apart = sum(share**2 for share in shares)
    common = FUSION.correlation  # they touch the same object under the same load
    return math.sqrt((1.0 - common) * apart + common * sum(shares) ** 2)


def _disagreement(angles: list[float], sigmas: list[float]) -> Disagreement | None:
    gap = abs(angles[0] - angles[1])
    if gap < LEAST_GAP_DEG or gap < GAP_SIGMAS * math.hypot(*sigmas):
        return None
    less, more = sorted(abs(angle) for angle in angles)
    same_side = angles[0] * angles[1] > 0.0
    return Disagreement.ONE_PAD_SLIPS if not same_side or less < STUCK_SHARE * more else Disagreement.TILT


ZERO_S = 0.4
"""Length of the end of phase A whose mean angle is the zero, s: 12 camera frames at 30 Hz (at least 10
needed).

If a slow camera or a hidden marker leaves fewer, the whole time at rest before the lift is used.
"""


@dataclass(slots=True)
class TipTrack:
    """The samples of one fingertip in a lift, and its zero. sign: from its angle to the object's angle."""

    sign: int
    samples: list[SlipSample] = field(default_factory=list)
    zero_deg: float | None = None
    zero_sample: SlipSample | None = None

    def answer(self, sample: SlipSample) -> SlipSample:
        """Return a sample with the signed angle since the zero; without a zero there is no angle."""
        return sample.since_zero(self.sign, self.zero_deg, self.zero_sample)

    def set_zero(self, time_ns: int) -> None:
        """Take the mean angle of the last `ZERO_S` before a time as the zero.

        If the contact has settled since then, the earlier angles are left out: they have another zero.
        """
        since = time_ns - to_ns(ZERO_S)
        late = [s for s in self.samples if since <= s.time_ns < time_ns and s.angle_deg is not None]
        late = [s for s in late if s.settled] or late
        angles_deg = [s.angle_deg for s in late if s.angle_deg is not None]
        self.zero_deg = float(np.mean(angles_deg)) if angles_deg else None
        self.zero_sample = late[-1] if late else None

    def newest(self) -> SlipSample:
        """Return the answer of the newest sample. There must be at least one sample."""
        return self.answer(self.samples[-1])

    def previous(self) -> SlipSample | None:
        return self.answer(self.samples[-2]) if len(self.samples) > 1 else None


class ObjectAngle:
    """Fuses the samples of the fingertips of one lift.

    signs: of the fingertips by serial. From `begin` on, each sample gives one fused sample in `fused`.
    `alarm_ns` is the time of the first fused sample that shows a slip.
    """

    def __init__(self, signs: Mapping[str, int]) -> None:
        self.tips = {serial: TipTrack(sign) for serial, sign in signs.items()}
        self.fused: list[SlipSample] = []
        self.alarm_ns: int | None = None
        self._begun = False
        self._fusion = FusedAngles()

    @property
    def samples(self) -> list[SlipSample]:
        return [sample for tip in self.tips.values() for sample in tip.samples]

    def begin(self, time_ns: int) -> None:
        """Begin the lift: the zero is the angle just before this time."""
        for tip in self.tips.values():
            tip.set_zero(time_ns)
        self._begun = True

    def add(self, serial: str, sample: SlipSample) -> None:
        tip = self.tips[serial]
        tip.samples.append(sample)
        if not self._begun:
            return
        others = [other.newest() for other in self.tips.values() if other is not tip and other.samples]
        fused = self._fusion.update(tip.newest(), others, tip.previous())
        self.fused.append(fused)
        if self.alarm_ns is None and fused.angle_deg is not None and fused.rate_deg_s is not None:
            self.alarm_ns = fused.time_ns if leaves_rest(fused.angle_deg, fused.rate_deg_s) else None


def object_angle(
    signs: Mapping[str, int], samples: Mapping[str, Sequence[SlipSample]], lift_ns: int
) -> ObjectAngle:
    """Return the object's angle of stored samples, in the order of capture. signs, samples: by serial.

    lift_ns: start of the lift, from which on samples are fused.
    """
    angle, begun = ObjectAngle(signs), False
    in_order = heapq.merge(*([(s.time_ns, n, s) for s in samples[n]] for n in signs), key=lambda s: s[:2])
    for time_ns, serial, sample in in_order:
        if not begun and time_ns >= lift_ns:
            angle.begin(lift_ns)
            begun = True
        angle.add(serial, sample)
    return angle
