"""`rig benchmark clips`: compare estimators on labelled clips.

The set `octopi` (24 real clips of a GelSight Mini) is divided by object into two halves that were about
equally difficult for an earlier estimator. Constants are fitted on the group `development`; designs of the
estimator were also chosen by their figures on the group `validation`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from typing import Any

import cv2

from drivers.errors import InputError, counted, unknown_name
from rig.benchmark.clips.augmented import augmented, chosen_versions
from rig.benchmark.clips.labelled import ClipVersion, read_clips
from rig.benchmark.clips.options import ESTIMATORS, PROJECT, ClipsOptions
from rig.benchmark.clips.page import page
from rig.benchmark.clips.public import PublicSet, find_set, make_clips
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
    table_of,
)
from rig.benchmark.measured import Measured, at_least, at_most
from rig.tactile.estimators import choose_estimator


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
    clips = augmented(read_clips(folder, options.groups, sign, options.topic), versions)
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
        ("p99_ms", at_most, "time per frame with contact, 99 %, ms", of.p99_ms),
        ("empty", at_most, "share of empty frames reported as contact", of.empty_as_contact),
        ("held", at_least, "share of held frames reported as contact", of.held_as_contact),
    )
    asked = dict(PROJECT) if options.limits else {}
    asked |= {name: given for name, *_ in rows if (given := getattr(options, name)) is not None}
    return tuple(compare(text, value, asked[name]) for name, compare, text, value in rows if name in asked)


def verdict(limits: Sequence[Measured]) -> str:
    """Return a sentence with the missed limits; "" without limits."""
    missed = [f"{limit.name} {limit.shown}, required {limit.asked}" for limit in limits if not limit.met]
    kept = "All limits were kept." if limits else ""
    return f"Limits missed: {'; '.join(missed)}." if missed else kept


def overall_table(estimators: Sequence[EstimatorRuns]) -> Table:
    """Return a row per estimator and group, all clips first; a single group has no separate row."""
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
            "index.html": page(
                options.public_set or options.folder.name,
                by_name,
                verdict(limits),
                [*shown, overall, by_clip],
            ),
            "table.md": section + "\n",
        },
        notes=[readme_row(find_set(options.public_set), first)] if options.public_set else (),
        faults={of.name: faults for of in estimators if (faults := of.faults)},
    )


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
    section=lambda options: f"clips {options.public_set}" if options.public_set else "clips",
    simulated=False,
)
