"""How well an estimator's answers agree with hand-measured angles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.benchmark.clips.labelled import ClipLabel
from rig.benchmark.harness import column
from rig.results.scores import is_confidently_wrong

CLOSE_DEG, LABEL_SIGMAS = 3.0, 2.0
"""Within 3 degrees; an error below 2 label sigmas is no evidence of a fault."""
SMALL_TURN_DEG = 30.0
USEFUL_SIGMA_DEG = 5.0
TURNED_DEG, MISSED_SHARE = 10.0, 0.5


@dataclass(frozen=True, slots=True)
class JudgedLabel:
    """A label and what was answered there.

    angle_deg, sigma_deg: from the clip's reference, None where refused, or where the estimator has no
    sigma. held_deg: the last angle answered, 0 before any.
    """

    clip: str
    label: ClipLabel
    angle_deg: float | None
    sigma_deg: float | None
    held_deg: float

    @property
    def error_deg(self) -> float:
        """Size of the error; a refused label's is that of the last angle answered."""
        return abs(self.held_deg - self.label.angle_deg)

    @property
    def close(self) -> bool:
        """Whether it was answered within 3 degrees."""
        return self.angle_deg is not None and self.error_deg <= CLOSE_DEG

    @property
    def close_enough(self) -> bool:
        """Whether it was answered within 3 degrees or 2 label sigmas, whichever is more."""
        allowed = max(CLOSE_DEG, LABEL_SIGMAS * self.label.sigma_deg)
        return self.angle_deg is not None and self.error_deg <= allowed

    @property
    def useful(self) -> bool:
        """Whether it was answered with a sigma of at most 5 degrees."""
        return self.sigma_deg is not None and self.sigma_deg <= USEFUL_SIGMA_DEG

    @property
    def joint_sigma_deg(self) -> float | None:
        """Sigma of answer and label together; None without an answer or its sigma."""
        return None if self.sigma_deg is None else float(np.hypot(self.sigma_deg, self.label.sigma_deg))

    @property
    def sigmas_off(self) -> float | None:
        """Error in sigmas of answer and label together; None without an answer or its sigma."""
        sigma = self.joint_sigma_deg
        return None if sigma is None else self.error_deg / max(sigma, 1e-9)

    @property
    def confidently_wrong(self) -> bool:
        """Whether it is confidently wrong by the sigma of answer and label together."""
        return is_confidently_wrong(self.error_deg, self.joint_sigma_deg)

    @property
    def turned(self) -> bool:
        """Whether the object has turned far enough for a rest to be false."""
        return abs(self.label.angle_deg) >= TURNED_DEG

    @property
    def false_rest(self) -> bool:
        """Whether more than half of a turn by 10 degrees or more was missed, with a sigma of at most 5."""
        if not (self.turned and self.useful):
            return False
        true = self.label.angle_deg
        return (true - self.held_deg) / true > MISSED_SHARE


@dataclass(frozen=True, slots=True)
class ClipScore:
    """Figures over labels; None if there is nothing to measure. Times are per frame, ms.

    within_3, within, useful, confidently_wrong: shares of all labels, the last three by the label's sigma
    too where it is asked for. two_sigma: of answers with a sigma. false_rest: of labels turned by 10
    degrees or more. empty_as_contact, held_as_contact: shares reported as contact, of the frames known to be
    without contact and in contact.
    """

    answered: float
    median_sigma_deg: float | None
    labels: int = column("labels")
    within_3: float = column("within 3 deg", ".0%")
    within: float = column("within 3 deg or 2 label sigmas", ".0%")
    mean_small_deg: float | None = column("mean, up to 30 deg", ".2f")
    mean_deg: float = column("mean, all", ".2f")
    median_small_deg: float | None = column("median, up to 30 deg", ".2f")
    median_deg: float = column("median, all", ".2f")
    useful: float | None = column("useful", ".0%")
    two_sigma: float | None = column("within 2 sigma", ".0%")
    confidently_wrong: float | None = column("confidently wrong", ".0%")
    false_rest: float | None = column("false rest", ".0%")
    frame_ms: tuple[float, float] = column("ms per frame: median, 99 %", ".2f")
    empty_as_contact: float | None = column("empty reported as contact", ".1%", optional=True)
    held_as_contact: float | None = column("held reported as contact", ".1%", optional=True)

    @property
    def p99_ms(self) -> float:
        """Time per frame, 99th percentile, ms."""
        return self.frame_ms[1]


def score(
    labels: Sequence[JudgedLabel],
    frame_ms: Sequence[float],
    has_sigma: bool,
    contacts: Sequence[tuple[bool, bool]] = (),
) -> ClipScore:
    """Summarise labels, at least one, and the times of frames, at least one.

    has_sigma: whether the estimator reports a sigma; without it, figures that need one are None. contacts:
    for each frame of a contact span, whether it is in contact and whether it was reported as contact.
    """
    errors = np.array([label.error_deg for label in labels])
    small = np.array([abs(label.label.angle_deg) <= SMALL_TURN_DEG for label in labels])
    turned = [label for label in labels if label.turned]
    sigmas = [label.sigma_deg for label in labels if label.sigma_deg is not None]
    off = [value for label in labels if (value := label.sigmas_off) is not None]
    return ClipScore(
        labels=len(labels),
        answered=_share([label.angle_deg is not None for label in labels]),
        within_3=_share([label.close for label in labels]),
        within=_share([label.close_enough for label in labels]),
        mean_small_deg=float(errors[small].mean()) if small.any() else None,
        median_small_deg=float(np.median(errors[small])) if small.any() else None,
        mean_deg=float(errors.mean()),
        median_deg=float(np.median(errors)),
        useful=_share([label.useful for label in labels]) if has_sigma else None,
        two_sigma=_share([value <= 2.0 for value in off]) if off else None,
        confidently_wrong=_share([label.confidently_wrong for label in labels]) if has_sigma else None,
        false_rest=_share([label.false_rest for label in turned]) if has_sigma and turned else None,
        median_sigma_deg=float(np.median(sigmas)) if sigmas else None,
        frame_ms=(float(np.median(frame_ms)), float(np.percentile(frame_ms, 99))),
        empty_as_contact=_share_or_none([reported for held, reported in contacts if not held]),
        held_as_contact=_share_or_none([reported for held, reported in contacts if held]),
    )


def _share(values: Sequence[bool]) -> float:
    return sum(values) / len(values)


def _share_or_none(values: Sequence[bool]) -> float | None:
    return _share(values) if values else None
