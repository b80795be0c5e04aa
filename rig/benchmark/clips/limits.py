"""What is asked of an estimator on labelled clips."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.errors import InputError
from rig.benchmark.clips.labelled import LabelledClip
from rig.benchmark.clips.scores import ClipScore
from rig.benchmark.measured import Measured, at_least, at_most


@dataclass(frozen=True, slots=True)
class ClipLimits:
    """Limits for the first estimator; None is not asked. group: the clips that count, all where None."""

    group: str | None = None
    within: float | None = None
    confidently_wrong: float | None = None
    two_sigma: float | None = None
    false_rest: float | None = None
    mean_small_deg: float | None = None
    p99_ms: float | None = None
    empty_as_contact: float | None = None
    held_as_contact: float | None = None

    def check(self, clips: Sequence[LabelledClip]) -> None:
        """Raise `InputError` where no clip is of the group."""
        names = sorted({clip.group for clip in clips})
        if self.group is not None and self.group not in names:
            raise InputError(f"no clip is in the group '{self.group}': groups are {', '.join(names)}")


NO_LIMITS = ClipLimits()
PROJECT = ClipLimits(within=0.5, confidently_wrong=0.04, two_sigma=0.88, p99_ms=8.0)
"""The project's limits for its own clips."""


def judge(score: ClipScore, limits: ClipLimits) -> tuple[Measured, ...]:
    """Return every limit that is asked, and whether it was kept."""
    rows = (
        _row(at_least, "share of labels within max(3 degrees, 2 label sigmas)", score.within, limits.within),
        _row(at_most, "share of labels confidently wrong", score.confidently_wrong, limits.confidently_wrong),
        _row(at_least, "share of answers within two sigma", score.two_sigma, limits.two_sigma),
        _row(at_most, "share of turned labels told as rest", score.false_rest, limits.false_rest),
        _row(at_most, "mean error up to 30 degrees", score.mean_small_deg, limits.mean_small_deg),
        _row(at_most, "time per frame, 99 %, ms", score.p99_ms, limits.p99_ms),
        _row(
            at_most,
            "share of empty frames reported as contact",
            score.empty_as_contact,
            limits.empty_as_contact,
        ),
        _row(
            at_least,
            "share of held frames reported as contact",
            score.held_as_contact,
            limits.held_as_contact,
        ),
    )
    return tuple(row for row in rows if row is not None)


def _row(
    compare: Callable[[str, float | None, float], Measured],
    name: str,
    value: float | None,
    limit: float | None,
) -> Measured | None:
    return None if limit is None else compare(name, value, limit)
