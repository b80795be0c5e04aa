"""The input of the compiled loops (`rig.tactile.slip.loops`): a keyframe, and a frame to align with it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MOST_KEYS = 4
"""Number of keyframes that the compiled loop aligns to jointly."""
Values = NDArray[np.float32]


class Channel(NamedTuple):
    """The slopes of a keyframe (C = 2, P = 6), or its texture (C = 3, P = 3), and the same of a frame.

    planes: (h, w, 3), of the frame: x and y of its vectors; for slopes 1 in the contact, for texture its
    strength. points: (N,) complex64, relative to `center`. template: (C, N). squares: (N,), squared lengths
    of the template. jacobian: (P, C, N). turns: a vector rotates by this multiple of the angle. unit: factor
    from planes to the template. scale: pixels of planes per pixel of points. middle: position of the middle
    of the first pixel of points in planes.
    """

    planes: Values
    points: NDArray[np.complex64]
    center: complex
    template: Values
    squares: Values
    jacobian: Values
    turns: float
    unit: float = 1.0
    scale: float = 1.0
    middle: complex = 0j


class Weights(NamedTuple):
    """Weights of the points, (N,), and their sum. energy: weighted energy of the template."""

    points: Values
    total: float
    energy: float


class JointKey(NamedTuple):
    """A keyframe for `align_jointly`: both channels, its weight, its angle, and the point from its center."""

    slopes: Channel
    slope_weights: Weights
    texture: Channel
    texture_weights: Weights
    weight: float
    angle_rad: float
    lever_px: complex


class Found(NamedTuple):
    """Result of `align_alone`.

    inverse: element of the inverse normal matrix for the angle. used: (N,), weights of the points inside the
    contact. squares: (N,), squared residuals. bent_rad, further_rad: see `Alignment`.
    """

    angle_rad: float
    shift_px: complex
    gain: float
    inverse: float
    iterations: int
    done: bool
    used: Values
    squares: Values
    bent_rad: float
    further_rad: float


def some_of(key: Channel, step: int) -> Channel:
    """Return every step-th point of a channel."""
    arrays = (key.points[::step], key.template[:, ::step], key.squares[::step], key.jacobian[..., ::step])
    points, template, squares, jacobian = (np.ascontiguousarray(array) for array in arrays)
    return key._replace(points=points, template=template, squares=squares, jacobian=jacobian)
