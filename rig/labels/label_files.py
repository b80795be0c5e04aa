"""Label files: written for manual correction, and exported after it.

LabelMe: one JSON file beside each image, with the fields of labelme 5 (`labelme/_label_file.py`). Points are
x, y in pixels; `imageData` is empty, as the file names the image. COCO: one JSON file for all images, with
the instance annotations of https://cocodataset.org/#format-data; ids count from 1.
"""

import base64
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.errors import FormatError, InputError
from drivers.formats import MOST_JSON_BYTES, MOST_PIXELS, parse_json, quote, read_text, similar_key
from drivers.images import decode_image, encode_png, require_same_aspect
from drivers.types import Image
from rig.labels.polygons import Polygon, mask_polygons, polygon_area, polygons_mask
from rig.sessions.files import write_file, write_json

FORMAT_VERSION = "5.5.0"
"""The oldest version of LabelMe whose fields are written here."""
LABEL = "contact"
COCO, MASKS = "coco.json", "masks"
_BACKGROUND_LABELS = ("_background_", "background", "__ignore__")
_CIRCLE_CORNERS = 72
_FAR, _MOST_PX = 1.0, 1e6
"""Largest distance of a corner from its image, in image widths or heights; largest coordinate in px."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledImage:
    """An image file, its width and height in px, and the outlines of the contact in it."""

    path: Path
    size: tuple[int, int]
    polygons: Sequence[Polygon]


def outline_contact(path: Path, mask: Image) -> LabelledImage:
    """Return an image file with the outlines of its contact mask (H, W), not 0 inside."""
    return LabelledImage(path, (mask.shape[1], mask.shape[0]), mask_polygons(mask))


def write_labelme(path: Path, image: LabelledImage, note: str) -> None:
    """Write the LabelMe file of an image. note: origin of the outlines, stored with each of them."""
    shapes = [
        {
            "label": LABEL,
            "points": [[round(float(x), 2), round(float(y), 2)] for x, y in polygon],
            "group_id": None,
            "description": note,
            "shape_type": "polygon",
            "flags": {},
            "mask": None,
        }
        for polygon in image.polygons
    ]
    document = {
        "version": FORMAT_VERSION,
        "flags": {},
        "shapes": shapes,
        "imagePath": os.path.relpath(image.path, path.parent),
        "imageData": None,
        "imageHeight": image.size[1],
        "imageWidth": image.size[0],
    }
    write_json(path, document)


def write_coco(path: Path, images: Sequence[LabelledImage], note: str) -> None:
    """Write one COCO file for all images, with their paths relative to it. Its only category is `LABEL`.

    note: content of the images and origin of their outlines.
    """
    contacts = [(i, image) for i, image in enumerate(images, start=1) if image.polygons]
    entries = [
        {"id": i, "file_name": os.path.relpath(image.path, path.parent), "width": image.size[0],
         "height": image.size[1]}
        for i, image in enumerate(images, start=1)
    ]  # fmt: skip
    document = {
        "info": {"description": note, "version": "1.0"},
        "licenses": [],
        "images": entries,
        "annotations": [
            _annotation(number, image_id, image.polygons)
            for number, (image_id, image) in enumerate(contacts, start=1)
        ],
        "categories": [{"id": 1, "name": LABEL, "supercategory": "contact"}] if images else [],
    }
    write_json(path, document)


def _annotation(number: int, image_id: int, polygons: Sequence[Polygon]) -> dict[str, object]:
    corners = np.concatenate(polygons)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    return {
        "id": number,
        "image_id": image_id,
        "category_id": 1,
        "segmentation": [[round(float(v), 2) for v in polygon.reshape(-1)] for polygon in polygons],
        "area": round(sum(polygon_area(polygon) for polygon in polygons), 2),
        "bbox": [round(float(v), 2) for v in (left, top, right - left, bottom - top)],
        "iscrowd": 0,
    }


def labelme_mask(document: dict[str, Any], shape: tuple[int, int], where: str) -> Image:
    """Return the union of a document's shapes as (H, W) uint8, 0 or 255.

    shape: (H, W) of the image. Points are scaled if the labels were drawn at another size. Raises
    `InputError` naming `where` for shapes without area.
    """
    drawn_on = document.get("imageWidth") or shape[1], document.get("imageHeight") or shape[0]
    if not all(isinstance(side, int | float) and side > 0 for side in drawn_on):
        raise InputError(f"{where}: the size of its image is {quote(drawn_on)}: save it again in LabelMe")
    polygons, painted = [], []
    for number, entry in enumerate(document["shapes"], start=1):
        if isinstance(entry, dict) and entry.get("label", "") in _BACKGROUND_LABELS:
            continue
        name = f"{where}, shape {number}"
        if isinstance(entry, dict) and entry.get("shape_type") == "mask":
            painted.append(_paint(entry, (math.ceil(drawn_on[0]), math.ceil(drawn_on[1])), name))
            continue
        share = _corners(entry, name) / np.array(drawn_on)
        if np.abs(share - 0.5).max() > 0.5 + _FAR:
            raise InputError(f"{name}: a point lies far outside its image: draw it again in LabelMe")
        polygons.append(share * np.array([shape[1], shape[0]]))
    require_same_aspect(where, drawn_on, shape)
    mask = polygons_mask(polygons, (shape[1], shape[0]))
    for part in painted:
        mask |= np.asarray(cv2.resize(part, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST), np.uint8)
    return mask


def _paint(entry: dict[str, Any], size: tuple[int, int], where: str) -> Image:
    """Return a shape that is a mask, a PNG of the part between its two points, as (H, W) uint8, 0 or 255."""
    try:
        part = decode_image(base64.b64decode(entry["mask"], validate=True), grey=True)
        (left, top), _ = np.rint(np.asarray(entry["points"], np.float64).reshape(2, 2)).astype(int).tolist()
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: its mask cannot be read: draw it again in LabelMe") from error
    inside = min(left, top) >= 0 and size[0] * size[1] <= MOST_PIXELS
    if part is None or not inside or left + part.shape[1] > size[0] or top + part.shape[0] > size[1]:
        raise InputError(f"{where}: its mask does not lie in its image: draw it again in LabelMe")
    canvas = np.zeros((size[1], size[0]), np.uint8)
    canvas[top : top + part.shape[0], left : left + part.shape[1]] = 255 * (part > 0)
    return canvas


def _corners(entry: Any, where: str) -> Polygon:
    """Return a shape's outline, x and y in px from the image's top left corner."""
    try:
        kind = entry.get("shape_type") or "polygon"
        points = np.asarray(entry["points"], np.float64).reshape(-1, 2)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{where}: its points cannot be read: draw it again in LabelMe") from error
    if not np.abs(points).max(initial=0.0) <= _MOST_PX:
        raise InputError(f"{where}: a point is not in its image: draw it again in LabelMe")
    if kind == "rectangle" and len(points) == 2:
        (x0, y0), (x1, y1) = points
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    if kind == "circle" and len(points) == 2:
        radius = math.dist(points[0], points[1])
        turn = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_CORNERS, endpoint=False)
        return points[0] + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    if (kind == "polygon" and len(points) >= 3) or (kind == "rectangle" and len(points) == 4):
        return points
    raise InputError(
        f"{where}: a {quote(kind)} of {len(points)} points encloses nothing: draw a polygon in LabelMe"
    )


@dataclass(frozen=True, slots=True)
class LabelFile:
    """The label file of one image. size: (width, height) in px. proposed: whether it was written just now."""

    image: Path
    path: Path
    size: tuple[int, int]
    proposed: bool


def propose(image: Path, mask: Image, path: Path, note: str) -> LabelFile:
    """Write a LabelMe file with the outlines of a mask (H, W), unless the file exists.

    An existing file is left unchanged, because it may hold manual corrections. note: origin of the mask.
    """
    proposed = not path.exists()
    if proposed:
        write_labelme(path, outline_contact(image, mask), note)
    return LabelFile(image, path, (mask.shape[1], mask.shape[0]), proposed)


def export_masks(files: Sequence[LabelFile], folder: Path) -> Iterator[Image]:
    """Write each label as a PNG (0 or 255) named like its image; yield the masks. Raises `InputError`."""
    for file in files:
        mask = labelme_mask(read_label(file.path), (file.size[1], file.size[0]), str(file.path))
        write_file(folder / f"{file.path.stem}.png", encode_png(mask))
        yield mask


def read_label(path: Path) -> dict[str, Any]:
    """Read a LabelMe file. Raises `InputError` with its problem."""
    try:
        text = read_text(path, MOST_JSON_BYTES)
        document = parse_json(text.encode(), str(path))
    except FormatError as error:
        raise InputError(f"{error}: save it again in LabelMe") from error
    if not isinstance(document, dict) or not isinstance(document.get("shapes"), list):
        no = f"no 'shapes'{similar_key(text, 'shapes')}"
        raise InputError(f"{path}: is not a LabelMe file: {no}: correct it, or remove it and label again")
    for number, shape in enumerate(document["shapes"], start=1):
        if isinstance(shape, dict) and "points" not in shape:
            no = f"no 'points'{similar_key(text, 'points')}"
            raise InputError(f"{path}, shape {number}: {no}: correct it, or draw it again in LabelMe")
    return document
