"""Errors of estimated angles: the figures of one lift or clip, and of many (contract, metrics)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.results.metrics import ErrorSummary, Mare, hold_last, mare_of, summarize

Floats = NDArray[np.float64]
ELONGATED = ("t1", "t2", "t3", "t4", "t6", "t7")
"""Objects whose contacts are long (contract, objects)."""
ONSET_WITHIN_S = 0.05
EARLY_S = 0.1
"""An onset that is reported earlier than this before the true one is a false alarm."""


@dataclass(frozen=True, slots=True)
class SeriesScore:
    """One lift, or one clip, of one contender: errors in degrees, None without an answer.

    re: over all frames (B and C), re_b over B, re_held with refused frames held, re_unsigned of the
    angle's size alone. answered: share of frames. sure: answered frames with a sigma; within: those
    of them whose error is at most two sigma. Onsets in s since the lift began, None without one:
    true, found afterwards, and reported online (by a contender that has rates).
    """

    key: str
    re: ErrorSummary | None
    re_b: ErrorSummary | None
    re_held: ErrorSummary | None
    re_unsigned: ErrorSummary | None
    frames: int
    answered: float
    sure: int
    within: int
    onset_truth_s: float | None = None
    onset_estimate_s: float | None = None
    onset_event_s: float | None = None
    has_rates: bool = False


@dataclass(frozen=True, slots=True)
class OnsetScore:
    """Slip onsets over many lifts.

    true: lifts that have one. error_s: median of |estimated - true|. within: share of the true ones
    that were reported within 50 ms. missed: lifts whose onset was not reported; false_alarms: lifts
    without an onset in which one was reported, or in which it was reported over 100 ms early.
    """

    true: int
    error_s: float | None
    within: float | None
    missed: int
    false_alarms: int


@dataclass(frozen=True, slots=True)
class ContenderScore:
    """Many lifts or clips of one contender.

    worst_deg: the largest mean error of one of them, whose key is `worst`. within_two_sigma: share of
    answered frames, None without sigmas. onset: found afterwards; event: reported online, None for a
    contender without rates.
    """

    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    mare_unsigned: Mare | None
    mare_elongated: Mare | None
    worst_deg: float | None
    worst: str
    answered: float
    within_two_sigma: float | None
    onset: OnsetScore
    event: OnsetScore | None

    @property
    def worst_text(self) -> str:
        """The largest mean error, and whose it is."""
        return "-" if self.worst_deg is None else f"{self.worst_deg:.2f} ({self.worst})"


def score_series(
    key: str,
    angles_deg: Sequence[float | None],
    sigmas_deg: Sequence[float | None],
    true_deg: Sequence[float | None],
    in_b: NDArray[np.bool_] | None = None,
    onsets_s: tuple[float | None, float | None, float | None] = (None, None, None),
    has_rates: bool = False,
) -> SeriesScore:
    """Score angles (N), None if refused, against the truth (N), None if unknown, in degrees."""
    angles, truth, sigmas = _floats(angles_deg), _floats(true_deg), _floats(sigmas_deg)
    errors = np.abs(angles - truth)
    sure = np.isfinite(errors) & np.isfinite(sigmas)
    return SeriesScore(
        key=key,
        re=_summary(errors),
        re_b=_summary(errors if in_b is None else errors[in_b]),
        re_held=_summary(np.abs(hold_last(angles_deg) - truth)),
        re_unsigned=_summary(np.abs(np.abs(angles) - np.abs(truth))),
        frames=len(angles),
        answered=float(np.isfinite(angles).mean()) if len(angles) else 0.0,
        sure=int(sure.sum()),
        within=int((errors[sure] <= 2.0 * sigmas[sure]).sum()),
        onset_truth_s=onsets_s[0],
        onset_estimate_s=onsets_s[1],
        onset_event_s=onsets_s[2],
        has_rates=has_rates,
    )


def score_all(series: Sequence[SeriesScore]) -> ContenderScore:
    """Combine lifts or clips; a lift's key begins with its object, as "t1/3"."""
    means = [(s.re.mean_deg, s.key) for s in series if s.re]
    worst_deg, worst = max(means, default=(None, ""))
    long = [s for s in series if s.key.split("/")[0] in ELONGATED]
    sure = sum(s.sure for s in series)
    frames = sum(s.frames for s in series)
    return ContenderScore(
        mare=mare_of(s.re for s in series),
        mare_b=mare_of(s.re_b for s in series),
        mare_held=mare_of(s.re_held for s in series),
        mare_unsigned=mare_of(s.re_unsigned for s in series),
        mare_elongated=mare_of(s.re for s in long),
        worst_deg=worst_deg,
        worst=worst,
        answered=sum(s.answered * s.frames for s in series) / frames if frames else 0.0,
        within_two_sigma=sum(s.within for s in series) / sure if sure else None,
        onset=_onsets([(s.onset_truth_s, s.onset_estimate_s) for s in series]),
        event=_onsets([(s.onset_truth_s, s.onset_event_s) for s in series])
        if any(s.has_rates for s in series)
        else None,
    )


def _onsets(onsets_s: Sequence[tuple[float | None, float | None]]) -> OnsetScore:
    """Score pairs of a true and an estimated onset."""
    errors = [e - t for t, e in onsets_s if t is not None and e is not None]
    true = sum(t is not None for t, _ in onsets_s)
    unfounded = sum(t is None and e is not None for t, e in onsets_s)
    return OnsetScore(
        true=true,
        error_s=float(np.median(np.abs(errors))) if errors else None,
        within=sum(abs(e) <= ONSET_WITHIN_S for e in errors) / true if true else None,
        missed=true - len(errors),
        false_alarms=unfounded + sum(e < -EARLY_S for e in errors),
    )


def _floats(values: Sequence[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _summary(errors_deg: Floats) -> ErrorSummary | None:
    return summarize(errors_deg[np.isfinite(errors_deg)])
