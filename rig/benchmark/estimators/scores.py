"""Combine the errors of estimated angles over many lifts or clips."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.results.metrics import Mare, mare_of
from rig.results.scores import SeriesScore
from rig.results.shares import Share, share_of

ELONGATED = ("t1", "t2", "t3", "t4", "t6", "t7")  # objects with elongated contacts
ONSET_WITHIN_S = 0.05  # largest error of an onset that counts as within
EARLY_S = 0.1  # an onset reported earlier than this before the true one is a false alarm


@dataclass(frozen=True, slots=True)
class OnsetScore:
    """Slip onsets over many lifts."""

    true: int  # number of lifts with an onset
    error_s: float | None  # median of |estimated - true|
    within: Share | None  # share of the true onsets that were reported with an error of at most 50 ms
    missed: int  # number of lifts whose onset was not reported
    false_alarms: int  # lifts with a report but without an onset, or with a report over 100 ms too early


@dataclass(frozen=True, slots=True)
class ContenderScore:
    """Figures of one estimator over many lifts or clips; the MAREs are those of `SeriesScore`."""

    mare: Mare | None
    mare_b: Mare | None
    mare_held: Mare | None
    mare_unsigned: Mare | None
    mare_elongated: Mare | None  # over objects with elongated contacts
    worst_deg: float | None  # largest mean error of a lift or clip
    worst: str  # its key
    answered: float  # fraction of frames with an angle
    within_two_sigma: float | None  # fraction of these frames, None without sigmas
    wrong_lifts: int  # number of lifts with a confidently wrong angle
    onset: OnsetScore  # onsets found afterwards
    event: OnsetScore | None  # onsets reported during the lift; None for an estimator without rates

    @property
    def mare_deg(self) -> float | None:
        return self.mare and self.mare.mean_deg

    @property
    def wrong_if_sigma(self) -> int | None:
        """Number of lifts with a confidently wrong angle; None for an estimator without sigma."""
        return None if self.within_two_sigma is None else self.wrong_lifts

    @property
    def worst_text(self) -> str:
        return "-" if self.worst_deg is None else f"{self.worst_deg:.2f} ({self.worst})"


def score_all(series: Sequence[SeriesScore]) -> ContenderScore:
    """Combine the scores of lifts or clips; the key of a lift begins with its object, as "t1/3"."""
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
        wrong_lifts=sum(s.wrong > 0 for s in series),
        onset=_onsets([(s.onset_truth_s, s.onset_estimate_s) for s in series]),
        event=_onsets([(s.onset_truth_s, s.onset_event_s) for s in series])
        if any(s.has_rates for s in series)
        else None,
    )


def _onsets(onsets_s: Sequence[tuple[float | None, float | None]]) -> OnsetScore:
    """Score pairs of true and estimated onset, None without an onset."""
    errors = [e - t for t, e in onsets_s if t is not None and e is not None]
    true = sum(t is not None for t, _ in onsets_s)
    unfounded = sum(t is None and e is not None for t, e in onsets_s)
    return OnsetScore(
        true=true,
        error_s=float(np.median(np.abs(errors))) if errors else None,
        within=share_of([*(abs(e) <= ONSET_WITHIN_S for e in errors), *[False] * (true - len(errors))]),
        missed=true - len(errors),
        false_alarms=unfounded + sum(e < -EARLY_S for e in errors),
    )
