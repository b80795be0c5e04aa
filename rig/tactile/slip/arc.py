"""Detect contacts that show one arc of the object, or a ring: their rotation depends on an unknown pivot.

An arc that rotates about its own center looks the same. A rotation about another pivot moves the center by
the angle times its distance from the pivot. The rest of the outline belongs to the gel. A round fingertip
against a rounded corner looks like this. A straight edge is an arc, too, but its center is so far away that
the position of the pivot does not matter.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from rig.tactile.slip.height import Gradient
from rig.tactile.slip.parameters import SHAPE

# A pixel belongs to an edge if its squared slope exceeds EDGE_SHARE times the quantile STEEPEST.
EDGE_SHARE, STEEPEST = 0.5, 0.99
LEAST_POINTS = 12
# Ridge that keeps the equations solvable for points on one line, which are on circles of any size, px
# squared.
RIDGE = 1e-9
# Slopes of one arc or ring point to its center by this share of their squares (0.88 to 1.00; two edges, a
# corner or a line with ends 0.2 to 0.8), and are this near the circle, work pixels, rms. Slopes of a texture
# that happen to lie around a point are further off, or point less well to it.
ONE_ARC, THIN_PX = 0.88, 1.25


def pivot_doubt(gradient: Gradient, mask: Image) -> float:
    """Return sigma of a rotation due to an unknown pivot, as a fraction of it; 0 without a lone arc.

    gradient: (h, w) complex. mask: (h, w) uint8, 1 in the contact.
    """
    squares, contact = gradient.real**2 + gradient.imag**2, mask > 0
    inside = squares[contact]
    nth = int(STEEPEST * (len(inside) - 1))
    steep = contact & (squares > EDGE_SHARE * np.partition(inside, nth)[nth])  # np.quantile takes far longer
    if np.count_nonzero(steep) < LEAST_POINTS:
        return 0.0
    rows, columns = np.nonzero(steep)
    moments = cv2.moments(mask, True)
    area = moments["m00"]
    places = columns + 1j * rows - complex(moments["m10"], moments["m01"]) / area
    slopes, squares = gradient[steep], squares[steep]
    center = _center(places, squares)
    distance, energy = np.abs(places - center), squares.sum()
    radius = (squares * distance).sum() / energy
    outwards = (places - center) / np.maximum(distance, 1e-9)
    radial = ((slopes * outwards.conj()).real ** 2).sum() / energy
    thickness = math.sqrt((squares * (distance - radius) ** 2).sum() / energy)
    if radial < ONE_ARC or thickness > THIN_PX:
        return 0.0
    return min(1.0, SHAPE.pivot_share * math.sqrt(area / math.pi) / max(abs(center), 1e-9))


def _center(places: NDArray[np.complex128], weights: NDArray[np.float32]) -> complex:
    """Return the center of the circle through points (N,), by least squares of its equation."""
    rows = np.stack([places.real, places.imag, np.ones(len(places))])
    normal = (rows * weights) @ rows.T + RIDGE * weights.sum() * np.eye(3)
    solved = np.linalg.solve(normal, (rows * weights) @ (places.real**2 + places.imag**2))
    return complex(solved[0], solved[1]) / 2.0
