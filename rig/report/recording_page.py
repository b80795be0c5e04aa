"""The report of a recording."""

from collections.abc import Sequence
from datetime import UTC, datetime

import cv2
import numpy as np

from drivers.errors import InputError
from drivers.images import encode_jpeg
from drivers.types import Image
from protocols.grasps import find_grasp_file
from rig.pages.page import render
from rig.report.calibrations import calibration_notices, calibration_table
from rig.report.header import header
from rig.report.parts import Notice, Table, joined
from rig.report.recording import Recording, Taken
from rig.report.recording_charts import (
    axes_deg,
    axis_histogram,
    empty_orientations,
    place_map,
    untouched_cells,
)
from rig.report.strips import JPEG_QUALITY
from rig.report.text import made_text

THUMB_PX = (72, 96)
ACROSS, GAP_PX = 8, 3
_BETWEEN = 120
"""Grey between the images, between a white page and a black one."""
FEWEST_FOR_AXES = 20
"""Fewer contacts with an axis than this leave gaps by chance."""


def recording_page(recording: Recording, now: datetime | None = None) -> str:
    """Return the report of a recording as one HTML page."""
    now = now or datetime.now(UTC)
    by_serial = _by_serial(recording)
    maps = [place_map(serial, taken) for serial, taken in by_serial.items()]
    return render(
        "rig.report",
        "recording.html",
        recording=recording,
        manifest=recording.manifest,
        head=header(recording.manifest, f"Recording of {_object_names(recording)}"),
        tiles=_tiles(recording),
        warnings=_notices(recording, by_serial, now),
        poses=_pose_table(recording),
        charts=[*maps, axis_histogram(by_serial)] if by_serial else [],
        sheets=_sheets(recording),
        calibrations=calibration_table(recording.manifest, now),
        made=made_text(now),
    )


def _object_names(recording: Recording) -> str:
    return ", ".join(f"{i} {_name(i)}".strip() for i in recording.manifest.objects)


def _name(object_id: str) -> str:
    try:
        return find_grasp_file(object_id).name
    except InputError:
        return ""


def _by_serial(recording: Recording) -> dict[str, list[Taken]]:
    found: dict[str, list[Taken]] = {}
    for image in recording.taken:
        found.setdefault(image.about.serial, []).append(image)
    return dict(sorted(found.items()))


def _tiles(recording: Recording) -> list[tuple[str, str]]:
    rows, manifest = recording.rows, recording.manifest
    accepted = sum(row.accepted for row in rows)
    areas = [image.about.contact_area_px for image in recording.taken]
    tiles = [
        (f"{accepted} of {manifest.poses}", "poses accepted"),
        (str(sum(len(row.images) for row in rows)), f"images of {manifest.images}"),
        (str(sum(row.rejected_frames for row in rows)), "frames rejected: no contact"),
        (str(len(rows) - accepted), "attempts failed"),
    ]
    if areas:
        tiles.append((f"{np.median(areas):.0f} px", "median contact area"))
    return tiles


def _pose_table(recording: Recording) -> Table:
    rows = [
        [
            f"{row.pose}" + (f", attempt {row.attempt + 1}" if row.attempt else ""),
            row.position,
            f"{row.orientation_deg:+.0f}",
            str(len(row.images)),
            str(row.rejected_frames),
            "accepted" if row.accepted else str(row.fault),
        ]
        for row in recording.rows
    ]
    columns = ("pose", "position", "orientation, °", "images", "rejected: no contact", "outcome")
    return Table(columns, rows, text=(0, 1, 5))


def _notices(recording: Recording, by_serial: dict[str, list[Taken]], now: datetime) -> list[Notice]:
    found = [*recording.problems]
    if recording.manifest.status != "complete":
        advice = f"Go on with the same command and --resume --out {recording.folder}."
        done = sum(row.accepted for row in recording.rows)
        found.append(Notice("bad", f"Unfinished: {done} of {recording.manifest.poses} poses.", advice))
    for serial, taken in by_serial.items():
        found += _gaps(serial, taken)
    found += calibration_notices(recording.manifest, now)
    return found or [Notice("good", "Nothing stands out.", "Every part of both sensors was touched.")]


def _gaps(serial: str, taken: Sequence[Taken]) -> list[Notice]:
    found = []
    if cells := untouched_cells(taken):
        advice = "A network trained on this knows no contacts there: grasp further out, or at other heights."
        found.append(Notice("warn", f"{serial} was never touched {joined(cells)}.", advice))
    if len(axes_deg(taken)) >= FEWEST_FOR_AXES and (gaps := empty_orientations(taken)):
        names = joined([f"{low:+.0f} to {high:+.0f}" for low, high in gaps])
        advice = "Turn the hand or the object further, or record another object at these orientations."
        found.append(Notice("warn", f"{serial} saw no long axis at {names} degrees.", advice))
    return found


def _sheets(recording: Recording) -> list[dict[str, object]]:
    """A contact sheet per pose: its images small, the contact's outline drawn in."""
    poses: dict[int, list[Taken]] = {}
    for image in recording.taken:
        poses.setdefault(image.row.pose, []).append(image)
    return [
        {
            "title": f"Pose {pose}: {taken[0].row.position} at {taken[0].row.orientation_deg:+.0f}°",
            "caption": f"{len(taken)} images, grips of {_grips(taken)} counts",
            "jpeg": encode_jpeg(_montage(taken), JPEG_QUALITY),
        }
        for pose, taken in sorted(poses.items())
    ]


def _grips(taken: Sequence[Taken]) -> str:
    counts = [image.about.grip_counts for image in taken]
    return f"{min(counts)} to {max(counts)}"


def _montage(taken: Sequence[Taken]) -> Image:
    """Put the images side by side, each fingertip's on rows of its own."""
    by_serial: dict[str, list[Image]] = {}
    for image in taken:
        by_serial.setdefault(image.about.serial, []).append(_thumb(image))
    rows = [
        thumbs[start : start + ACROSS]
        for _, thumbs in sorted(by_serial.items())
        for start in range(0, len(thumbs), ACROSS)
    ]
    width, height = (side + GAP_PX for side in THUMB_PX)
    sheet = np.full((len(rows) * height, ACROSS * width, 3), _BETWEEN, np.uint8)
    for y, thumbs in enumerate(rows):
        for x, thumb in enumerate(thumbs):
            top, left = y * height, x * width
            sheet[top : top + THUMB_PX[1], left : left + THUMB_PX[0]] = thumb
    return sheet


def _thumb(image: Taken) -> Image:
    picture = image.image.copy()
    if image.contact.mask is not None:
        outline = np.rint(image.contact.contour).astype(np.int32)
        cv2.polylines(picture, [outline], True, (255, 255, 255), 3, cv2.LINE_AA)
    return np.asarray(cv2.resize(picture, THUMB_PX, interpolation=cv2.INTER_AREA), np.uint8)
