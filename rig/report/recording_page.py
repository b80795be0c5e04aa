"""The report of a recording."""

from collections.abc import Sequence
from datetime import UTC, datetime

import cv2
import numpy as np

from drivers.errors import InputError, counted
from drivers.images import encode_jpeg
from drivers.types import Image
from protocols.grasps import find_grasp_file, grasp_poses
from rig.pages.page import render
from rig.report.calibrations import calibration_notices, calibration_table
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
from rig.report.text import header, made_text
from rig.sessions.manifest import RecordManifest

THUMB_PX = (72, 96)
ACROSS, GAP_PX, LABEL_PX = 8, 3, 15
_BETWEEN = 120
"""Grey level between the images, for light and dark pages."""
FEWEST_FOR_AXES = 20
"""With fewer contacts with an axis than this, gaps are due to chance."""


def recording_page(recording: Recording, now: datetime | None = None) -> str:
    """Return the report of a recording as one HTML page."""
    now = now or datetime.now(UTC)
    by_serial = _by_serial(recording)
    gaps = [gap for serial, taken in by_serial.items() for gap in _gaps(serial, taken)]
    maps = [place_map(serial, taken) for serial, taken in by_serial.items()]
    return render(
        "rig.report",
        "recording.html",
        recording=recording,
        manifest=recording.manifest,
        head=header(recording.manifest, f"Recording of {_object_names(recording)}"),
        tiles=_tiles(recording),
        warnings=_notices(recording, gaps, now),
        gaps=gaps if _whole(recording) else [],
        poses=_pose_table(recording),
        charts=[*maps, axis_histogram(by_serial)] if by_serial else [],
        sheets=_sheets(recording),
        calibrations=calibration_table(recording.manifest, now),
        made=made_text(now),
    )


def _object_names(recording: Recording) -> str:
    return ", ".join(f"{i} {_name(i, recording.manifest)}".strip() for i in recording.manifest.objects)


def _name(object_id: str, manifest: RecordManifest) -> str:
    try:
        return find_grasp_file(object_id, manifest.config.objects).name
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


def _notices(recording: Recording, gaps: Sequence[str], now: datetime) -> list[Notice]:
    found = [*recording.problems]
    if recording.manifest.status != "complete":
        advice = f"Continue with rig record --resume --out {recording.folder}."
        done = sum(row.accepted for row in recording.rows)
        found.append(
            Notice("bad", f"Unfinished: {done} of {counted(recording.manifest.poses, 'pose')}.", advice)
        )
    if not _whole(recording):
        there = _all_poses(recording)
        all_of_them = f": --poses {there} takes all" if there else ""
        advice = f"Take more of the poses in the object's file{all_of_them}."
        found += [Notice("warn", f"{gap}.", advice) for gap in gaps]
    found += calibration_notices(recording.manifest, now)
    if found:
        return found
    touched = (
        "All poses of the object's file were recorded; the charts show the parts that they do not reach."
    )
    if not gaps:
        touched = "Every part of both sensors was touched, at every orientation."
    return [Notice("good", "Nothing stands out.", touched)]


def _whole(recording: Recording) -> bool:
    """Whether all poses of the object's file were recorded, so that remaining gaps are gaps of the file."""
    wanted = _all_poses(recording)
    return wanted is not None and sum(row.accepted for row in recording.rows) >= wanted


def _all_poses(recording: Recording) -> int | None:
    """Return the number of poses in the object's file; None if the file is not found."""
    manifest = recording.manifest
    try:
        return len(grasp_poses(find_grasp_file(manifest.objects[0], manifest.config.objects)))
    except (InputError, IndexError):
        return None


def _gaps(serial: str, taken: Sequence[Taken]) -> list[str]:
    """Return the cells and orientations without contact on a sensor, in words."""
    found = []
    if cells := untouched_cells(taken):
        found.append(f"{serial} was never touched {joined(cells)}")
    if len(axes_deg(taken)) >= FEWEST_FOR_AXES and (empty := empty_orientations(taken)):
        names = joined([f"{low:+.0f} to {high:+.0f}" for low, high in empty])
        found.append(f"{serial} has no contact with a long axis at {names} degrees")
    return found


def _sheets(recording: Recording) -> list[dict[str, object]]:
    """Return a contact sheet per pose: small images with the contact's outline."""
    poses: dict[int, list[Taken]] = {}
    for image in recording.taken:
        poses.setdefault(image.row.pose, []).append(image)
    return [
        {
            "title": f"Pose {pose}: {taken[0].row.position} at {taken[0].row.orientation_deg:+.0f}°",
            "caption": f"{counted(len(taken), 'image')} of {_sensors(taken)}, {_grips(taken)}",
            "jpeg": encode_jpeg(montage(taken), JPEG_QUALITY),
        }
        for pose, taken in sorted(poses.items())
    ]


def _sensors(taken: Sequence[Taken]) -> str:
    return joined(sorted({image.about.serial for image in taken}))


def _grips(taken: Sequence[Taken]) -> str:
    counts = [image.about.grip_counts for image in taken if image.about.grip_counts is not None]
    return f"grips of {min(counts)} to {max(counts)} steps past contact" if counts else "pressed by hand"


def montage(taken: Sequence[Taken]) -> Image:
    """Arrange the images: a row per sensor below its name, each image above its grip."""
    by_serial: dict[str, list[Taken]] = {}
    for image in taken:
        by_serial.setdefault(image.about.serial, []).append(image)
    bands = []
    for serial, own in sorted(by_serial.items()):
        bands.append(_written(serial, ACROSS * (THUMB_PX[0] + GAP_PX)))
        bands += [_row(own[start : start + ACROSS]) for start in range(0, len(own), ACROSS)]
    return np.concatenate(bands)


def _row(taken: Sequence[Taken]) -> Image:
    width, height = THUMB_PX[0] + GAP_PX, THUMB_PX[1]
    row = np.full((height + LABEL_PX, ACROSS * width, 3), _BETWEEN, np.uint8)
    for x, image in enumerate(taken):
        left = x * width
        row[:height, left : left + THUMB_PX[0]] = _thumb(image)
        grip = image.about.grip_counts
        row[height:, left : left + width] = _written(
            "by hand" if grip is None else counted(grip, "step"), width
        )
    return row


def _written(text: str, width: int) -> Image:
    """Draw a line of text, (LABEL_PX, width, 3) uint8."""
    band = np.full((LABEL_PX, width, 3), _BETWEEN, np.uint8)
    cv2.putText(
        band, text, (2, LABEL_PX - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 255), 1, cv2.LINE_AA
    )
    return band


def _thumb(image: Taken) -> Image:
    picture = image.image.copy()
    if image.contact.mask is not None:
        outline = np.rint(image.contact.contour).astype(np.int32)
        cv2.polylines(picture, [outline], True, (255, 255, 255), 3, cv2.LINE_AA)
    return np.asarray(cv2.resize(picture, THUMB_PX, interpolation=cv2.INTER_AREA), np.uint8)
