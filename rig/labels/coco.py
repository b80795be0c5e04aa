"""COCO's instance annotations: one JSON file for all images.

Fields as https://cocodataset.org/#format-data lists them; ids count from 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.labels.polygons import Polygon, polygon_area


@dataclass(frozen=True, slots=True, eq=False)
class LabelledImage:
    """An image, width and height in px, and the outlines of one object's contact in it."""

    file_name: str
    size: tuple[int, int]
    category: str
    polygons: Sequence[Polygon]


def coco_document(images: Sequence[LabelledImage], description: str) -> dict[str, object]:
    """Return the JSON value for a set of images; categories are numbered in the order of their names.

    description: what the images are and where their outlines come from.
    """
    numbers = {name: i for i, name in enumerate(sorted({image.category for image in images}), start=1)}
    contacts = [(i, image) for i, image in enumerate(images, start=1) if image.polygons]
    return {
        "info": {"description": description, "version": "1.0"},
        "licenses": [],
        "images": [
            {"id": i, "file_name": image.file_name, "width": image.size[0], "height": image.size[1]}
            for i, image in enumerate(images, start=1)
        ],
        "annotations": [
            _annotation(number, image_id, numbers[image.category], image.polygons)
            for number, (image_id, image) in enumerate(contacts, start=1)
        ],
        "categories": [
            {"id": number, "name": name, "supercategory": "contact"} for name, number in numbers.items()
        ],
    }


def _annotation(number: int, image_id: int, category: int, polygons: Sequence[Polygon]) -> dict[str, object]:
    corners = np.concatenate(polygons)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    return {
        "id": number,
        "image_id": image_id,
        "category_id": category,
        "segmentation": [[round(float(v), 2) for v in polygon.reshape(-1)] for polygon in polygons],
        "area": round(sum(polygon_area(polygon) for polygon in polygons), 2),
        "bbox": [round(float(v), 2) for v in (left, top, right - left, bottom - top)],
        "iscrowd": 0,
    }
