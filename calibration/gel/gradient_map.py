"""The map from a gel's colour change to the slope of its surface: linear in its features, least squares.

The features are products of the logarithmic colour
change (an LED's brightness and the camera's gain cancel in it) and the place on the gel, because the
light differs from place to place. They hold no constant: where no colour changed, the slope is zero.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import CalibrationError

Array = NDArray[np.floating]

FLOOR_GREY = 8.0
"""Added to both pictures before the logarithm, so that dark places do not amplify noise."""
SMOOTHING_PX = 1.5
_COLOUR_DEGREES = ((1, 3), (2, 3))
"""Degree in colour, and the degree in place that goes with it."""
_RIDGE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class GradientMap:
    """weights: (F, 2), from features to the x and y components of the surface's unit normal.

    shape: (rows, columns) of the pictures it was made for. Image axes: x right, y down; a normal's
    x component is positive on the right-hand side of a dent.
    """

    weights: Array
    shape: tuple[int, int]

    def normals(self, change: Array, places_px: Array) -> Array:
        """(N, 2) components of the normals from (N, 3) colour changes at (N, 2) px (x, y)."""
        return features(change, places_px, self.shape) @ self.weights

    def slopes(self, change: Array, places_px: Array) -> Array:
        """(N, 2) slopes dz/dx, dz/dy of the dent's depth; dimensionless (mm per mm), z into the gel.

        A component of the normal is a sine; the slope is its tangent, signed as for a dent, whose depth
        falls away from its middle. Components are clipped at 0.95.
        """
        parts = np.clip(self.normals(change, places_px), -0.95, 0.95)
        rest = np.sqrt(np.maximum(1.0 - (parts**2).sum(axis=1), 0.05))
        return -parts / rest[:, None]


def colour_change(image: NDArray[np.uint8], reference: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W, 3) float32: log of the picture over the reference, smoothed. Raises `CalibrationError`."""
    if image.shape != reference.shape:
        raise CalibrationError(f"gel: picture {image.shape} and reference {reference.shape} differ in size")
    change = np.log((image.astype(np.float32) + FLOOR_GREY) / (reference + FLOOR_GREY))
    return np.asarray(cv2.GaussianBlur(change, (0, 0), SMOOTHING_PX), np.float32)


def features(change: Array, places_px: Array, shape: tuple[int, int]) -> Array:
    """(N, F): products of colour monomials and place monomials; zero where nothing changed."""
    u = places_px[:, 0] / (shape[1] / 2.0) - 1.0
    v = places_px[:, 1] / (shape[0] / 2.0) - 1.0
    red, green, blue = change.T.astype(np.float64)
    columns = []
    for degree, place_degree in _COLOUR_DEGREES:
        colours = [
            red**i * green**j * blue ** (degree - i - j)
            for i in range(degree + 1)
            for j in range(degree + 1 - i)
        ]
        places = [u**i * v**j for i in range(place_degree + 1) for j in range(place_degree + 1 - i)]
        columns += [c * p for c in colours for p in places]
    return np.column_stack(columns)


def fit_gradient_map(change: Array, places_px: Array, normals: Array, shape: tuple[int, int]) -> GradientMap:
    """Fit the map to samples of known normals.

    change: (N, 3) colour changes. places_px: (N, 2) x, y. normals: (N, 2) x and y components. shape:
    (rows, columns) of the pictures. Ridge regression: features scaled to unit mean square, the
    ridge as rows below the triangular system, no normal matrix. Raises `CalibrationError` for
    samples that are not finite, or fewer than twice as many as features.
    """
    if not (np.isfinite(change).all() and np.isfinite(places_px).all() and np.isfinite(normals).all()):
        raise CalibrationError("gel: a sample of its colour map is not finite")
    system = features(change, places_px, shape)
    if len(system) < 2 * system.shape[1]:
        raise CalibrationError(f"gel: {len(system)} samples of known slope are too few for its colour map")
    scale = np.maximum(np.sqrt((system**2).mean(axis=0)), 1e-12)
    ridge = np.sqrt(_RIDGE * len(system)) * np.eye(len(scale))
    # The normals are factorised too: forming the orthogonal matrix would take as long again.
    triangle, turned = np.hsplit(
        np.linalg.qr(np.column_stack([system / scale, normals]), mode="r")[: len(scale)], [len(scale)]
    )
    target = np.vstack([turned, np.zeros((len(scale), 2))])
    weights, *_ = np.linalg.lstsq(np.vstack([triangle, ridge]), target, rcond=None)
    return GradientMap(weights / scale[:, None], shape)
