"""Two fingertips, one object: their answers in one angle (contract, angles and frames)."""

from dataclasses import dataclass

from rig.tactile.sample import SlipSample, State

MAX_SKEW_NS = 40_000_000
"""How old the other fingertip's answer may be: two frames at 60 Hz and some jitter."""


@dataclass(frozen=True, slots=True)
class FusedSample:
    """The object's angle at a tactile frame's time, deg, None where no fingertip answers."""

    time_ns: int
    angle_deg: float | None
    sigma_deg: float | None
    state: State


@dataclass(frozen=True, slots=True)
class TipAnswer:
    """One fingertip's sample, already signed and relative to its zero."""

    sample: SlipSample
    angle_deg: float | None
    sigma_deg: float | None


def fuse(now: TipAnswer, others: list[TipAnswer]) -> FusedSample:
    """Combine a fingertip's newest answer with the others' recent ones.

    Weights are inverse variances where every answer has a sigma, equal otherwise (the paper's
    methods have none). An answer older than `MAX_SKEW_NS` does not count.
    """
    time_ns = now.sample.time_ns
    recent = [a for a in others if time_ns - a.sample.time_ns <= MAX_SKEW_NS]
    answers = [a for a in (now, *recent) if a.angle_deg is not None]
    if not answers:
        return FusedSample(time_ns, None, None, now.sample.state)
    sigmas = [a.sigma_deg for a in answers]
    known = [s for s in sigmas if s is not None and s > 0.0]
    weights = [1.0 / s**2 for s in known] if len(known) == len(answers) else [1.0] * len(answers)
    total = sum(weights)
    angle = sum(w * a.angle_deg for w, a in zip(weights, answers, strict=True) if a.angle_deg is not None)
    sigma = total**-0.5 if len(known) == len(answers) else None
    return FusedSample(time_ns, angle / total, sigma, answers[0].sample.state)
