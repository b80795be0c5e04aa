"""Faces that press on the gel, as height maps drawn from seeds, in mm over x (right) and y (up)."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]
Random = np.random.Generator
PATCH_MM, PATCH_PX_MM = 16.0, 0.1
"""Half the width of the square of a height map, and size of its pixels."""
AWAY_MM = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """The face at one fingertip.

    relief_mm: (N, N) float32, distance below the face's highest point; it turns with the object. bulge_mm:
    radii of curvature of a soft broad body behind it, along and across `bulge_deg`, which presses the gel and
    does not turn; None without one.
    """

    relief_mm: Plane
    bulge_mm: tuple[float, float] | None = None
    bulge_deg: float = 0.0


def _grid() -> tuple[Plane, Plane]:
    axis = np.arange(-PATCH_MM, PATCH_MM, PATCH_PX_MM, dtype=np.float32) + PATCH_PX_MM / 2
    x, y = np.meshgrid(axis, -axis)
    return x.astype(np.float32), y.astype(np.float32)


def _roundness(x: Plane, radius_mm: float) -> Plane:
    """Return the height of a cylinder, approximated by a parabola."""
    return np.minimum(x**2 / (2.0 * radius_mm), AWAY_MM)


def _bar(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a rounded bar whose width changes along it, sometimes with an end."""
    radius = rng.uniform(2.0, 7.0) * (1.0 + rng.uniform(0.0, 0.03) * x)
    end = np.maximum(np.abs(x) - rng.uniform(4.0, 14.0), 0.0)
    bend = rng.uniform(-0.01, 0.01) * x**2
    return np.minimum((y - bend) ** 2 / (2.0 * np.maximum(radius, 1.0)) + 0.6 * end, AWAY_MM)


def _blade(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a flat, slightly tapered strip with sharp long edges."""
    half = rng.uniform(1.0, 3.2) + rng.uniform(-0.06, 0.06) * x
    return np.minimum(np.maximum(np.abs(y) - half, 0.0) * rng.uniform(1.5, 4.0), AWAY_MM)


def _thread(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a rod with a helical ridge."""
    pitch, slant = rng.uniform(0.9, 2.2), rng.uniform(0.05, 0.4)
    ridge = rng.uniform(0.08, 0.2) * (1.0 - np.cos(2.0 * np.pi * (x + slant * y) / pitch)) / 2.0
    return np.asarray(_roundness(y, rng.uniform(3.0, 8.0)) + ridge, np.float32)


def _braid(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a flat face with two crossing sets of ridges."""
    pitch, half = rng.uniform(1.2, 2.5), rng.uniform(0.4, 0.9)
    one = np.cos(2.0 * np.pi * (x * np.cos(half) + y * np.sin(half)) / pitch)
    two = np.cos(2.0 * np.pi * (x * np.cos(half) - y * np.sin(half)) / pitch)
    side = np.maximum(np.abs(y) - rng.uniform(2.5, 6.0), 0.0)
    return rng.uniform(0.05, 0.15) * (2.0 - one - two) / 2.0 + 0.5 * side


def _oval(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a smooth cap, clearly longer than wide."""
    across = rng.uniform(6.0, 12.0)
    along = across * rng.uniform(2.2, 5.0)
    return np.minimum(x**2 / (2.0 * along) + y**2 / (2.0 * across), AWAY_MM)


def _strokes(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a flat plate with raised strokes, as of letters."""
    picture = np.ones(x.shape, np.float32)
    middle = x.shape[0] / 2.0
    for _ in range(int(rng.integers(4, 9))):
        ends = middle + rng.uniform(-5.0, 5.0, (2, 2)) / PATCH_PX_MM
        start, stop = (tuple(int(v) for v in end) for end in ends)
        cv2.line(picture, start, stop, 0.0, int(rng.uniform(0.5, 1.1) / PATCH_PX_MM))
    soft = np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.5), np.float32)
    beside = np.maximum(np.hypot(x, y) - rng.uniform(5.0, 8.0), 0.0) * 0.5
    return np.asarray(rng.uniform(0.15, 0.35) * soft + beside, np.float32)


def _porous(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a broad, slightly elongated cap of rough material."""
    rough = rng.standard_normal(x.shape).astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(rough, (0, 0), s / PATCH_PX_MM) for s in (0.25, 0.8))
    rough = np.asarray(fine / fine.std() + coarse / coarse.std(), np.float32)
    cap = np.minimum(x**2 / 60.0 + y**2 / rng.uniform(20.0, 50.0), AWAY_MM)
    return np.asarray(rng.uniform(0.03, 0.07) * rough + cap, np.float32)


def _grooves(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return the relief of a soft handle: one to three thin, low lines, straight or slightly bent."""
    relief = np.zeros_like(x)
    for _ in range(int(rng.integers(1, 4))):
        away = y - rng.uniform(-3.0, 3.0) - rng.uniform(-0.3, 0.3) * x - rng.uniform(-0.02, 0.02) * x**2
        relief -= rng.uniform(0.05, 0.14) * np.exp(-((away / rng.uniform(0.25, 0.5)) ** 2))
    return relief


def _ending(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a soft flat face that ends on the gel: a raised edge with a gentle slope beyond it."""
    away = y - rng.uniform(1.0, 3.0) - rng.uniform(-0.2, 0.2) * x - rng.uniform(-0.006, 0.006) * x**2
    bite = rng.uniform(0.04, 0.11) * np.exp(-((away / rng.uniform(0.25, 0.45)) ** 2))
    fall = np.minimum(rng.uniform(0.08, 0.4) * np.maximum(away, 0.0), AWAY_MM)
    return np.asarray(fall - bite, np.float32)


def _peel(x: Plane, y: Plane, rng: Random) -> Plane:
    """Return a fruit's skin: low bumps and a few deeper pits."""
    rough = rng.standard_normal(x.shape).astype(np.float32)
    bumps = cv2.GaussianBlur(rough, (0, 0), rng.uniform(0.25, 0.5) / PATCH_PX_MM)
    pits = np.maximum(cv2.GaussianBlur(rough[::-1], (0, 0), 0.4 / PATCH_PX_MM) / 0.07 - 2.0, 0.0)
    return np.asarray(rng.uniform(0.008, 0.025) * bumps / bumps.std() + 0.04 * pits, np.float32)


Draw = Callable[[Plane, Plane, Random], Plane]
STIFF: tuple[Draw, ...] = (_bar, _blade, _thread, _braid, _oval, _strokes, _porous)
SOFT: tuple[Draw, ...] = (_grooves, _ending, _peel)


def draw_face(kind: int, seed: int, side: int) -> Face:
    """Draw a face.

    kind: index of the kind, see `KIND_NAMES`; the last kinds are soft bodies with slight relief. side: 0 or
    1; the second fingertip touches the mirror image of the first one's face, with another roughness.
    """
    x, y = _grid()
    x = -x if side else x
    rng = np.random.default_rng((seed, 1))
    draw = (*STIFF, *SOFT)[kind % KINDS]
    relief = draw(x, y, rng)
    if draw not in SOFT:
        return Face((relief - relief.min()).astype(np.float32))
    radii = (float(rng.uniform(14.0, 40.0)), float(rng.uniform(10.0, 18.0)))
    return Face((relief - relief.min()).astype(np.float32), radii, float(rng.uniform(0.0, 180.0)))


KIND_NAMES = (
    "bar", "blade", "thread", "braid", "oval", "strokes", "porous",
    "soft with lines", "soft with an edge", "soft peel",
)  # fmt: skip
KINDS = len(KIND_NAMES)
