"""Read a session's lines: all of them, or only the readable ones."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from drivers.errors import SessionError
from drivers.images import image_flaw
from rig.sessions.codec import Codec
from rig.sessions.files import RESULTS, TIMING, complete_lines
from rig.sessions.recording_file import check_recording
from rig.sessions.records import LIFT_TIMINGS, LIFTS, POSES, Lift, LiftTiming, PoseRow, accepted_lifts

Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class UsableLifts:
    """The readable attempts at a trial's lifts, and the problems of the others."""

    rows: tuple[Lift, ...]
    problems: tuple[str, ...]

    @property
    def lifts(self) -> list[Lift]:
        return accepted_lifts(self.rows)


def read_rows(path: Path, codec: Codec[Record]) -> list[Record]:
    """Read a file of lines; an incomplete last line is ignored, a missing file is empty.

    Raises `SessionError` naming line and key if another line is damaged.
    """
    rows, problems = rows_and_problems(path, codec)
    if problems:
        raise SessionError(problems[0])
    return rows


def rows_and_problems(path: Path, codec: Codec[Record]) -> tuple[list[Record], list[str]]:
    """Return the readable records of a file of lines, and the problem of each other line with its remedy."""
    rows, damaged = readable_rows(path, codec)
    remedy = "move the session aside or remove that line"
    return rows, [f"{path}: line {number} is damaged: {why}; {remedy}" for number, why in damaged.items()]


def readable_rows(path: Path, codec: Codec[Record]) -> tuple[list[Record], dict[int, str]]:
    """Return the readable records of a file of lines, and the errors of the other lines by number, from 1.

    Raises `SessionError` if the file cannot be read.
    """
    rows: list[Record] = []
    damaged: dict[int, str] = {}
    for number, text in enumerate(complete_lines(path), start=1):
        try:
            rows.append(codec.parse(text))
        except ValueError as error:
            damaged[number] = str(error)
    return rows, damaged


def read_lifts(folder: Path) -> list[Lift]:
    """Read all attempts at a trial's lifts. Raises `SessionError`."""
    return read_rows(folder / RESULTS["trial"], LIFTS)


def read_timing(folder: Path) -> list[LiftTiming]:
    """Return the readable rows of a trial's `timing.jsonl`; none if it is missing."""
    return readable_rows(folder / TIMING, LIFT_TIMINGS)[0]


def read_finished_lifts(folder: Path) -> list[Lift]:
    """Read the accepted lifts of a trial. Raises `SessionError`, also if there is none."""
    usable = read_usable_lifts(folder)
    if usable.problems:
        raise SessionError(usable.problems[0])
    return usable.lifts


def read_usable_lifts(folder: Path, checked: bool = False) -> UsableLifts:
    """Return the readable lifts of a trial, and the problems of the others.

    checked: verify the checksums of each recording, and leave out the lifts of damaged ones. Raises
    `SessionError` if no accepted lift is left.
    """
    rows, problems = rows_and_problems(folder / RESULTS["trial"], LIFTS)
    for row in accepted_lifts(rows) if checked else ():
        try:
            check_recording(folder / row.recording)
        except SessionError as error:
            rows.remove(row)
            problems.append(str(error))
    if not accepted_lifts(rows):
        nothing = f"{folder}: no finished lift; run the trial with --resume first"
        raise SessionError(problems[0] if problems else nothing)
    return UsableLifts(tuple(rows), tuple(problems))


def read_usable_poses(folder: Path) -> tuple[list[PoseRow], list[str]]:
    """Return the readable poses and images of a recording, and the problems of the others.

    Raises `SessionError` if no image is left.
    """
    (rows, problems), poses = rows_and_problems(folder / RESULTS["record"], POSES), []
    for pose in rows:
        flaws = [image_flaw(folder / image.file) for image in pose.images]
        named = zip(pose.images, flaws, strict=True)
        problems += [f"{folder / image.file}: the image {flaw}" for image, flaw in named if flaw]
        whole = tuple(i for i, flaw in zip(pose.images, flaws, strict=True) if flaw is None)
        poses.append(replace(pose, images=whole))
    if problems and not any(pose.accepted and pose.images for pose in poses):
        raise SessionError(problems[0])
    return poses, problems


def read_poses(folder: Path) -> list[PoseRow]:
    """Read all attempts at a recording's poses. Raises `SessionError`."""
    return read_rows(folder / RESULTS["record"], POSES)
