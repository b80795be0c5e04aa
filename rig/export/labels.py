"""Export contact masks as COCO or LabelMe files, with copies of the images."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import SessionError, plural
from drivers.images import image_flaw, load_image
from drivers.types import Image
from protocols.observer import Phase
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.labels.label_files import COCO, outline_contact, write_coco, write_labelme
from rig.sessions.files import reference_file, true_mask_file
from rig.sessions.reading import phase_times, recorded_frames
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder

TRUE_NOTE = "mask: the simulator's true contact"
FOUND_NOTE = (
    "mask: proposed by image processing (rig/tactile/contact/finder.py); check it before you train on it"
)


@dataclass(frozen=True, slots=True, eq=False)
class ContactImage:
    """An image with its contact mask, (H, W) uint8, 0 or 255.

    name: path in the export. encoded: the stored bytes of the image. note: origin of the mask.
    """

    name: str
    encoded: bytes
    mask: Image
    note: str


def contact_images(request: ExportRequest) -> Iterator[ContactImage]:
    """Yield the images of a recording, or every Nth frame with contact of a trial's fingertips.

    Raises `SessionError` if an image or a recording is missing or damaged.
    """
    return _of_recording(request) if request.poses else _of_trial(request)


def _of_recording(request: ExportRequest) -> Iterator[ContactImage]:
    serials = {image.serial for pose in request.accepted_poses for image in pose.images}
    finders = {s: ContactFinder(_read(request.session / reference_file(s))) for s in serials}
    for pose in request.accepted_poses:
        for image in pose.images:
            path = request.session / image.file
            picture, note = _read(path), TRUE_NOTE
            truth = request.session / true_mask_file(path.stem)
            if not truth.exists():
                mask, note = _find(finders[image.serial], picture), FOUND_NOTE
            elif (mask := load_image(truth, grey=True)) is None or mask.shape != picture.shape[:2]:
                raise SessionError(
                    f"{truth}: the true mask cannot be read, or its size differs from the image's"
                )
            yield ContactImage(image.file, path.read_bytes(), mask, note)


def _of_trial(request: ExportRequest) -> Iterator[ContactImage]:
    for row in request.finished_lifts:
        recording = request.session / row.recording
        grasp_ns = phase_times(recording)[Phase.GRASP]
        for serial in request.manifest.signs:
            frames = list(recorded_frames(recording, serial))
            finder = ContactFinder(mean_background([f.image for f in frames if f.time_ns < grasp_ns]))
            folder = f"{row.object}_{row.name.replace(' ', '_')}"
            for frame in [f for f in frames if f.time_ns >= grasp_ns][:: request.every]:
                mask = _find(finder, frame.image)
                if mask.any() and frame.jpeg is not None:
                    name = f"{folder}/{recording.stem}_{serial}_{frame.sequence:06d}.jpg"
                    yield ContactImage(name, frame.jpeg, mask, FOUND_NOTE)


def _find(finder: ContactFinder, image: Image) -> Image:
    """Return the contact mask of a frame, all 0 without contact."""
    mask = finder.find(image).mask
    return np.zeros(image.shape[:2], np.uint8) if mask is None else mask


def _read(path: Path) -> Image:
    image = load_image(path)
    if image is None:
        raise SessionError(f"{path}: {image_flaw(path) or 'cannot be decoded'}; the session is damaged")
    return image


def export_coco(request: ExportRequest) -> Exported:
    """Write the images and `COCO`. Raises `SessionError` for a damaged session."""
    notes = Counter[str]()
    labelled = [outline_contact(path, image.mask) for image, path in _write_images(request, notes)]
    origins = _describe(request, notes)
    note = f"{request.session.name}, rig {request.manifest.tool_version}; {'; '.join(origins)}"
    write_coco(request.out / COCO, labelled, note)
    annotated = sum(bool(image.polygons) for image in labelled)
    return Exported({"images": len(labelled), "annotations": annotated}, origins)


def export_labelme(request: ExportRequest) -> Exported:
    """Write the images with a LabelMe file for each. Raises `SessionError` for a damaged session."""
    notes = Counter[str]()
    for image, path in _write_images(request, notes):
        write_labelme(path.with_suffix(".json"), outline_contact(path, image.mask), image.note)
    return Exported({"images": notes.total()}, _describe(request, notes))


def _write_images(request: ExportRequest, notes: "Counter[str]") -> Iterator[tuple[ContactImage, Path]]:
    """Write the images; yield each with its file, and count their notes."""
    for image in contact_images(request):
        path = request.out / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(image.encoded)
        notes[image.note] += 1
        yield image, path


def _describe(request: ExportRequest, notes: "Counter[str]") -> tuple[str, ...]:
    """Return the number of images for each origin of their masks."""
    mark = simulated_mark(request.manifest)
    return tuple(f"{mark}{plural(count, 'image')}, {note}" for note, count in sorted(notes.items()))
