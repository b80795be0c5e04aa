"""`rig benchmark clips`: compare estimators on labelled clips.

`rotation_clip_halves.csv` divides 24 real clips of a GelSight Mini by object into two halves that were about
equally difficult for an earlier estimator. Constants are fitted on the half `development` only.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer

from drivers.errors import InputError, counted, unknown_name
from rig.benchmark.clips.augmented import augmented, chosen_versions
from rig.benchmark.clips.labelled import ClipVersion, read_clips
from rig.benchmark.clips.page import page
from rig.benchmark.clips.runs import ALL, ClipRun, EstimatorRuns, run_clip, summed
from rig.benchmark.clips.scores import ClipScore
from rig.benchmark.harness import (
    Report,
    Run,
    Study,
    Table,
    column,
    columns_of,
    limit_table,
    machine,
    option,
    table_of,
)
from rig.benchmark.measured import Measured, at_least, at_most
from rig.tactile.estimators import choose_estimator

ESTIMATORS = ("slip", "ecc", "polar", "ellipse", "pca", "anglenet")
"""Estimators that are compared by default."""
PROJECT = {"within": 0.5, "confidently_wrong": 0.04, "two_sigma": 0.88, "p99_ms": 8.0}
"""Limits of this project for its own clips, by option."""


@dataclass(frozen=True, slots=True)
class ClipsOptions:
    """Options of `rig benchmark clips`. A limit of None is not checked."""

    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder with a folder per clip: frames/, a video or a ROS bag, background.png, labels.csv, "
            "timestamps.csv, contacts.csv. Or trials of TactileTracking, or sequences of "
            "digit-pose-estimation."
        ),
    ]
    estimator: list[str] | None = option(
        None,
        "Estimator, also your own as package.module:Class; repeat for more. Limits apply to the "
        "first. Default: slip, ecc, polar, ellipse, pca, anglenet.",
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
        "Apply this project's limits for its own clips: --within 0.5, --confidently-wrong 0.04, "
        "--two-sigma 0.88, --p99-ms 8.",
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
    p99_ms: float | None = option(None, "Limit: longest time per frame (99th percentile), ms.")
    empty: float | None = option(
        None, "Limit: highest fraction of frames without contact reported as contact."
    )
    held: float | None = option(None, "Limit: lowest fraction of frames in contact reported as contact.")
    augment: str | None = option(
        None,
        "Also score these versions of each clip, separated by commas: mirror (left-right), flip "
        "(top-bottom), reverse (in time, from the last labelled frame). Limits apply to all versions.",
    )
    reversed_turns: bool = option(
        False,
        "Negate the known angles of public sets (digit-pose-estimation does not document the sign).",
        "--reversed-turns",
    )


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

    Examples:
      rig benchmark clips clips/ --out clips_page

      rig benchmark clips TactileTracking/ --estimator slip --out tracking_page

      rig benchmark clips clips/ --estimator slip --groups halves.csv --group "held back" --json

      rig benchmark clips clips/ --estimator slip --augment mirror,flip,reverse

    """
    cv2.setNumThreads(1)
    choices = [choose_estimator(name) for name in options.estimator or ESTIMATORS]
    versions = chosen_versions(options.augment)
    sign = -1 if options.reversed_turns else 1
    clips = augmented(read_clips(options.folder, options.groups, sign, options.topic), versions)
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
    return _report(options, estimators, limits)


def judge(of: ClipScore, options: ClipsOptions) -> tuple[Measured, ...]:
    """Return the requested limits with the measured values."""
    rows = (
        ("within", at_least, "share of labels within max(3 degrees, 2 label sigmas)", of.within),
        ("confidently_wrong", at_most, "share of labels confidently wrong", of.confidently_wrong),
        ("two_sigma", at_least, "share of answers within two sigma", of.two_sigma),
        ("false_rest", at_most, "share of turned labels reported as at rest", of.false_rest),
        ("mean_deg", at_most, "mean error up to 30 degrees", of.mean_small_deg),
        ("p99_ms", at_most, "time per frame, 99 %, ms", of.p99_ms),
        ("empty", at_most, "share of empty frames reported as contact", of.empty_as_contact),
        ("held", at_least, "share of held frames reported as contact", of.held_as_contact),
    )
    asked = dict(PROJECT) if options.limits else {}
    asked |= {name: given for name, *_ in rows if (given := getattr(options, name)) is not None}
    return tuple(compare(text, value, asked[name]) for name, compare, text, value in rows if name in asked)


def verdict(limits: Sequence[Measured]) -> str:
    """Return a sentence with the missed limits; "" without limits."""
    missed = [
        f"{limit.name} {'-' if limit.value is None else f'{limit.value:.3g}'}, required {limit.asked}"
        for limit in limits
        if not limit.met
    ]
    kept = "All limits were kept." if limits else ""
    return f"Limits missed: {'; '.join(missed)}." if missed else kept


def overall_table(estimators: Sequence[EstimatorRuns]) -> Table:
    """Return a row per estimator and group, all clips first; a single group has no row of its own."""
    rows = [
        GroupRow(of.name if group == ALL else "", group, found)
        for of in estimators
        for group, found in of.groups.items()
        if group == ALL or len(of.groups) > 2
    ]
    return table_of("Hand-measured angles, errors in degrees", GroupRow, rows, left=2)


def version_table(estimators: Sequence[EstimatorRuns], versions: Sequence[ClipVersion]) -> Table:
    """Return a row per estimator, group and version; the rows for all groups and all versions come first."""
    rows = [
        VersionRow(*_first_only(of.name, group, version), found)
        for of in estimators
        for group in of.groups
        if group == ALL or len(of.groups) > 2
        for version, found in _by_version(of, group, versions)
    ]
    return table_of(
        "Hand-measured angles by version of the clips, errors in degrees", VersionRow, rows, left=3
    )


def _by_version(
    of: EstimatorRuns, group: str, versions: Sequence[ClipVersion]
) -> list[tuple[str, ClipScore]]:
    """Return the figures of a group in all versions together, then in each version."""
    return [(ALL, of.groups[group]), *((name, of.of_version(name).groups[group]) for name in versions)]


def _first_only(name: str, group: str, version: str) -> tuple[str, str, str]:
    """Return the first cells of a row; estimator and group are shown only in their first row."""
    return name if group == version == ALL else "", group if version == ALL else "", version


def _report(
    options: ClipsOptions, estimators: Sequence[EstimatorRuns], limits: tuple[Measured, ...]
) -> Report:
    first, overall = estimators[0], overall_table(estimators)
    worst = sorted(first.runs, key=lambda run: -run.score.mean_deg)
    rows = [ClipRow(run.clip.name, run.clip.group, run.score) for run in worst]
    by_clip = table_of(f"'{first.name}' by clip, worst first", ClipRow, rows, left=2)
    limits_of = f"'{first.name}', {options.group or 'all clips'}"
    shown = [limit_table(limits, limits_of)] if limits else []
    by_name = {of.name: of.runs for of in estimators}
    versions = tuple(dict.fromkeys(run.clip.version for run in first.runs))
    by_version = [version_table(estimators, versions)] if len(versions) > 1 else []
    section = _section(first, by_version[0] if by_version else overall, limits)
    shown += by_version
    return Report(
        tables=(by_clip, overall, *by_version),
        limits=limits,
        limits_of=limits_of,
        section=section,
        figures={"estimators": {of.name: _estimator_json(of) for of in estimators}},
        files={
            "index.html": page(options.folder.name, by_name, verdict(limits), [*shown, overall, by_clip]),
            "table.md": section + "\n",
        },
        faults={of.name: faults for of in estimators if (faults := of.faults)},
    )


def _section(first: EstimatorRuns, table: Table, limits: Sequence[Measured]) -> str:
    labels, of = first.groups[ALL].labels, machine()
    head = (
        f"{counted(len(first.runs), 'clip')}, {counted(labels, 'label')}, {of['processor']}, "
        f"{of['cores']} cores, one thread. Errors in degrees."
    )
    return "\n".join([head, "", table.markdown(), "", verdict(limits)]).rstrip()


def _estimator_json(of: EstimatorRuns) -> dict[str, Any]:
    groups = {name: asdict(found) for name, found in of.groups.items()}
    return {
        "all": groups.pop(ALL),
        "groups": groups,
        "versions": {
            version: asdict(of.of_version(version).groups[ALL])
            for version in ClipVersion
            if any(run.clip.version is version for run in of.runs)
        },
        "clips": {run.clip.name: _clip_json(run) for run in of.runs},
    }


def _clip_json(run: ClipRun) -> dict[str, Any]:
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


STUDY = Study(
    name="clips",
    options=ClipsOptions,
    measure=measure,
    cases="clips",
    shared=("out", "readme"),
    simulated=False,
)
