"""Lifts of the second renderer: two fingertips that see an object rest, turn by fits and starts, and rest."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.benchmark.renderer.sensor import GelCamera
from rig.benchmark.renderer.shapes import KINDS, Random, draw_face

RATE_HZ = 60.0
REST_S, TURN_S, END_S = 1.0, 1.6, 0.6
BACKGROUND_FRAMES = 8
MOST_TURN_DEG, LEAST_TURN_DEG = 45.0, 5.0
STILL_SHARE = 0.1
"""Share of the lifts in which nothing turns."""
SIGNS = (1, -1)
"""Of the fingertips: they stand on opposite sides of the object."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """How a lift goes, at each frame.

    turn_deg: (N,) of the object. shift_mm: (N, 2) of the face's middle, right and up. depth_mm: (N,).
    """

    turn_deg: NDArray[np.float64]
    shift_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]

    def time_ns(self, frame: int) -> int:
        """When a frame is captured, from the start."""
        return round((1.0 + frame / RATE_HZ) * NS_PER_S)


LIFT_NS = round((1.0 + REST_S) * NS_PER_S)
"""When a lift begins to rise: angles count from what was told before."""


def draw_course(seed: int) -> Course:
    """Draw how a lift goes: rest, a turn that sticks and slips, rest."""
    rng = np.random.default_rng((seed, 3))
    frames = round((REST_S + TURN_S + END_S) * RATE_HZ)
    since_s = np.arange(frames) / RATE_HZ - REST_S
    turn_deg = _stick_slip(np.clip(since_s, 0.0, TURN_S), rng)
    share = np.clip(since_s / TURN_S, 0.0, 1.0)
    grown = 1.0 + rng.uniform(-0.25, 0.5) * share
    swing = 0.04 * np.sin(2.0 * math.pi * rng.uniform(0.4, 1.2) * since_s) * (since_s > 0)
    depth_mm = rng.uniform(0.35, 0.8) * (grown + swing)
    start, moved = rng.normal(0.0, 0.8, 2), rng.normal(0.0, 0.7, 2)
    return Course(turn_deg, start + moved * share[:, None], depth_mm)


def frames(seed: int, tip: int) -> Iterator[tuple[int | None, Image]]:
    """Yield a fingertip's frames: those of the empty gel first, with None, then times in ns and frames."""
    course, camera = draw_course(seed), GelCamera(10 * seed + tip)
    face = draw_face(seed, seed, tip)
    rng = np.random.default_rng((seed, 4, tip))
    placed_rad = float(np.random.default_rng((seed, 5)).uniform(-math.pi, math.pi))
    for _ in range(BACKGROUND_FRAMES):
        yield None, camera.picture(None, 0.0, (0.0, 0.0), 0.0, rng)
    for frame, (turn, shift, depth) in enumerate(
        zip(course.turn_deg, course.shift_mm, course.depth_mm, strict=True)
    ):
        angle = SIGNS[tip] * (placed_rad + math.radians(turn))
        middle = (SIGNS[tip] * float(shift[0]), float(shift[1]))
        yield course.time_ns(frame), camera.picture(face, angle, middle, float(depth), rng)


def kind_of(seed: int) -> int:
    """Return which kind of face a lift has."""
    return seed % KINDS


def _stick_slip(since_s: NDArray[np.float64], rng: Random) -> NDArray[np.float64]:
    """Return the turn, degrees, at times from 0 on: stretches at a rate, with rests between them."""
    if rng.random() < STILL_SHARE:
        return np.zeros_like(since_s)
    ends = np.sort(rng.uniform(0.0, TURN_S, int(rng.integers(2, 7)) * 2))
    moving = np.concatenate([[0.05], ends, [TURN_S]])
    rates = np.where(np.arange(len(moving) - 1) % 2 == 0, rng.uniform(0.3, 1.0, len(moving) - 1), 0.0)
    reached = np.concatenate([[0.0], np.cumsum(rates * np.diff(moving))])
    total = rng.uniform(LEAST_TURN_DEG, MOST_TURN_DEG) * rng.choice([-1.0, 1.0])
    return np.asarray(np.interp(since_s, moving, reached * total / reached[-1]), np.float64)
