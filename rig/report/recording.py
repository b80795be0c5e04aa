"""Read a recording for a report: its images and their contacts."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import counted
from drivers.images import load_image
from drivers.types import Image
from rig.report.parts import Notice, joined
from rig.report.session import read_usable
from rig.sessions.files import RESULTS, reference_file
from rig.sessions.manifest import RecordManifest
from rig.sessions.records import POSES, PoseImage, PoseRow
from rig.tactile.contact.finder import Contact, ContactFinder
from rig.tactile.paper.axis import ellipse_axis

ROUND = 1.15
"""Elongation below which a contact has no meaningful long axis."""


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


def read_recording(folder: Path, manifest: RecordManifest) -> Recording:
    """Read the images of a recording; missing or damaged ones are left out and reported."""
    rows, problems = read_usable(folder / RESULTS["record"], POSES)
    rows.sort(key=lambda row: (row.pose, row.attempt))
    references = {s: load_image(folder / reference_file(s)) for s in _serials(rows)}
    without = [serial for serial, reference in references.items() if reference is None]
    if without:
        what = f"The reference image of {joined(without)} cannot be read."
        advice = "Contacts cannot be detected there: copy the session's reference folder again."
        problems.append(Notice("bad", what, advice))
    taken, missing = [], []
    for row in rows:
        for about in row.images:
            image = load_image(folder / about.file)
            reference = references.get(about.serial)
            if image is None:
                missing.append(about.file)
            elif reference is not None and reference.shape == image.shape:
                taken.append(_taken(row, about, image, reference))
    if missing:
        what = f"{counted(len(missing), 'image')} cannot be read: {joined(missing)}."
        problems.append(Notice("bad", what, "They are missing below: copy them again from the rig's disk."))
    return Recording(folder, manifest, rows, taken, problems)


def _taken(row: PoseRow, about: PoseImage, image: Image, reference: Image) -> Taken:
    # one finder per image, because a finder has hysteresis between frames, and these images are not a series
    contact = ContactFinder(reference).find(image)
    axis = ellipse_axis(contact.contour) if contact.mask is not None else None
    elongated = axis is not None and axis.elongation >= ROUND
    return Taken(row, about, image, contact, axis.angle_deg if axis is not None and elongated else None)


def _serials(rows: list[PoseRow]) -> list[str]:
    return sorted({about.serial for row in rows for about in row.images})
