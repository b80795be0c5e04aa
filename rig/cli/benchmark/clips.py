"""`rig benchmark clips`: estimators against angles measured by hand."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.benchmark.tables import ReadmeOption, print_tables, say_faults
from rig.cli.common import JsonOption, emit_json
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.benchmark.clips.benchmark import ClipsResult


def clips(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder with a folder per clip: frames/ or a video, background.png, labels.csv, "
            "timestamps.csv, contacts.csv. Or trials of TactileTracking, or sequences of "
            "digit-pose-estimation."
        ),
    ],
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            help="Repeat for more; limits are for the first. Default: slip, ecc, polar, ellipse, pca, "
            "anglenet. Your own: package.module:Class.",
        ),
    ] = None,
    groups: Annotated[
        Path | None,
        typer.Option(
            "--groups",
            help="CSV with columns clip,group. Default: groups.csv in the folder, or a column of labels.csv.",
        ),
    ] = None,
    group: Annotated[
        str | None,
        typer.Option("--group", help="The group whose figures limits are for. Default: all clips."),
    ] = None,
    project_limits: Annotated[
        bool,
        typer.Option(
            "--limits",
            help="Apply the project's limits for its own clips: --within 0.5, --confidently-wrong 0.04, "
            "--two-sigma 0.88, --p99-ms 8. Default: only the limits given here.",
        ),
    ] = False,
    within: Annotated[
        float | None,
        typer.Option("--within", help="Lowest share of labels within max(3 degrees, 2 label sigmas)."),
    ] = None,
    confidently_wrong: Annotated[
        float | None,
        typer.Option(
            "--confidently-wrong", help="Highest share of labels more than 10 degrees and 3 sigma off."
        ),
    ] = None,
    two_sigma: Annotated[
        float | None, typer.Option("--two-sigma", help="Lowest share of answers within two sigma.")
    ] = None,
    false_rest: Annotated[
        float | None,
        typer.Option("--false-rest", help="Highest share of turned labels reported as at rest."),
    ] = None,
    mean_deg: Annotated[
        float | None,
        typer.Option("--mean-deg", help="Largest mean error up to 30 degrees of turn."),
    ] = None,
    p99_ms: Annotated[
        float | None, typer.Option("--p99-ms", help="Longest time per frame, 99 %, in ms.")
    ] = None,
    empty: Annotated[
        float | None,
        typer.Option("--empty", help="Highest share of frames without contact reported as contact."),
    ] = None,
    held: Annotated[
        float | None, typer.Option("--held", help="Lowest share of frames in contact reported as contact.")
    ] = None,
    reversed_turns: Annotated[
        bool,
        typer.Option(
            "--reversed-turns",
            help="Take public sets' known turns the other way: digit-pose-estimation does not say which.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Folder for results.json, index.html and table.md.", callback=folder_place
        ),
    ] = None,
    readme: ReadmeOption = None,
    json: JsonOption = False,
) -> None:
    """Let estimators answer labelled clips, real or simulated, and compare with the labels.

    labels.csv has the columns reference_frame, keyframe, angle_deg (counter-clockwise as seen, 0 at the
    reference), sigma_deg; frames count from 0; `rig label-angle` makes one. Every label counts: a
    refused one is not within, and enters the means with the last angle answered. Exit code 4 if the
    first estimator misses a limit that was given.

    A clip's contacts.csv, if there is one, has the columns first, last, contact (yes or no): frames that are
    all in contact or all without contact. It adds two columns: how many of them were reported as contact.

    Examples:
      rig benchmark clips clips/ --out clips_page

      rig benchmark clips TactileTracking/ --estimator slip --out tracking_page

      rig benchmark clips clips/ --estimator slip --groups halves.csv --group "held back" --json

    """
    from dataclasses import replace

    from rig.benchmark.clips.benchmark import ESTIMATORS, as_json, run_clips
    from rig.benchmark.clips.files import write_clips
    from rig.benchmark.clips.limits import NO_LIMITS, PROJECT
    from rig.benchmark.clips.tables import NAME, readme_section
    from rig.benchmark.readme import check_readme, write_section
    from rig.cli.printing import WorkProgress
    from rig.frames.masks import make_folder
    from rig.tactile.estimators import choose_estimator

    choices = [choose_estimator(name) for name in estimator or ESTIMATORS]
    given = {
        "group": group,
        "within": within,
        "confidently_wrong": confidently_wrong,
        "two_sigma": two_sigma,
        "false_rest": false_rest,
        "mean_small_deg": mean_deg,
        "p99_ms": p99_ms,
        "empty_as_contact": empty,
        "held_as_contact": held,
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    limits = replace(PROJECT if project_limits else NO_LIMITS, **chosen)
    if out is not None:
        make_folder(out)
    if readme is not None:
        check_readme(readme, NAME)
    with WorkProgress(0, "clips") as progress:
        result = run_clips(folder, choices, limits, groups, progress.show, -1 if reversed_turns else 1)
    if out is not None:
        write_clips(out, result)
    if readme is not None:
        write_section(readme, NAME, readme_section(result))
    _print(result, json)
    if json:
        emit_json({"out": None if out is None else str(out), **as_json(result)})
    exit_where_missed(result.limits)


def _print(result: "ClipsResult", to_stderr: bool) -> None:
    from rig.benchmark.clips.tables import clip_table, limit_table, overall_table

    tables = [clip_table(result), overall_table(result)]
    if result.limits:
        tables.append(limit_table(result))
    print_tables(tables, to_stderr, result.wall_s)
    say_faults(result.faults)
