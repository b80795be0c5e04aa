"""`rig benchmark clips`: compare estimators on labelled clips.

The set `octopi` (24 real clips of a GelSight Mini) is divided by object into two halves that were about
equally difficult for an earlier estimator. Constants are fitted on the group `development`; designs of the
estimator were also chosen by their figures on the group `validation`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drivers.errors import InputError, counted, unknown_name
from rig.benchmark.clips.labelled import ClipVersion, chosen_versions, clip_version, read_clips
from rig.benchmark.clips.public import SETS, PublicSet, find_set, make_clips
from rig.benchmark.clips.scores import ClipRun, ClipScore, EstimatorRuns, run_clip, summed
from rig.benchmark.harness import (
    ALL,
    Report,
    Run,
    Study,
    Table,
    column,
    columns_of,
    limit_table,
    machine,
    table_of,
)
from rig.benchmark.measured import Measured, at_least, at_most
from rig.declared import argument, option
from rig.pages.figure import band, drawing, legend_above, limits, svg
from rig.pages.page import render
from rig.pages.palette import ESTIMATE, SERIES, TRUTH
from rig.report.strips import Still, still
from rig.tactile.estimators import choose_estimator

ESTIMATORS = ("slip", "ecc", "ellipse", "pca", "anglenet")  # estimators that are compared by default
PROJECT = {"within": 0.5, "confidently_wrong": 0.04, "two_sigma": 0.88}
"""Limits of this project for its own clips, by option."""
SIGMAS = 2.0
CHART_PX = (440, 260)
STILL_WIDTH_PX = 160
_ROOM, _LEAST_ROOM_DEG = 0.06, 1.0
_STYLES = ("-", "--", ":", "-.")  # line styles: estimators that share a colour differ in style
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
class GroupRow:
    """One estimator on the clips of one group, a row of the first table."""

    estimator: str = column("estimator")
    clips: str = column("clips", doc="group, or all")
    score: ClipScore = columns_of(ClipScore)


@dataclass(frozen=True, slots=True)
class VersionRow:
    """One estimator on the clips of one group in one or all versions, a row of the table by version."""

    estimator: str = column("estimator")
    clips: str = column("clips", doc="group, or all")
    version: str = column("version", doc="version of the clips, or all")
    score: ClipScore = columns_of(ClipScore)


@dataclass(frozen=True, slots=True)
class ClipRow:
    """One clip, a row of the second table."""

    clip: str = column("clip")
    group: str = column("group")
    score: ClipScore = columns_of(ClipScore)


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
    one clip are not). Below five labels the numbers are printed instead. Times are over frames with contact.

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
    versions = chosen_versions(options.augment)
    sign = -1 if options.reversed_turns else 1
    folder = options.folder
    if options.public_set is not None:
        known = find_set(options.public_set)
        folder = make_clips(known, options.folder)
        run.say(
            f"clips of {known.name} at {known.commit[:8]}: {folder}; licence of the frames: {known.licence}"
        )
    plain = read_clips(folder, options.groups, sign, options.topic)
    clips = [clip_version(clip, version) for version in versions for clip in plain]
    names = sorted({clip.group for clip in clips})
    if options.group is not None and options.group not in names:
        raise InputError(unknown_name("group", options.group, names))
    # One worker, because the time per frame is measured.
    runs = run.each(
        lambda clip: [run_clip(clip, choice) for choice in choices], clips, attrgetter("name"), workers=1
    )
    estimators = [
        summed(choice.name, of) for choice, of in zip(choices, zip(*runs, strict=True), strict=True)
    ]
    limits = judge(estimators[0].groups[options.group or ALL], options)
    first, overall = estimators[0], overall_table(estimators)
    worst = sorted(first.runs, key=lambda run: -run.score.mean_deg)
    rows = [ClipRow(run.clip.name, run.clip.group, run.score) for run in worst]
    by_clip = table_of(f"'{first.name}' by clip, worst first", ClipRow, rows, left=2)
    limits_of = f"'{first.name}', {options.group or 'all clips'}"
    by_version = [version_table(estimators, versions)] if len(versions) > 1 else []
    shown = [*([limit_table(limits, limits_of)] if limits else []), *by_version, overall, by_clip]
    section = _section(first, by_version[0] if by_version else overall, limits)
    return Report(
        tables=(by_clip, overall, *by_version),
        limits=limits,
        limits_of=limits_of,
        section=section,
        figures={"estimators": {of.name: _estimator_json(of) for of in estimators}},
        files={
            "index.html": page(options.public_set or options.folder.name, estimators, verdict(limits), shown),
            "table.md": section + "\n",
        },
        notes=[readme_row(find_set(options.public_set), first)] if options.public_set else (),
        faults={of.name: faults for of in estimators if (faults := of.faults)},
    )


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
    kept = "All limits were kept." if limits else ""
    return f"Limits missed: {'; '.join(missed)}." if missed else kept


def overall_table(estimators: Sequence[EstimatorRuns]) -> Table:
    """Return a row per estimator and group, all clips first; a single group has no separate row."""
    rows = [
        GroupRow(of.name if group == ALL else "", group, of.groups[group])
        for of in estimators
        for group in _groups(of)
    ]
    return table_of("Hand-measured angles, errors in degrees", GroupRow, rows, left=2)


def _groups(of: EstimatorRuns) -> list[str]:
    return list(of.groups) if len(of.groups) > 2 else [ALL]


def version_table(estimators: Sequence[EstimatorRuns], versions: Sequence[ClipVersion]) -> Table:
    """Return a row per estimator, group and version; estimator and group only in their first row."""
    rows = []
    for of in estimators:
        for group in _groups(of):
            whole = (of.name if group == ALL else "", group, ALL)
            rows.append(VersionRow(*whole, of.groups[group]))
            rows += [VersionRow("", "", name, of.of_version(name).groups[group]) for name in versions]
    title = "Hand-measured angles by version of the clips, errors in degrees"
    return table_of(title, VersionRow, rows, left=3)


def readme_row(of: PublicSet, runs: EstimatorRuns) -> str:
    """Return a set's row of the README in Markdown: labels within 3 degrees, over all clips and by group."""
    groups = [
        f"{name} clips ({found.labels} labels): {found.within_3}"
        for name, found in runs.groups.items()
        if name != ALL and len(runs.groups) > 2
    ]
    whole = f"within 3 degrees: {runs.groups[ALL].within_3} of {runs.groups[ALL].labels} labels"
    clips = counted(len({run.clip.name for run in runs.runs}), "clip")
    return f"| {of.data} | {'; '.join([f'{whole} on {clips}', *groups])} |"


def _section(first: EstimatorRuns, table: Table, limits: Sequence[Measured]) -> str:
    labels, of = first.groups[ALL].labels, machine()
    head = (
        f"{counted(len(first.runs), 'clip')}, {counted(labels, 'label')}, {of['processor']}, "
        f"{of['cores']} cores, one thread. Errors in degrees."
    )
    return "\n".join([head, "", table.markdown(), "", verdict(limits)]).rstrip()


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
            for of in run.labels
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


def page(title: str, estimators: Sequence[EstimatorRuns], verdict: str, tables: Sequence[Table]) -> str:
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
    shown = {"folder": title, "of": machine(), "verdict": verdict, "tables": tables, "clips": clips}
    return render("rig.benchmark.clips", "clips.html", **shown)


def draw_clip(figure: Figure, names: Sequence[str], runs: Sequence[ClipRun]) -> Axes:
    """Draw the labels and the first estimator's angle with two sigma, and the angles of the others thinner.

    All labels and angles are inside the axes. Only the band of a large sigma is clipped, so that it does not
    compress the curves.
    """
    axes = figure.add_subplot()
    first = runs[0]
    labelled = [judged.label for judged in first.labels]
    frames = np.array([label.frame for label in labelled])
    angles = np.array([label.angle_deg for label in labelled])
    errors = SIGMAS * np.array([label.sigma_deg for label in labelled])
    shown = np.arange(
        max(first.clip.reference_frame - _BEFORE, 0),
        min(max(frames) + _AFTER + 1, len(first.estimate.angles_deg)),
    )
    curves = [np.array(run.estimate.angles_deg, float)[shown] for run in runs]
    axes.set_xlim(shown[0] - 0.5, shown[-1] + 0.5)
    axes.set_ylim(limits(*curves, angles - errors, angles + errors, room=_ROOM, least=_LEAST_ROOM_DEG))
    if first.has_sigma:
        spread = SIGMAS * np.nan_to_num(np.array(first.estimate.sigmas_deg, float)[shown])
        band(axes, shown, curves[0], spread, ESTIMATE.light)
    colours = (ESTIMATE, *SERIES)
    for number, (name, curve) in enumerate(zip(names, curves, strict=True)):
        again, place = divmod(number, len(colours))
        colour, style = colours[place].light, _STYLES[again % len(_STYLES)]
        axes.plot(shown, curve, style, color=colour, linewidth=0.9 if number else 1.8, label=name)
    axes.errorbar(frames, angles, errors, fmt="o", color=TRUTH.light, markersize=4, label="measured by hand")
    axes.set(xlabel="frame", ylabel="angle, degrees")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    legend_above(axes, 4)
    return axes


def _stills(run: ClipRun) -> list[Still]:
    captions = {run.clip.reference_frame: "reference"}
    for judged in run.labels:
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


STUDY = Study(
    name="clips",
    options=ClipsOptions,
    measure=measure,
    cases="clips",
    shared=("out", "readme"),
    section=lambda options: f"clips {options.public_set}" if options.public_set else "clips",
    simulated=False,
)
