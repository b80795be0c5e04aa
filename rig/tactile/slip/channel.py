"""A keyframe and a frame to find it in, as the compiled loops take them (`rig.tactile.slip.loops`)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MOST_KEYS = 4
"""Number of keyframes that the compiled loop aligns to jointly."""
Values = NDArray[np.float32]


class Channel(NamedTuple):
    """The slopes of a keyframe (C = 2, P = 6), or its texture (C = 3, P = 3), and a frame to find them in.

    planes: (h, w, 3), the frame's vectors, x and y, and of slopes 1 in the contact, of texture its strength.
    points: (N,) complex64 from `center`. template: (C, N). squares: (N,) of its lengths. jacobian: (P, C, N).
    turns: how many times its angle a vector turns. unit: of the template, times that of planes. scale:
    pixels of planes per pixel of points. middle: where in them the first of those has its middle.
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
    """How much each point counts, (N,), and all of them; energy: of the template, so weighed."""

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
    """What `align_alone` found.

    inverse: of the normal matrix, for the angle. used: (N,), weights of the points seen. squares: (N,), of
    what remains. further_rad: see `Alignment`.
    """

    angle_rad: float
    shift_px: complex
    gain: float
    inverse: float
    iterations: int
    done: bool
    used: Values
    squares: Values
    further_rad: float


def some_of(key: Channel, step: int) -> Channel:
    """Return every step-th point of a channel."""
    arrays = (key.points[::step], key.template[:, ::step], key.squares[::step], key.jacobian[..., ::step])
    points, template, squares, jacobian = (np.ascontiguousarray(array) for array in arrays)
    return key._replace(points=points, template=template, squares=squares, jacobian=jacobian)
