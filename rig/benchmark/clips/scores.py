"""Run estimators on labelled clips, measure their time, and compare their angles with the labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rig.benchmark.clips.labelled import ClipLabel, ClipVersion, LabelledClip
from rig.benchmark.harness import ALL, column
from rig.frames.estimates import FRAME_MS, Estimate, contact_ms, estimate_series, frame_ms, zeroed
from rig.results.scores import WRONG_DEG, WRONG_SIGMAS, is_confidently_wrong
from rig.results.shares import Share, share_of
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import EstimatorFaults, State, faults_of

CLOSE_DEG, LABEL_SIGMAS = 3.0, 2.0
"""An error counts as small up to 3 degrees, or up to 2 label sigmas, which the label's error may explain."""
SMALL_TURN_DEG = 30.0  # largest angle of a label that counts as a small rotation
USEFUL_SIGMA_DEG = 5.0  # largest sigma of a useful angle
TURNED_DEG, MISSED_SHARE = 10.0, 0.5
"""A rest is false if a label is at least 10 degrees and more than half of its angle was missed."""


@dataclass(frozen=True, slots=True)
class JudgedLabel:
    """A label with the estimate at its frame.

    angle_deg, sigma_deg: relative to the clip's reference; None if the frame was refused, sigma_deg also if
    the estimator has no sigma. held_deg: the last angle up to this frame, 0 before the first.
    """

    clip: str
    label: ClipLabel
    angle_deg: float | None
    sigma_deg: float | None
    held_deg: float

    @property
    def error_deg(self) -> float:
        """Absolute error; for a refused frame the error of the last angle before it."""
        return abs(self.held_deg - self.label.angle_deg)

    def within(self, allowed_deg: float) -> bool:
        """Return whether there is an angle with an error of at most 3 degrees, or of an allowed value."""
        return self.angle_deg is not None and self.error_deg <= max(CLOSE_DEG, allowed_deg)

    @property
    def useful(self) -> bool:
        return self.sigma_deg is not None and self.sigma_deg <= USEFUL_SIGMA_DEG

    @property
    def joint_sigma_deg(self) -> float | None:
        """Combined sigma of estimate and label; None without an estimate or its sigma."""
        return None if self.sigma_deg is None else float(np.hypot(self.sigma_deg, self.label.sigma_deg))

    @property
    def sigmas_off(self) -> float | None:
        sigma = self.joint_sigma_deg
        return None if sigma is None else self.error_deg / max(sigma, 1e-9)

    @property
    def confidently_wrong(self) -> bool:
        return is_confidently_wrong(self.error_deg, self.joint_sigma_deg)

    @property
    def false_rest(self) -> bool:
        """Whether the object has turned, but more than half of it was missed with a useful sigma."""
        true = self.label.angle_deg
        return self.useful and abs(true) >= TURNED_DEG and (true - self.held_deg) / true > MISSED_SHARE


@dataclass(frozen=True, slots=True)
class ClipScore:
    """Figures over labels; None if there is no value.

    answered, within_3, within, useful, confidently_wrong: shares of all labels. two_sigma: share of the
    angles with a sigma. false_rest: share of the labels of at least 10 degrees. empty_as_contact,
    held_as_contact: fractions reported as contact of the frames labelled as without and with contact.
    """

    answered: Share
    median_sigma_deg: float | None
    labels: int = column("labels", doc="frames with an angle measured by hand")
    within_3: Share = column(
        "within 3 deg", doc="share of the labels whose angle is off by at most 3 degrees"
    )
    within: Share = column(
        "within 3 deg or 2 label sigmas", doc="or by at most twice the standard deviation of the label"
    )
    mean_small_deg: float | None = column(
        "mean, up to 30 deg",
        ".2f",
        "mean error, degrees, of labels up to 30 degrees; a refusal keeps the last angle",
    )
    mean_deg: float = column("mean, all", ".2f", "the same over all labels")
    median_small_deg: float | None = column(
        "median, up to 30 deg", ".2f", "median error, degrees, of labels up to 30 degrees"
    )
    median_deg: float = column("median, all", ".2f", "the same over all labels")
    useful: Share | None = column("useful", doc=f"share with a sigma of at most {USEFUL_SIGMA_DEG:g} degrees")
    two_sigma: Share | None = column(
        "within 2 sigma", doc="share of the angles whose error is at most twice the sigma of angle and label"
    )
    confidently_wrong: Share | None = column(
        "confidently wrong", doc=f"share off by more than {WRONG_DEG:g} degrees and {WRONG_SIGMAS:g} sigma"
    )
    false_rest: Share | None = column(
        "false rest",
        doc="share of the labels from 10 degrees on of which more than half was missed, with a useful sigma",
    )
    frame_ms: tuple[float, float, float] | None = column(FRAME_MS, ".1f")
    empty_as_contact: float | None = column("empty reported as contact", ".1%", optional=True)
    held_as_contact: float | None = column("held reported as contact", ".1%", optional=True)

    @property
    def p99_ms(self) -> float | None:
        return None if self.frame_ms is None else self.frame_ms[-1]


def score(
    labels: Sequence[JudgedLabel],
    contact_ms: Sequence[float],
    has_sigma: bool,
    contacts: Sequence[tuple[bool, bool]] = (),
) -> ClipScore:
    """Summarize labels, at least one, and the run times of the frames with contact, ms.

    has_sigma: whether the estimator reports a sigma; without it, figures that need one are None. contacts:
    for each frame of a contact span, whether it is in contact and whether it was reported as contact.
    """
    errors = np.array([label.error_deg for label in labels])
    small = np.array([abs(label.label.angle_deg) <= SMALL_TURN_DEG for label in labels])
    turned = [label for label in labels if abs(label.label.angle_deg) >= TURNED_DEG]
    sigmas = [label.sigma_deg for label in labels if label.sigma_deg is not None]
    off = [value for label in labels if (value := label.sigmas_off) is not None]
    return ClipScore(
        labels=len(labels),
        answered=_share([label.angle_deg is not None for label in labels]),
        within_3=_share([label.within(CLOSE_DEG) for label in labels]),
        within=_share([label.within(LABEL_SIGMAS * label.label.sigma_deg) for label in labels]),
        mean_small_deg=float(errors[small].mean()) if small.any() else None,
        median_small_deg=float(np.median(errors[small])) if small.any() else None,
        mean_deg=float(errors.mean()),
        median_deg=float(np.median(errors)),
        useful=_share([label.useful for label in labels]) if has_sigma else None,
        two_sigma=share_of(value <= 2.0 for value in off),
        confidently_wrong=_share([label.confidently_wrong for label in labels]) if has_sigma else None,
        false_rest=share_of(label.false_rest for label in turned) if has_sigma else None,
        median_sigma_deg=float(np.median(sigmas)) if sigmas else None,
        frame_ms=frame_ms(contact_ms),
        empty_as_contact=_fraction([reported for held, reported in contacts if not held]),
        held_as_contact=_fraction([reported for held, reported in contacts if held]),
    )


def _share(values: Sequence[bool]) -> Share:
    share = share_of(values)
    if share is None:
        raise ValueError("a score needs at least one label")
    return share


def _fraction(values: Sequence[bool]) -> float | None:
    return sum(values) / len(values) if values else None


@dataclass(frozen=True, slots=True, eq=False)
class ClipRun:
    """One estimator on one clip."""

    clip: LabelledClip
    estimate: Estimate  # angles relative to the clip's reference
    labels: tuple[JudgedLabel, ...]  # labels with the angles at their frames
    contact_ms: tuple[float, ...]  # run time of each frame with contact
    has_sigma: bool
    contacts: tuple[tuple[bool, bool], ...] = ()  # of each labelled frame: in contact, reported as contact

    @property
    def score(self) -> ClipScore:
        """Figures of this clip."""
        return score(self.labels, self.contact_ms, self.has_sigma, self.contacts)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorRuns:
    """One estimator on all clips. groups: its figures by group, `ALL` first, then sorted by name."""

    name: str
    runs: tuple[ClipRun, ...]
    groups: Mapping[str, ClipScore]

    def of_version(self, version: ClipVersion) -> "EstimatorRuns":
        return summed(self.name, [run for run in self.runs if run.clip.version is version])

    @property
    def faults(self) -> EstimatorFaults | None:
        """Faults of a foreign estimator; None without faults."""
        return faults_of(answer.sample for run in self.runs for answer in run.estimate.answers)


def run_clip(clip: LabelledClip, choice: EstimatorChoice) -> ClipRun:
    answers = estimate_series(clip.series, choice.make(clip.background))
    estimate = zeroed(answers, answers[clip.reference_frame].time)
    has_sigma = any(sigma is not None for sigma in estimate.sigmas_deg)
    judged = []
    for label in clip.labels:
        before = reversed(estimate.angles_deg[clip.reference_frame : label.frame + 1])
        held = next((angle for angle in before if angle is not None), 0.0)
        at = estimate.angles_deg[label.frame], estimate.sigmas_deg[label.frame]
        judged.append(JudgedLabel(clip.name, label, *at, held))
    contacts = tuple(
        (span.contact, answer.sample.state is not State.NO_CONTACT)
        for span in clip.contacts
        for answer in answers[span.first : span.last + 1]
    )
    return ClipRun(clip, estimate, tuple(judged), tuple(contact_ms(answers)), has_sigma, contacts)


def summed(name: str, runs: Sequence[ClipRun]) -> EstimatorRuns:
    groups = {}
    for group in (ALL, *sorted({run.clip.group for run in runs})):
        of = [run for run in runs if group in (ALL, run.clip.group)]
        groups[group] = score(
            [label for run in of for label in run.labels],
            [ms for run in of for ms in run.contact_ms],
            any(run.has_sigma for run in of),
            [contact for run in of for contact in run.contacts],
        )
    return EstimatorRuns(name, tuple(runs), groups)
