"""Faces of soft things: a broad faint bulge that rests on the gel, and thin relief that turns on it.

A handle, a rubber or a fruit fills the contact with a bulge that is mostly the gel's own, so that it stays
where the finger presses; only a line, an edge, a crease or the skin's relief tells the turn.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from fakes.objects.shapes import SURFACE_MM_PER_PX, Field

KINDS = ("lines", "edge", "corner", "skin", "creases")
"""What tells the turn: one to three thin lines; the edge of a flat face; two legs of a bent line; a rough
peel; a sheet's fine wrinkles or grid."""
LINES = ("lines", "edge", "corner")
"""Kinds of which next to nothing turns but a line or two."""


@dataclass(frozen=True, slots=True)
class Bulge:
    """A broad body behind the face, in image axes (x right, y down): it does not turn with the object.

    radii_mm: of curvature along and across `angle_deg` (counter-clockwise as seen).
    """

    radii_mm: tuple[float, float]
    angle_deg: float

    def height(self, x_mm: Field, y_mm: Field) -> Field:
        """Return how far it stands away from the gel, mm, at places from its middle."""
        turn = np.deg2rad(self.angle_deg)
        cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
        along, across = cos * x_mm - sin * y_mm, sin * x_mm + cos * y_mm
        first, second = (np.float32(0.5 / radius) for radius in self.radii_mm)
        return np.asarray(along * along * first + across * across * second, np.float32)


def draw_bulge(kind: str, rng: np.random.Generator) -> Bulge:
    """Draw the bulge behind a face: a peel's is rounder, a sheet's nearly flat."""
    low, high = {"skin": (18.0, 60.0), "creases": (60.0, 250.0)}.get(kind, (22.0, 110.0))
    across = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Bulge((across * float(rng.uniform(1.0, 2.5)), across), float(rng.uniform(0.0, 180.0)))


def soft_relief(kind: str, x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return the relief of a face, mm away from the gel over object coordinates in mm; it turns with it."""
    return _RELIEFS[kind](x_mm, z_mm, rng).astype(np.float32)


def _lines(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    relief = np.zeros_like(x_mm)
    tilt = float(rng.uniform(0.0, np.pi))
    for _ in range(int(rng.choice([1, 1, 1, 1, 2, 3]))):
        along, across = _axes(x_mm, z_mm, tilt + float(rng.normal(0.0, 0.15)), rng.uniform(-2.0, 2.0))
        across = across - np.float32(rng.normal(0.0, 0.012)) * along * along
        relief = relief - _line(along, across, float(rng.uniform(3.0, 14.0)), rng)
    return relief


def _edge(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """A flat face that ends: beyond its edge it falls off, and the edge bites in."""
    tilt = float(rng.uniform(0.0, 2.0 * np.pi))
    along, across = _axes(x_mm, z_mm, tilt, rng.uniform(0.5, 2.8))
    across = across - np.float32(rng.normal(0.0, 0.004)) * along * along
    fall = np.float32(rng.uniform(0.05, 0.22)) * np.maximum(across, 0.0)
    return fall - _line(along, across, 30.0, rng) * np.float32(rng.uniform(0.5, 1.0))


def _corner(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """A line of two legs."""
    tilt, opening = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(1.2, 2.5))
    place = rng.uniform(-1.5, 1.5, 2)
    x, z = x_mm - np.float32(place[0]), z_mm - np.float32(place[1])
    relief = np.zeros_like(x_mm)
    for leg in (tilt, tilt + opening):
        along, across = _axes(x, z, leg, 0.0)
        length = float(rng.uniform(3.0, 9.0))
        relief = np.minimum(
            relief, -_line(along - np.float32(length / 2), across, length / 2, rng, ridge=True)
        )
    return relief


def _skin(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """A peel: bumps and ridges of a size, finer ones among them."""
    size_mm = float(rng.uniform(0.35, 0.9))
    rough = _noise(x_mm.shape, size_mm, rng) + np.float32(0.5) * _noise(x_mm.shape, 0.5 * size_mm, rng)
    return np.float32(rng.uniform(0.005, 0.014)) * rough


def _creases(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Wrinkles of one direction, or a grid of two."""
    tilt, pitch = float(rng.uniform(0.0, np.pi)), float(rng.uniform(1.0, 2.2))
    deep = np.float32(rng.uniform(0.015, 0.04))
    wander = np.float32(0.5) * _noise(x_mm.shape, 3.0, rng)
    relief = np.zeros_like(x_mm)
    for turn in (0.0, np.pi / 2.0)[: int(rng.integers(1, 3))]:
        _, across = _axes(x_mm, z_mm, tilt + turn, 0.0)
        wave = np.cos(np.float32(2.0 * np.pi / pitch) * (across + wander))
        relief = relief + deep * np.maximum(wave - np.float32(0.2), 0.0)
    return relief * np.clip(np.float32(0.7) + np.float32(0.4) * _noise(x_mm.shape, 2.0, rng), 0.0, 1.3)


def _line(
    along: Field, across: Field, half_mm: float, rng: np.random.Generator, ridge: bool | None = None
) -> Field:
    """A thin ridge, or now and then a groove, that ends after half its length on both sides."""
    up = rng.random() < 0.65 if ridge is None else ridge
    height = np.float32(np.exp(rng.uniform(np.log(0.02), np.log(0.075))) * (1.0 if up else -0.8))
    width = np.float32(rng.uniform(0.2, 0.4))
    ends = np.clip((np.float32(half_mm) - np.abs(along)) / np.float32(0.6) + np.float32(0.5), 0.0, 1.0)
    return height * ends * np.exp(-((across / width) ** 2))


def _axes(x_mm: Field, z_mm: Field, tilt_rad: float, off_mm: float) -> tuple[Field, Field]:
    cos, sin = np.float32(np.cos(tilt_rad)), np.float32(np.sin(tilt_rad))
    return cos * x_mm - sin * z_mm, sin * x_mm + cos * z_mm - np.float32(off_mm)


def _noise(shape: tuple[int, ...], size_mm: float, rng: np.random.Generator) -> Field:
    """Smooth noise of unit spread on the grid of faces."""
    wide_px = size_mm / SURFACE_MM_PER_PX / 2.0
    noise = cv2.GaussianBlur(rng.standard_normal(shape).astype(np.float32), (0, 0), wide_px)
    return np.asarray(noise / noise.std(), np.float32)


_RELIEFS: dict[str, Callable[[Field, Field, np.random.Generator], Field]] = {
    "lines": _lines,
    "edge": _edge,
    "corner": _corner,
    "skin": _skin,
    "creases": _creases,
}
