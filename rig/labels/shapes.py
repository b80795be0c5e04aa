"""LabelMe's shapes as masks: what a person drew, filled."""

import math
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.formats import shown
from drivers.types import Image
from rig.labels.polygons import Polygon, polygons_mask

_BACKGROUND_LABELS = ("_background_", "background", "__ignore__")
_CIRCLE_CORNERS = 72
_FAR, _MOST_PX = 1.0, 1e6
"""How far a corner may lie outside its image, in widths or heights of it; and in px."""


def labelme_mask(document: dict[str, Any], shape: tuple[int, int], where: str) -> Image:
    """Return the union of a document's shapes as (H, W) uint8, 0 or 255.

    shape: (H, W) of the image. Points are scaled where the document was drawn on another size.
    Raises `InputError` naming `where` for shapes that enclose nothing.
    """
    drawn_on = document.get("imageWidth") or shape[1], document.get("imageHeight") or shape[0]
    if not all(isinstance(side, int | float) and side > 0 for side in drawn_on):
        raise InputError(f"{where}: its image's size is {shown(drawn_on)}: save it anew in LabelMe")
    polygons = [
        _scaled(_corners(entry, f"{where}, shape {number}"), drawn_on, shape, f"{where}, shape {number}")
        for number, entry in enumerate(document["shapes"], start=1)
        if not (isinstance(entry, dict) and entry.get("label", "") in _BACKGROUND_LABELS)
    ]
    return polygons_mask(polygons, (shape[1], shape[0]))


def _scaled(corners: Polygon, drawn_on: tuple[float, float], shape: tuple[int, int], where: str) -> Polygon:
    """Return corners in pixels of the image. Raises `InputError` where one lies far outside of it."""
    share = corners / np.array(drawn_on)
    if np.abs(share - 0.5).max() > 0.5 + _FAR:
        raise InputError(f"{where}: a point lies far outside its image: draw it again in LabelMe")
    return share * np.array([shape[1], shape[0]])


def _corners(entry: Any, where: str) -> Polygon:
    """Return a shape's outline, x and y in px, 0 at the image's corner."""
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
    if kind == "polygon" and len(points) >= 3:
        return points
    raise InputError(
        f"{where}: a {shown(kind)} of {len(points)} points encloses nothing: draw a polygon in LabelMe"
    )
