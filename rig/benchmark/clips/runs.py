"""Run estimators on labelled clips, measure their time, and compare their angles with the labels."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rig.benchmark.clips.labelled import ClipVersion, LabelledClip
from rig.benchmark.clips.scores import ClipScore, JudgedLabel, score
from rig.frames.estimates import Estimate, contact_ms, estimate_series, zeroed
from rig.tactile.estimators import EstimatorChoice
from rig.tactile.sample import EstimatorFaults, State, faults_of

ALL = "all"
"""Name of the group of all clips."""


@dataclass(frozen=True, slots=True, eq=False)
class ClipRun:
    """One estimator on one clip.

    estimate: angles relative to the clip's reference. labels: labels with the angles at their frames.
    contact_ms: run time of each frame with contact. contacts: for each frame of a contact span, whether it is
    in contact and whether it was reported as contact.
    """

    clip: LabelledClip
    estimate: Estimate
    labels: tuple[JudgedLabel, ...]
    contact_ms: tuple[float, ...]
    has_sigma: bool
    contacts: tuple[tuple[bool, bool], ...] = ()

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
        """Return the runs on the clips of one version."""
        return summed(self.name, [run for run in self.runs if run.clip.version is version])

    @property
    def faults(self) -> EstimatorFaults | None:
        """Faults of a foreign estimator; None without faults."""
        return faults_of(sample for run in self.runs for sample in run.estimate.samples)


def run_clip(clip: LabelledClip, choice: EstimatorChoice) -> ClipRun:
    """Run one estimator on one clip."""
    raw = estimate_series(clip.series, choice.make(clip.background))
    estimate = zeroed(raw, raw.times[clip.reference_frame])
    has_sigma = any(sample.sigma_deg is not None for sample in estimate.samples)
    return ClipRun(
        clip,
        estimate,
        tuple(_judged(clip, estimate)),
        tuple(contact_ms(estimate.samples)),
        has_sigma,
        tuple(_reported(clip, estimate)),
    )


def summed(name: str, runs: Sequence[ClipRun]) -> EstimatorRuns:
    """Summarize the runs of an estimator over all clips and by group."""
    names = sorted({run.clip.group for run in runs})
    groups = {name: _together([run for run in runs if run.clip.group == name]) for name in names}
    return EstimatorRuns(name, tuple(runs), {ALL: _together(runs), **groups})


def _together(runs: Sequence[ClipRun]) -> ClipScore:
    labels = [label for run in runs for label in run.labels]
    times_ms = [ms for run in runs for ms in run.contact_ms]
    contacts = [contact for run in runs for contact in run.contacts]
    return score(labels, times_ms, any(run.has_sigma for run in runs), contacts)


def _judged(clip: LabelledClip, estimate: Estimate) -> Iterator[JudgedLabel]:
    samples = estimate.samples
    for label in clip.labels:
        before = reversed(samples[clip.reference_frame : label.frame + 1])
        held = next((sample.angle_deg for sample in before if sample.angle_deg is not None), 0.0)
        at_label = samples[label.frame]
        yield JudgedLabel(clip.name, label, at_label.angle_deg, at_label.sigma_deg, held)


def _reported(clip: LabelledClip, estimate: Estimate) -> Iterator[tuple[bool, bool]]:
    """Yield, for each frame of a contact span, whether it is in contact and whether it was reported so."""
    for span in clip.contacts:
        for sample in estimate.samples[span.first : span.last + 1]:
            yield span.contact, sample.state is not State.NO_CONTACT
