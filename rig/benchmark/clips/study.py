"""`rig benchmark clips`: compare estimators on labelled clips.

The set `octopi` (24 real clips of a GelSight Mini) is divided by object into two halves that were about
equally difficult for an earlier estimator. Constants are fitted on the group `development`; designs of the
estimator were also chosen by their figures on the group `validation`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, ScalarFormatter

from drivers.errors import InputError, plural, unknown_name
from drivers.progress import name_work
from rig.benchmark.clips.labelled import (
    ClipLabel,
    ClipVersion,
    LabelledClip,
    chosen_versions,
    clip_version,
    read_clips,
)
from rig.benchmark.clips.public import SETS, PublicSet, find_set, make_clips
from rig.benchmark.harness import (
    ALL,
    Cell,
    Report,
    Run,
    Study,
    Table,
    column,
    limit_table,
    machine,
    processor_and_cores,
    table_of,
)
from rig.benchmark.measured import NONE, Measured, at_least, at_most
from rig.benchmark.timing import (
    ALONE,
    AS_MULTIPLE,
    LIVE,
    PYTHON,
    TIMES_REFERENCE,
    Streamed,
    interface_ms,
    reference_ms,
    times_reference,
)
from rig.declared import argument, option
from rig.frames.estimates import FRAME_MS, Estimate, apply_zero, contact_ms, estimate_series, frame_ms
from rig.pages.figure import band, column_files, drawing, legend_above, limits, svg
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, SERIES, TRUTH
from rig.report.strips import Still, still
from rig.results.metrics import USEFUL_SIGMA_DEG, mean_interval
from rig.results.scores import WRONG_DEG, WRONG_SIGMAS, is_confidently_wrong
from rig.results.shares import Share, share_of
from rig.tactile.angles import Angles
from rig.tactile.estimators import EstimatorChoice, choose_estimator
from rig.tactile.sample import EstimatorFaults, State, faults_of
from rig.version import version_text

ESTIMATORS = ("slip", "ecc", "ellipse", "pca", "anglenet")  # estimators that are compared by default
PROJECT = {"within": 0.5, "confidently_wrong": 0.04, "two_sigma": 0.88}
"""Limits of this project for its own clips, by option."""
SIGMAS = 2.0
CLOSE_DEG, LABEL_SIGMAS = 3.0, 2.0
"""An error counts as small up to 3 degrees, or up to 2 label sigmas, which the label's error may explain."""
SMALL_TURN_DEG = 30.0  # largest angle of a label that counts as a small rotation
TURNED_DEG, MISSED_SHARE = 10.0, 0.5
"""A rest is false if a label is at least 10 degrees and more than half of its angle was missed."""
TIMES_ALONE = "times the estimator alone: median, 99 %"
CHART_PX = (440, 260)
STILL_WIDTH_PX = 160
_ROOM, _LEAST_ROOM_DEG = 0.06, 1.0
_STYLES, _MARKERS = ("-", "--", ":", "-."), "osD^"  # estimators that share a colour differ in these
_BEFORE, _AFTER = 10, 5  # frames shown before the reference and after the last label


@dataclass(frozen=True, slots=True)
class ClipsOptions:
    """Options of `rig benchmark clips`. A limit of None is not checked."""

    folder: Path = argument(
        ...,
        "Folder with a folder per clip: frames/, a video or a ROS bag, background.png, labels.csv, "
        "timestamps.csv, contacts.csv. Or trials of TactileTracking. "
        "With --set: a clone of the set's repository.",
    )
    estimator: list[str] | None = option(
        None,
        "Estimator, also your own as package.module:Class; repeat for more. Limits apply to the "
        "first. Default: slip, ecc, ellipse, pca, anglenet.",
    )
    public_set: str | None = option(
        None,
        f"Public data set whose labels are part of this program ({', '.join(SETS)}). The argument is then a "
        "clone of its repository, from which the frames are made.",
        "--set",
    )
    groups: Path | None = option(
        None,
        "CSV file with columns clip,group. Default: groups.csv in the folder, else the column group "
        "of labels.csv.",
    )
    topic: str | None = option(None, "Image topic of ROS bags. Default: the only image topic of each bag.")
    group: str | None = option(None, "Group that limits apply to. Default: all clips.")
    limits: bool = option(
        False,
        "Apply this project's limits for the set octopi: --within 0.5, --confidently-wrong 0.04, "
        "--two-sigma 0.88.",
        "--limits",
    )
    within: float | None = option(
        None, "Limit: lowest fraction of labels within 3 degrees or 2 label sigmas."
    )
    confidently_wrong: float | None = option(
        None, "Limit: highest fraction of labels with an error of more than 10 degrees and 3 sigma."
    )
    two_sigma: float | None = option(None, "Limit: lowest fraction of angles within two sigma.")
    false_rest: float | None = option(None, "Limit: highest fraction of turned labels reported as at rest.")
    mean_deg: float | None = option(None, "Limit: largest mean error for angles up to 30 degrees, degrees.")
    p99_ms: float | None = option(None, "Limit: longest time per frame with contact (99th percentile), ms.")
    empty: float | None = option(
        None, "Limit: highest fraction of frames without contact reported as contact."
    )
    held: float | None = option(None, "Limit: lowest fraction of frames in contact reported as contact.")
    augment: str | None = option(
        None,
        "Also score these versions of each clip, separated by commas: mirror (left-right), flip "
        "(top-bottom), reverse (in time, from the last labelled frame). Limits apply to all versions.",
    )
    reversed_turns: bool = option(False, "Negate the known angles of public sets.", "--reversed-turns")


@dataclass(frozen=True, slots=True)
class JudgedLabel:
    """A label with the estimate at its frame.

    angle_deg, sigma_deg: relative to the clip's reference; None if the frame was refused, sigma_deg also if
    the estimator has no sigma. held_deg: the last angle up to this frame, 0 before the first.
    """

    label: ClipLabel
    angle_deg: float | None
    sigma_deg: float | None
    held_deg: float

    @property
    def error_deg(self) -> float:
        """Absolute error; for a refused frame the error of the last angle before it."""
        return abs(self.held_deg - self.label.angle_deg)

    def within(self, allowed_deg: float) -> bool:
        """Return whether there is an angle whose error is at most 3 degrees or the allowed error."""
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
        """Whether the object has turned, but more than half of its angle was missed with a useful sigma."""
        true = self.label.angle_deg
        return self.useful and abs(true) >= TURNED_DEG and (true - self.held_deg) / true > MISSED_SHARE


@dataclass(frozen=True, slots=True)
class Answers:
    """The answers of an estimator on clips, for their figures. labels: at least one.

    contact_ms: run time of each frame with contact. has_sigma: whether the estimator reports a sigma; without
    it, figures that need one are None. contacts: for each frame of a contact span, whether it is in contact
    and whether it was reported as contact. reference_ms: run time of the reference for each frame.
    """

    labels: tuple[JudgedLabel, ...]
    contact_ms: tuple[float, ...]
    has_sigma: bool
    contacts: tuple[tuple[bool, bool], ...] = ()
    reference_ms: tuple[float, ...] = ()

    def share(
        self, has: Callable[[JudgedLabel], bool], needs_sigma: bool = False, least_deg: float = 0.0
    ) -> Share | None:
        """Return the share of the labels from `least_deg` on that have a property."""
        labels = [label for label in self.labels if abs(label.label.angle_deg) >= least_deg]
        return share_of(map(has, labels)) if self.has_sigma or not needs_sigma else None

    def error_deg(
        self, average: Callable[[list[float]], Any], most_deg: float = float("inf")
    ) -> float | None:
        """Return the average error of the labels with an angle of at most `most_deg`."""
        errors = [label.error_deg for label in self.labels if abs(label.label.angle_deg) <= most_deg]
        return float(average(errors)) if errors else None

    def reported_as_contact(self, touches: bool) -> float | None:
        """Return the fraction of the frames with or without contact that were reported as contact."""
        reported = [reported for touching, reported in self.contacts if touching is touches]
        return sum(reported) / len(reported) if reported else None


@dataclass(frozen=True, slots=True)
class ClipScore:
    """Figures over labels; None if there is no value.

    answered, within_3, within, useful, confidently_wrong: shares of all labels. two_sigma: share of the
    angles with a sigma. false_rest: share of the labels of at least 10 degrees. empty_as_contact,
    held_as_contact: fractions reported as contact of the frames labelled as without and with contact.
    """

    answered: Share | None
    labels: int = column("labels", doc="frames with an angle measured by hand")
    within_3: Share | None = column(
        "within 3 deg", doc="share of the labels whose angle is off by at most 3 degrees"
    )
    within: Share | None = column(
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
    frame_ms: tuple[float, float, float] | None = column(FRAME_MS, ".1f", f"through {PYTHON}")
    times_reference: float | None = column(TIMES_REFERENCE, ".2f", AS_MULTIPLE)
    empty_as_contact: float | None = column("empty reported as contact", ".1%", optional=True)
    held_as_contact: float | None = column("held reported as contact", ".1%", optional=True)

    @property
    def p99_ms(self) -> float | None:
        return None if self.frame_ms is None else self.frame_ms[-1]


FIGURES: dict[str, Callable[[Answers], Any]] = {
    "labels": lambda of: len(of.labels),
    "answered": lambda of: of.share(lambda label: label.angle_deg is not None),
    "within_3": lambda of: of.share(lambda label: label.within(CLOSE_DEG)),
    "within": lambda of: of.share(lambda label: label.within(LABEL_SIGMAS * label.label.sigma_deg)),
    "mean_small_deg": lambda of: of.error_deg(np.mean, SMALL_TURN_DEG),
    "median_small_deg": lambda of: of.error_deg(np.median, SMALL_TURN_DEG),
    "mean_deg": lambda of: of.error_deg(np.mean),
    "median_deg": lambda of: of.error_deg(np.median),
    "useful": lambda of: of.share(lambda label: label.useful, needs_sigma=True),
    "two_sigma": lambda of: share_of(
        off <= SIGMAS for label in of.labels if (off := label.sigmas_off) is not None
    ),
    "confidently_wrong": lambda of: of.share(lambda label: label.confidently_wrong, needs_sigma=True),
    "false_rest": lambda of: of.share(lambda label: label.false_rest, True, TURNED_DEG),
    "frame_ms": lambda of: frame_ms(of.contact_ms),
    "times_reference": lambda of: times_reference(of.contact_ms, of.reference_ms),
    "empty_as_contact": lambda of: of.reported_as_contact(False),
    "held_as_contact": lambda of: of.reported_as_contact(True),
}
"""The computation of each figure of `ClipScore`."""


def score(answers: Answers) -> ClipScore:
    return ClipScore(**{name: compute(answers) for name, compute in FIGURES.items()})


@dataclass(frozen=True, slots=True, eq=False)
class ClipRun:
    clip: LabelledClip
    estimate: Estimate  # angles relative to the clip's reference
    answers: Answers

    @property
    def score(self) -> ClipScore:
        return score(self.answers)


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorRuns:
    """One estimator on all clips. groups: its figures by group, `ALL` first, then sorted by name."""

    name: str
    runs: tuple[ClipRun, ...]
    groups: Mapping[str, ClipScore]

    def of_version(self, version: ClipVersion) -> "EstimatorRuns":
        return score_groups(self.name, [run for run in self.runs if run.clip.version is version])

    @property
    def faults(self) -> EstimatorFaults | None:
        return faults_of(sample for run in self.runs for sample in run.estimate.samples)


def run_clip(clip: LabelledClip, choice: EstimatorChoice, reference_ms: tuple[float, ...] = ()) -> ClipRun:
    """Estimate the frames of a clip through the interface of `rig.estimator`. reference_ms: see `Answers`."""
    name_work(f"{clip.name}, {choice.name}")
    estimator = Streamed(choice.make(clip.background), clip.background)
    raw = estimate_series(clip.series, estimator, clip.series.count)
    estimate = apply_zero(raw, raw.times[clip.reference_frame])
    samples, judged = estimate.samples, []
    for label in clip.labels:
        before = reversed(samples[clip.reference_frame : label.frame + 1])
        held = next((sample.angle_deg for sample in before if sample.angle_deg is not None), 0.0)
        at = samples[label.frame]
        judged.append(JudgedLabel(label, at.angle_deg, at.sigma_deg, held))
    contacts = tuple(
        (span.contact, sample.state is not State.NO_CONTACT)
        for span in clip.contacts
        for sample in samples[span.first : span.last + 1]
    )
    has_sigma = any(sample.sigma_deg is not None for sample in samples)
    answers = Answers(tuple(judged), tuple(contact_ms(samples)), has_sigma, contacts, reference_ms)
    return ClipRun(clip, estimate, answers)


def score_groups(name: str, runs: Sequence[ClipRun]) -> EstimatorRuns:
    """Return the figures of an estimator over all its runs and by group of the clips."""
    groups = {}
    for group in (ALL, *sorted({run.clip.group for run in runs})):
        of = [run.answers for run in runs if group in (ALL, run.clip.group)]
        joined = Answers(
            tuple(label for each in of for label in each.labels),
            tuple(ms for each in of for ms in each.contact_ms),
            any(each.has_sigma for each in of),
            tuple(contact for each in of for contact in each.contacts),
            tuple(ms for each in of for ms in each.reference_ms),
        )
        groups[group] = score(joined)
    return EstimatorRuns(name, tuple(runs), groups)


def measure(options: ClipsOptions, run: Run) -> Report:
    """Compare the angles of estimators with the labels of clips, real or simulated.

    `rig label-angle` writes labels.csv. Its columns are reference_frame, keyframe, angle_deg
    (counter-clockwise positive, 0 at the reference) and sigma_deg; frames are numbered from 0. Every label
    counts: a refused frame counts as wrong, and its error in the means is that of the last angle before it.
    The exit code is 4 if the first estimator misses a limit that was given.

    With --augment each clip is also scored in further versions with transformed labels, and a table has a row
    per version. Mirroring and flipping negate the angles. The reversed version starts at the last labelled
    frame, which is its reference.

    An optional contacts.csv has the columns first, last and contact (yes or no), for ranges of frames that
    are all with or all without contact. It adds two columns with the fractions of these frames that were
    reported as contact.

    A share of labels has its 95 % interval in brackets (Wilson, as if the labels were independent; those of
    one clip are not). Below five labels the numbers are printed instead. Times are over frames with contact,
    through `rig.estimator` with its checks. They are also printed as multiples of the time of OpenCV's
    findTransformECC on the same frames, because processors differ. A further table compares the times of the
    first estimator alone, through `rig.estimator`, and in `rig live`.

    With --set, the argument is a clone of a public repository: octopi (github.com/clear-nus/octopi),
    digit-edges (github.com/pyonkti/digit) or gripper-slips
    (github.com/amitparag/Incipient-Slip-Detection). The labelled files are compared with stored hashes. The
    frames are made in ~/.cache/visuotactile-slip-rig/clips, or below XDG_CACHE_HOME. The set's row of the
    README is printed below the tables.

    Examples:
      rig benchmark clips clips/ --out clips_page
      rig benchmark clips octopi/ --set octopi --estimator slip
      rig benchmark clips TactileTracking/ --estimator slip --out tracking_page
      rig benchmark clips clips/ --estimator slip --groups groups.csv --group indoors --json
      rig benchmark clips clips/ --estimator slip --augment mirror,flip,reverse
    """
    cv2.setNumThreads(1)
    choices = [choose_estimator(name) for name in options.estimator or ESTIMATORS]
    clips = choose_clips(options, run.say)
    # One worker, because the time per frame is measured.
    measured = run.each(partial(measure_clip, choices), clips, attrgetter("name"), workers=1)
    runs, interfaces = zip(*measured, strict=True)
    of_estimators = zip(choices, zip(*runs, strict=True), strict=True)
    return make_report(options, [score_groups(choice.name, of) for choice, of in of_estimators], interfaces)


def choose_clips(options: ClipsOptions, say: Callable[[str], None]) -> list[LabelledClip]:
    """Return the clips in all chosen versions. say: prints the source of a public set.

    Raises `InputError` for a missing or damaged set, and for an unknown version or group.
    """
    versions, folder = chosen_versions(options.augment), options.folder
    if options.public_set is not None:
        known = find_set(options.public_set)
        folder = make_clips(known, options.folder)
        say(f"clips of {known.name} at {known.commit[:8]}: {folder}; licence of the frames: {known.licence}")
    plain = read_clips(folder, options.groups, -1 if options.reversed_turns else 1, options.topic)
    names = sorted({clip.group for clip in plain})
    if options.group is not None and options.group not in names:
        raise InputError(unknown_name("group", options.group, names))
    return [clip_version(clip, version) for version in versions for clip in plain]


def measure_clip(
    choices: Sequence[EstimatorChoice], clip: LabelledClip
) -> tuple[list[ClipRun], dict[str, list[float]]]:
    """Run all estimators on a clip. Also return the times of the first by interface, if it is plain."""
    name_work(f"{clip.name}, time of findTransformECC")
    reference = tuple(reference_ms(clip.series))
    runs = [run_clip(clip, choice, reference) for choice in choices]
    plain = clip.version is ClipVersion.PLAIN
    name_work(f"{clip.name}, times of {choices[0].name} by interface")
    return runs, interface_ms(choices[0], clip.background, clip.series) if plain else {}


def make_report(
    options: ClipsOptions, estimators: Sequence[EstimatorRuns], interfaces: Sequence[dict[str, list[float]]]
) -> Report:
    """Return tables, limits, section and page. interfaces: of each clip, times of the first estimator."""
    first, overall, versions = estimators[0], overall_table(estimators), chosen_versions(options.augment)
    by_version = [overall_table(estimators, versions)] if len(versions) > 1 else []
    by_interface, by_clip = interface_table(first, interfaces), clip_table(first)
    limits = judge(first.groups[options.group or ALL], options)
    limits_of = f"'{first.name}', {options.group or 'all clips'}"
    unit = [unit_table(first.runs[0], first.name)] if len(first.runs) == 1 and not options.public_set else []
    shown = [
        *unit,
        *([limit_table(limits, limits_of)] if limits else []),
        *by_version,
        overall,
        *by_interface,
    ]
    labels, clips = plural(first.groups[ALL].labels, "label"), plural(len(first.runs), "clip")
    head = f"{clips}, {labels}, {processor_and_cores()}, one thread. Errors in degrees."
    tables = [by_version[0] if by_version else overall, *by_interface]
    parts = [head, *(table.markdown() for table in tables), verdict(limits)]
    section = "\n\n".join(part for part in parts if part)
    figure, file = time_and_error(estimators)
    name = options.public_set or options.folder.name
    return Report(
        tables=(by_clip, overall, *by_version, *by_interface, *unit),
        limits=limits,
        limits_of=limits_of,
        section=section,
        figures={"estimators": {of.name: _estimator_json(of) for of in estimators}},
        files={
            "index.html": page(name, estimators, verdict(limits), [*shown, by_clip], figure),
            "table.md": section + "\n",
            "time_and_error.svg": file,
            **({"my_unit.md": unit[0].markdown() + "\n"} if unit else {}),
        },
        notes=[readme_row(find_set(options.public_set), first)] if options.public_set else (),
        faults={of.name: faults for of in estimators if (faults := of.faults)},
    )


def unit_table(run: ClipRun, estimator: str) -> Table:
    """Return the figures of one sensor, to send to another person: a name and a value per row."""
    found, errors = run.score, np.array([label.error_deg for label in run.answers.labels])
    low, high = mean_interval(errors)
    ends = "" if low is None or high is None else f" [{max(low, 0.0):.2f}, {high:.2f}]"
    rest = noise_at_rest_deg(run.estimate.angles)
    return Table(
        "My unit",
        ("my unit", run.clip.sensor or "-"),
        [
            ("clip", run.clip.name),
            ("rig", version_text()),
            ("estimator", estimator),
            ("labels beside the reference", str(found.labels)),
            (
                "largest labelled angle, degrees",
                f"{max(abs(of.label.angle_deg) for of in run.answers.labels):.1f}",
            ),
            ("mean error, degrees", f"{found.mean_deg:.2f}{ends}"),
            ("labels within 3 degrees", str(found.within_3)),
            ("useful (sigma at most 5 degrees)", NONE if found.useful is None else str(found.useful)),
            ("within 2 sigma", NONE if found.two_sigma is None else str(found.two_sigma)),
            ("noise at rest (quietest second), degrees", NONE if rest is None else f"{rest:.2f}"),
        ],
        left=2,
    )


def noise_at_rest_deg(angles: Angles) -> float | None:
    """Return the smallest standard deviation of the angle in any second without a refused frame.

    None without such a second.
    """
    ends = np.searchsorted(angles.time_s, angles.time_s + 1.0)
    seconds = [angles.angle_deg[i:end] for i, end in enumerate(ends) if end < len(angles.time_s)]
    return min((float(of.std()) for of in seconds if of.size > 1 and np.isfinite(of).all()), default=None)


def clip_table(first: EstimatorRuns) -> Table:
    rows = [
        [Cell("clip", of.clip.name, "clip"), Cell("group", of.clip.group, "group"), Cell("score", of.score)]
        for of in sorted(first.runs, key=lambda run: -run.score.mean_deg)
    ]
    return table_of(f"'{first.name}' by clip, worst first", rows, left=2)


def judge(of: ClipScore, options: ClipsOptions) -> tuple[Measured, ...]:
    rows = (
        ("within", at_least, "share of labels within max(3 degrees, 2 label sigmas)", of.within),
        ("confidently_wrong", at_most, "share of labels confidently wrong", of.confidently_wrong),
        ("two_sigma", at_least, "share of answers within two sigma", of.two_sigma),
        ("false_rest", at_most, "share of turned labels reported as at rest", of.false_rest),
        ("mean_deg", at_most, "mean error up to 30 degrees", of.mean_small_deg),
        ("p99_ms", at_most, "time per frame with contact, 99 %, ms", of.p99_ms),
        ("empty", at_most, "share of empty frames reported as contact", of.empty_as_contact),
        ("held", at_least, "share of held frames reported as contact", of.held_as_contact),
    )
    asked = dict(PROJECT) if options.limits else {}
    asked |= {name: given for name, *_ in rows if (given := getattr(options, name)) is not None}
    return tuple(compare(text, value, asked[name]) for name, compare, text, value in rows if name in asked)


def verdict(limits: Sequence[Measured]) -> str:
    missed = [f"{limit.name} {limit.shown}, required {limit.asked}" for limit in limits if not limit.met]
    return f"Limits missed: {'; '.join(missed)}." if missed else "All limits were kept." * bool(limits)


def overall_table(estimators: Sequence[EstimatorRuns], versions: Sequence[ClipVersion] = ()) -> Table:
    """Return a row per estimator, group and version; each name only in its first row.

    All clips come first; a single group has no separate row. Without versions there is no column for them.
    """
    rows = []
    for of in estimators:
        found = {ALL: of} | {str(version): of.of_version(version) for version in versions}
        for group in list(of.groups) if len(of.groups) > 2 else [ALL]:
            for version, runs in found.items():
                row = [
                    Cell("estimator", of.name if group == version == ALL else "", "estimator"),
                    Cell("clips", group if version == ALL else "", "clips", doc="group, or all"),
                    Cell("version", version, "version", doc="version of the clips, or all"),
                    Cell("score", runs.groups[group]),
                ]
                rows.append(row if versions else [*row[:2], row[3]])
    by = " by version of the clips" if versions else ""
    return table_of(
        f"Hand-measured angles{by}, errors in degrees; {processor_and_cores()}, one thread",
        rows,
        left=3 if versions else 2,
    )


def interface_table(first: EstimatorRuns, of_clips: Sequence[Mapping[str, Sequence[float]]]) -> list[Table]:
    """Return a table of the times of the first estimator by interface; none without frames with contact.

    of_clips: of `interface_ms`.
    """
    spent = {name: [ms for of in of_clips for ms in of.get(name, ())] for name in (ALONE, PYTHON, LIVE)}
    times = {name: ms for name, of in spent.items() if (ms := frame_ms(of)) is not None}
    reference = [ms for run in first.runs for ms in run.answers.reference_ms]
    rows = [
        [
            Cell("interface", name, f"{first.name}, through"),
            Cell("ms", ms, FRAME_MS, ".2f"),
            Cell("times_alone", (ms[0] / times[ALONE][0], ms[2] / times[ALONE][2]), TIMES_ALONE, ".2f"),
            Cell("times_reference", times_reference(spent[name], reference), TIMES_REFERENCE, ".2f"),
        ]
        for name, ms in times.items()
        if ALONE in times
    ]
    return (
        [table_of(f"Time per frame with contact; {processor_and_cores()}, one thread", rows)] if rows else []
    )


def readme_row(of: PublicSet, runs: EstimatorRuns) -> str:
    """Return a set's row of the README in Markdown: labels within 3 degrees, over all clips and by group."""
    groups = [
        f"{name} clips ({found.labels} labels): {found.within_3}"
        for name, found in runs.groups.items()
        if name != ALL and len(runs.groups) > 2
    ]
    whole = f"within 3 degrees: {runs.groups[ALL].within_3} of {runs.groups[ALL].labels} labels"
    clips = plural(len({run.clip.name for run in runs.runs}), "clip")
    return f"| {of.data} | {'; '.join([f'{whole} on {clips}', *groups])} |"


def _estimator_json(of: EstimatorRuns) -> dict[str, Any]:
    def of_clip(run: ClipRun) -> dict[str, Any]:
        labels = [
            {
                "frame": of.label.frame,
                "label_deg": of.label.angle_deg,
                "label_sigma_deg": of.label.sigma_deg,
                "angle_deg": of.angle_deg,
                "sigma_deg": of.sigma_deg,
                "error_deg": of.error_deg,
            }
            for of in run.answers.labels
        ]
        zero = run.estimate.zero_note
        return {"group": run.clip.group, "zero": zero, **asdict(run.score), "by_label": labels}

    groups = {name: asdict(found) for name, found in of.groups.items()}
    versions = [each for each in ClipVersion if any(run.clip.version is each for run in of.runs)]
    return {
        "all": groups.pop(ALL),
        "groups": groups,
        "versions": {version: asdict(of.of_version(version).groups[ALL]) for version in versions},
        "clips": {run.clip.name: of_clip(run) for run in of.runs},
    }


def page(
    title: str,
    estimators: Sequence[EstimatorRuns],
    verdict: str,
    tables: Sequence[Table],
    time_and_error: str,
) -> str:
    """Return the page of the results. time_and_error: the figure of that name."""
    names, clips = [of.name for of in estimators], []
    for runs in sorted(
        zip(*(of.runs for of in estimators), strict=True), key=lambda of: -of[0].score.mean_deg
    ):
        first, found = runs[0], runs[0].score
        with drawing(CHART_PX[1], CHART_PX[0]) as figure:
            draw_clip(figure, names, runs)
            chart = svg(figure, f"{first.clip.name}: angles over frames, with the labels")
        caption = f"{names[0]}: mean error {found.mean_deg:.1f} degrees, {found.within} within limits, "
        caption += f"0 degrees is {first.estimate.zero_note}"
        clip = {"name": first.clip.name, "group": first.clip.group, "figure": chart, "caption": caption}
        clips.append({**clip, "stills": _stills(first)})
    simulated = [run.clip.series.simulated for run in estimators[0].runs]
    shown = {
        "folder": title,
        "simulated": "" if not any(simulated) else "SIMULATED" if all(simulated) else "SIMULATED in part",
        "of": machine(),
        "verdict": verdict,
        "tables": tables,
        "clips": clips,
        "time_and_error": time_and_error,
    }
    return render("rig.benchmark.clips", "clips.html", **shown)


def time_and_error(estimators: Sequence[EstimatorRuns]) -> tuple[str, str]:
    """Draw the mean error of each estimator over its time per frame with contact.

    Estimators without an angle at any label are left out. Return the figure for a page, and as a file of its
    own.
    """
    with drawing(CHART_PX[1], CHART_PX[0]) as figure:
        axes = figure.add_subplot()
        for number, each in enumerate(estimators):
            of, (colour, place) = each.groups[ALL], _look(number)
            if of.answered is not None and of.answered.count and (ms := of.frame_ms) is not None:
                axes.plot([ms[0], ms[-1]], [of.mean_deg, of.mean_deg], color=colour)
                axes.plot(ms[0], of.mean_deg, _MARKERS[place], color=colour, markersize=5, label=each.name)
        axes.set_xscale("log")
        axes.set(xlabel="time per frame with contact, ms: median to 99 %", ylabel="mean error, degrees")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.minorticks_off()
        axes.margins(0.08, 0.15)
        axes.set_ylim(bottom=0.0)
        legend_above(axes, 4)
        text = "mean error of each estimator over its time per frame"
        return svg(figure, text), column_files(figure)["svg"].decode()


def _look(number: int) -> tuple[str, int]:
    """Return the colour of an estimator, the same in all figures, and the place of its style."""
    colours = (ESTIMATE, *SERIES)
    again, place = divmod(number, len(colours))
    return colours[place].light, again % len(_STYLES)


def draw_clip(figure: Figure, names: Sequence[str], runs: Sequence[ClipRun]) -> Axes:
    """Draw the labels and the first estimator's angle with two sigma, and the angles of the others thinner.

    All labels and angles are inside the axes. Only the band of a large sigma is clipped, so that it does not
    compress the curves.
    """
    axes = figure.add_subplot()
    first = runs[0]
    labelled = [judged.label for judged in first.answers.labels]
    frames = np.array([label.frame for label in labelled])
    angles = np.array([label.angle_deg for label in labelled])
    errors = SIGMAS * np.array([label.sigma_deg for label in labelled])
    shown = np.arange(
        max(first.clip.reference_frame - _BEFORE, 0),
        min(max(frames) + _AFTER + 1, len(first.estimate.samples)),
    )
    curves = [run.estimate.angles.angle_deg[shown] for run in runs]
    axes.set_xlim(shown[0] - 0.5, shown[-1] + 0.5)
    axes.set_ylim(limits(*curves, angles - errors, angles + errors, room=_ROOM, least=_LEAST_ROOM_DEG))
    if first.answers.has_sigma:
        spread = SIGMAS * np.nan_to_num(first.estimate.angles.sigma_deg[shown])
        band(axes, shown, curves[0], spread, ESTIMATE.light)
    for number, (name, curve) in enumerate(zip(names, curves, strict=True)):
        colour, place = _look(number)
        axes.plot(shown, curve, _STYLES[place], color=colour, linewidth=0.9 if number else 1.8, label=name)
    axes.errorbar(frames, angles, errors, fmt="o", color=TRUTH.light, markersize=4, label="measured by hand")
    axes.set(xlabel="frame", ylabel="angle, degrees")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    legend_above(axes, 4)
    return axes


def _stills(run: ClipRun) -> list[Still]:
    captions = {run.clip.reference_frame: "reference"}
    for judged in run.answers.labels:
        sigma = "" if judged.sigma_deg is None else f" ± {judged.sigma_deg:.1f}"
        answer = "refused" if judged.angle_deg is None else f"{judged.angle_deg:+.1f}{sigma}"
        label = f"{judged.label.angle_deg:+.1f} ± {judged.label.sigma_deg:.1f} measured"
        captions[judged.label.frame] = f"{label}, {answer} answered"
    found = []
    for number, frame in enumerate(run.clip.series):
        if number in captions and frame.image is not None:
            size = STILL_WIDTH_PX, round(frame.image.shape[0] * STILL_WIDTH_PX / frame.image.shape[1])
            small = np.asarray(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA), np.uint8)
            found.append(still(small, f"frame {number}: {captions[number]}"))
    return found


def section(options: ClipsOptions) -> str:
    return f"clips {options.public_set}" if options.public_set else "clips"


STUDY = Study("clips", ClipsOptions, measure, "clips", ("out", "readme"), section, simulated=False)
