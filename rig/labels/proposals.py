"""Label files for manual correction, and exports of the corrected ones."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import FormatError, InputError
from drivers.formats import read_json
from drivers.images import encode_png
from drivers.types import Image
from rig.labels.label_files import LabelledImage, coco_document, labelme_document, labelme_mask
from rig.labels.polygons import mask_polygons
from rig.sessions.files import write_file, write_json

LABEL = "contact"
COCO, MASKS = "coco.json", "masks"


@dataclass(frozen=True, slots=True)
class LabelFile:
    """The label of one image. size: (width, height) in px. proposed: made now; else as found."""

    image: Path
    path: Path
    size: tuple[int, int]
    proposed: bool


def propose(image: Path, mask: Image, path: Path, note: str) -> LabelFile:
    """Write a LabelMe file with the outlines of a mask (H, W); one that is there stays as it is.

    A file that is there may hold a person's corrections. note: how the mask was made.
    """
    size = (mask.shape[1], mask.shape[0])
    if path.exists():
        return LabelFile(image, path, size, False)
    relative = os.path.relpath(image, path.parent)
    write_json(path, labelme_document(relative, size, mask_polygons(mask), LABEL, note))
    return LabelFile(image, path, size, True)


def export_masks(files: Sequence[LabelFile], folder: Path) -> Iterator[Image]:
    """Write each label as PNG, 0 or 255, of its image's name; yield the masks. Raises `InputError`."""
    for file in files:
        mask = labelme_mask(read_label(file.path), (file.size[1], file.size[0]), str(file.path))
        write_file(folder / f"{file.path.stem}.png", encode_png(mask))
        yield mask


def export_coco(files: Sequence[LabelFile], masks: Sequence[Image], path: Path, note: str) -> None:
    """Write all labels as one COCO file; names of images are relative to it."""
    images = [
        LabelledImage(os.path.relpath(file.image, path.parent), file.size, LABEL, mask_polygons(mask))
        for file, mask in zip(files, masks, strict=True)
    ]
    write_json(path, coco_document(images, note))


def read_label(path: Path) -> dict[str, Any]:
    """Read a LabelMe file. Raises `InputError` with its problem."""
    try:
        document = read_json(path)
    except FormatError as error:
        raise InputError(f"{error}: save it again in LabelMe") from error
    if not isinstance(document, dict) or not isinstance(document.get("shapes"), list):
        raise InputError(f"{path}: is no LabelMe file (no 'shapes'): remove it, and label again")
    return document
