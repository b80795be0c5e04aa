"""The report of a recording: positions and orientations of the contacts, and the images."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from drivers.errors import InputError, plural
from drivers.images import encode_jpeg, load_image
from drivers.types import Image
from protocols.grasps import find_grasp_file, grasp_poses
from rig.pages.figure import drawing, legend_above
from rig.pages.page import render
from rig.pages.palette import FIRST, INK, SECOND
from rig.report.advice import calibration_notices, calibration_table
from rig.report.parts import Chart, Notice, Table, header, join_items, made_text, table_of
from rig.report.session import read_usable
from rig.report.strips import JPEG_QUALITY
from rig.sessions.files import RESULTS, reference_file
from rig.sessions.manifest import RecordManifest
from rig.sessions.records import POSES, PoseImage, PoseRow
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.paper.axis import ellipse_axis

ROUND = 1.15
"""Elongation below which a contact has no meaningful long axis."""
FEWEST_FOR_AXES = 20
"""With fewer contacts with an axis than this, gaps are due to chance."""
BIN_DEG = 15.0
_EDGES_DEG = np.arange(-90.0, 90.0 + BIN_DEG, BIN_DEG)
_ROWS, _COLUMNS = ("top", "upper", "lower", "bottom"), ("left", "middle", "right")
"""Cells of a sensor; each cell should have been touched."""
_TICK_PX = 16.0
THUMB_PX = (72, 96)
ACROSS, GAP_PX, LABEL_PX = 8, 3, 15
_BETWEEN = 120
"""Grey level between the images, for light and dark pages."""


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """One image of a recording. contact: from the classical finder. axis_deg: None if round or no contact."""

    row: PoseRow
    about: PoseImage
    image: Image
    contact: Contact
    axis_deg: float | None

    @property
    def center_px(self) -> NDArray[np.float64] | None:
        """Centre of the contact, (2,) px, x right and y down; None without contact."""
        if self.contact.mask is None:
            return None
        moments = cv2.moments(self.contact.mask, binaryImage=True)
        return np.array([moments["m10"], moments["m01"]]) / moments["m00"]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording as far as it can be read. rows: all attempts at poses, in order."""

    folder: Path
    manifest: RecordManifest
    rows: list[PoseRow]
    taken: list[Taken]
    problems: list[Notice]

    @property
    def accepted(self) -> int:
        return sum(row.accepted for row in self.rows)


def read_recording(folder: Path, manifest: RecordManifest) -> Recording:
    """Read the images of a recording; missing or damaged ones are left out and reported."""
    rows, problems = read_usable(folder / RESULTS["record"], POSES)
    rows.sort(key=lambda row: (row.pose, row.attempt))
    serials = sorted({about.serial for row in rows for about in row.images})
    references = {serial: load_image(folder / reference_file(serial)) for serial in serials}
    if without := [serial for serial, reference in references.items() if reference is None]:
        what = f"The reference image of {join_items(without)} cannot be read."
        advice = "Contacts cannot be detected there: copy the session's reference folder again."
        problems.append(Notice("bad", what, advice))
    taken, missing = [], []
    for row in rows:
        for about in row.images:
            image, reference = load_image(folder / about.file), references.get(about.serial)
            if image is None:
                missing.append(about.file)
            elif reference is not None and reference.shape == image.shape:
                # a finder per image: it has hysteresis between frames, and these images are not a series
                contact = ContactFinder(reference).find(image)
                axis = ellipse_axis(contact.contour) if contact.mask is not None else None
                angle = axis.angle_deg if axis is not None and axis.elongation >= ROUND else None
                taken.append(Taken(row, about, image, contact, angle))
    if missing:
        what = f"{plural(len(missing), 'image')} cannot be read: {join_items(missing)}."
        problems.append(Notice("bad", what, "They are missing below: copy them again from the rig's disk."))
    return Recording(folder, manifest, rows, taken, problems)


def recording_page(recording: Recording, now: datetime | None = None) -> str:
    now, manifest = now or datetime.now(UTC), recording.manifest
    by_serial = _by_serial(recording.taken)
    gaps = [gap for serial, taken in by_serial.items() for gap in _gaps(serial, taken)]
    object_id = manifest.objects[0] if manifest.objects else ""
    poses = None
    with suppress(InputError):  # the object is not known here
        poses = len(grasp_poses(find_grasp_file(object_id, manifest.config.objects)))
    whole = poses is not None and recording.accepted >= poses
    maps = [place_map(serial, taken) for serial, taken in by_serial.items()]
    names = ", ".join(f"{i} {_name(i, manifest)}".strip() for i in manifest.objects)
    return render(
        "rig.report",
        "recording.html",
        recording=recording,
        manifest=manifest,
        head=header(manifest, f"Recording of {names}"),
        tiles=_tiles(recording),
        warnings=_notices(recording, gaps, poses, whole, now),
        gaps=gaps if whole else [],
        poses=_pose_table(recording.rows),
        charts=[*maps, axis_histogram(by_serial)] if by_serial else [],
        sheets=_sheets(recording.taken),
        calibrations=calibration_table(manifest, now),
        made=made_text(now),
    )


def _name(object_id: str, manifest: RecordManifest) -> str:
    try:
        return find_grasp_file(object_id, manifest.config.objects).name
    except InputError:
        return ""


def _by_serial(taken: Iterable[Taken]) -> dict[str, list[Taken]]:
    found: dict[str, list[Taken]] = {}
    for image in taken:
        found.setdefault(image.about.serial, []).append(image)
    return dict(sorted(found.items()))


def _tiles(recording: Recording) -> list[tuple[str, str]]:
    rows, manifest = recording.rows, recording.manifest
    areas = [image.about.contact_area_px for image in recording.taken]
    tiles = [
        (f"{recording.accepted} of {manifest.poses}", "poses accepted"),
        (str(sum(len(row.images) for row in rows)), f"images of {manifest.images}"),
        (str(sum(row.rejected_frames for row in rows)), "frames rejected: no contact"),
        (str(len(rows) - recording.accepted), "attempts failed"),
    ]
    return [*tiles, *([(f"{np.median(areas):.0f} px", "median contact area")] if areas else [])]


def _pose_table(rows: Sequence[PoseRow]) -> Table:
    return table_of(
        rows,
        {
            "pose": lambda row: f"{row.pose}" + (f", attempt {row.attempt + 1}" if row.attempt else ""),
            "position": lambda row: row.position,
            "orientation, °": lambda row: f"{row.orientation_deg:+.0f}",
            "images": lambda row: str(len(row.images)),
            "rejected: no contact": lambda row: str(row.rejected_frames),
            "outcome": lambda row: "accepted" if row.accepted else str(row.fault),
        },
        text=(0, 1, 5),
    )


def _notices(
    recording: Recording, gaps: Sequence[str], poses: int | None, whole: bool, now: datetime
) -> list[Notice]:
    """Return the notices. poses: in the object's file. whole: whether all of them were recorded.

    If so, the remaining gaps are gaps of the file.
    """
    found, manifest = [*recording.problems], recording.manifest
    if manifest.status != "complete":
        advice = f"Continue with rig record --resume --out {recording.folder}."
        what = f"Unfinished: {recording.accepted} of {plural(manifest.poses, 'pose')}."
        found.append(Notice("bad", what, advice))
    if not whole:
        advice = (
            f"Take more of the poses in the object's file{f': --poses {poses} takes all' if poses else ''}."
        )
        found += [Notice("warn", f"{gap}.", advice) for gap in gaps]
    found += calibration_notices(manifest, now)
    touched = "Every part of both sensors was touched, at every orientation."
    if gaps:
        touched = (
            "All poses of the object's file were recorded; the charts show the parts that they do not reach."
        )
    return found or [Notice("good", "Nothing stands out.", touched)]


def _gaps(serial: str, taken: Sequence[Taken]) -> list[str]:
    """Return the cells and orientations without contact on a sensor, in words."""
    found, touched = [], share_touched(taken)
    cells = [
        f"{_ROWS[y]} {_COLUMNS[x]}"
        for y, rows in enumerate(np.array_split(touched, len(_ROWS), axis=0))
        for x, cell in enumerate(np.array_split(rows, len(_COLUMNS), axis=1))
        if cell.max() == 0.0
    ]
    if cells:
        found.append(f"{serial} was never touched {join_items(cells)}")
    if len(axes_deg(taken)) >= FEWEST_FOR_AXES and (empty := empty_orientations(taken)):
        names = join_items([f"{low:+.0f} to {high:+.0f}" for low, high in empty])
        found.append(f"{serial} has no contact with a long axis at {names} degrees")
    return found


def place_map(serial: str, taken: Sequence[Taken]) -> Chart:
    """Draw the fraction of the images in which each pixel of a sensor was touched, and the contacts' axes."""
    height, width = taken[0].image.shape[:2]
    with drawing(370, 330) as figure:
        axes = figure.subplots()
        shown = axes.imshow(
            share_touched(taken) * 100.0, extent=(0, width, height, 0), cmap="cividis", vmin=0, vmax=100,
            interpolation="nearest",
        )  # fmt: skip
        figure.colorbar(shown, ax=axes, label="touched in, % of the images", shrink=0.8)
        for image in taken:
            _mark(axes, image)
        axes.set(xlabel="x, px", ylabel="y, px", xlim=(0, width), ylim=(height, 0))
        axes.grid(False)
        caption = "Dots: centres of the contacts; strokes: their long axes; round ones have none."
        return Chart(f"Positions of the contacts on {serial}", figure, caption)


def _mark(axes: Axes, image: Taken) -> None:
    center = image.center_px
    if center is None:
        return
    halo = [Stroke(linewidth=2.6, foreground="#fefefe"), Normal()]
    axes.plot(*center, ".", color="black", markersize=3.0, path_effects=halo)
    if image.axis_deg is not None:
        turn = math.radians(image.axis_deg)
        x, y = _TICK_PX * math.cos(turn), -_TICK_PX * math.sin(turn)
        across, down = [center[0] - x, center[0] + x], [center[1] - y, center[1] + y]
        axes.plot(across, down, color="black", linewidth=0.8, path_effects=halo)


def axis_histogram(by_serial: dict[str, list[Taken]]) -> Chart:
    """Draw a histogram of the orientations of the contacts' long axes, per sensor."""
    with drawing(260) as figure:
        axes = figure.subplots()
        for i, (serial, taken) in enumerate(by_serial.items()):
            counts, _ = np.histogram(axes_deg(taken), _EDGES_DEG)
            share = BIN_DEG / (len(by_serial) + 0.5)
            axes.bar(
                _EDGES_DEG[:-1] + share * (i + 0.75), counts, share, label=serial,
                color=(FIRST, SECOND)[i % 2].light, hatch=("", "///")[i % 2], edgecolor=INK.light,
                linewidth=0.6,
            )  # fmt: skip
        axes.set_xticks(np.arange(-90, 91, 30))
        axes.set(xlabel="long axis in the image, degrees", ylabel="images")
        axes.grid(False, axis="x")
        legend_above(axes, 2)
        caption = (
            "Counter-clockwise from the image's x; -90 and 90 are the same axis. Without round contacts."
        )
        return Chart("Orientations of the contacts", figure, caption)


def share_touched(taken: Sequence[Taken]) -> NDArray[np.float64]:
    """Return the fraction of the images in which each pixel was touched, (H, W), 0 to 1."""
    masks = [t.contact.mask > 0 for t in taken if t.contact.mask is not None]
    return np.mean(masks, axis=0) if masks else np.zeros(taken[0].image.shape[:2])


def axes_deg(taken: Sequence[Taken]) -> NDArray[np.float64]:
    """Return the known long axes, (N,) deg in (-90, 90]."""
    return np.array([t.axis_deg for t in taken if t.axis_deg is not None], float)


def empty_orientations(taken: Sequence[Taken]) -> list[tuple[float, float]]:
    """Return ranges of orientation, deg from and to, without any contact's axis."""
    counts, _ = np.histogram(axes_deg(taken), _EDGES_DEG)
    gaps: list[tuple[float, float]] = []
    for low in _EDGES_DEG[:-1][counts == 0].tolist():
        begins = gaps.pop()[0] if gaps and gaps[-1][1] == low else low
        gaps.append((begins, low + BIN_DEG))
    return gaps


def _sheets(images: Sequence[Taken]) -> list[dict[str, object]]:
    """Return a contact sheet per pose: small images with the contact's outline."""
    poses: dict[int, list[Taken]] = {}
    for image in images:
        poses.setdefault(image.row.pose, []).append(image)
    sheets: list[dict[str, object]] = []
    for pose, taken in sorted(poses.items()):
        grips = [image.about.grip_counts for image in taken if image.about.grip_counts is not None]
        how = f"grips of {min(grips)} to {max(grips)} steps past contact" if grips else "pressed by hand"
        title = f"Pose {pose}: {taken[0].row.position} at {taken[0].row.orientation_deg:+.0f}°"
        caption = f"{plural(len(taken), 'image')} of {join_items(list(_by_serial(taken)))}, {how}"
        sheets.append({"title": title, "caption": caption, "jpeg": encode_jpeg(montage(taken), JPEG_QUALITY)})
    return sheets


def montage(taken: Sequence[Taken]) -> Image:
    """Arrange the images: a row per sensor below its name, each image above its grip."""
    bands = []
    for serial, own in _by_serial(taken).items():
        bands.append(_draw_text(serial, ACROSS * (THUMB_PX[0] + GAP_PX)))
        bands += [_row(own[start : start + ACROSS]) for start in range(0, len(own), ACROSS)]
    return np.concatenate(bands)


def _row(taken: Sequence[Taken]) -> Image:
    width, height = THUMB_PX[0] + GAP_PX, THUMB_PX[1]
    row = np.full((height + LABEL_PX, ACROSS * width, 3), _BETWEEN, np.uint8)
    for left, image in zip(range(0, row.shape[1], width), taken, strict=False):
        picture, grip = image.image.copy(), image.about.grip_counts
        if image.contact.mask is not None:
            outline = np.rint(image.contact.contour).astype(np.int32)
            cv2.polylines(picture, [outline], True, (255, 255, 255), 3, cv2.LINE_AA)
        small = cv2.resize(picture, THUMB_PX, interpolation=cv2.INTER_AREA)
        row[:height, left : left + THUMB_PX[0]] = small
        text = "by hand" if grip is None else plural(grip, "step")
        row[height:, left : left + width] = _draw_text(text, width)
    return row


def _draw_text(text: str, width: int) -> Image:
    """Draw a line of text, (LABEL_PX, width, 3) uint8."""
    band, place, font = np.full((LABEL_PX, width, 3), _BETWEEN, np.uint8), (2, LABEL_PX - 4), 0.38
    cv2.putText(band, text, place, cv2.FONT_HERSHEY_SIMPLEX, font, (255, 255, 255), 1, cv2.LINE_AA)
    return band
