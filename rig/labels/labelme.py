"""LabelMe's annotation files: one JSON file beside each image.

Fields as LabelMe writes and reads them (labelme 5, `labelme/_label_file.py`): points are x, y in
pixels, `imageData` is empty where the image lies beside the file.
"""

from collections.abc import Sequence

from rig.labels.polygons import Polygon

FORMAT_VERSION = "5.5.0"
"""The oldest version of LabelMe whose fields are written here."""


def labelme_document(
    image_name: str, size: tuple[int, int], polygons: Sequence[Polygon], label: str, note: str
) -> dict[str, object]:
    """Return the JSON value of one image's annotation.

    image_name: path of the image, relative to the file. size: width and height, px. note: where
    the outline comes from; kept as each shape's description.
    """
    return {
        "version": FORMAT_VERSION,
        "flags": {},
        "shapes": [_shape(polygon, label, note) for polygon in polygons],
        "imagePath": image_name,
        "imageData": None,
        "imageHeight": size[1],
        "imageWidth": size[0],
    }


def _shape(polygon: Polygon, label: str, note: str) -> dict[str, object]:
    return {
        "label": label,
        "points": [[round(float(x), 2), round(float(y), 2)] for x, y in polygon],
        "group_id": None,
        "description": note,
        "shape_type": "polygon",
        "flags": {},
        "mask": None,
    }
