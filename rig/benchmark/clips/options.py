"""Options of `rig benchmark clips`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from rig.benchmark.clips.public import SETS
from rig.benchmark.harness import option

ESTIMATORS = ("slip", "ecc", "ellipse", "pca", "anglenet")
"""Estimators that are compared by default."""
PROJECT = {"within": 0.5, "confidently_wrong": 0.04, "two_sigma": 0.88}
"""Limits of this project for its own clips, by option."""


@dataclass(frozen=True, slots=True)
class ClipsOptions:
    """Options of `rig benchmark clips`. A limit of None is not checked."""

    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder with a folder per clip: frames/, a video or a ROS bag, background.png, labels.csv, "
            "timestamps.csv, contacts.csv. Or trials of TactileTracking. "
            "With --set: a clone of the set's repository."
        ),
    ]
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
    reversed_turns: bool = option(
        False,
        "Negate the known angles of public sets.",
        "--reversed-turns",
    )
