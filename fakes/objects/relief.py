"""Relief of simulated surfaces, in mm: textures that are added to a shape, and faces of soft objects.

In real recordings a handle, a rubber or a fruit fills the contact with a broad faint bulge, which is mostly
the shape of the gel and therefore does not turn. Only the fine relief turns with the object: a line, an edge,
a crease or the skin.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from fakes.objects.shapes import SURFACE_MM_PER_PX, ContactShape, Field

KINDS = ("lines", "edge", "corner", "skin", "creases")
"""Kinds of soft faces by their relief: one to three thin lines; the edge of a flat face; a bent line; a rough
peel; fine wrinkles or a grid, as of a sheet.
"""
Texture = Callable[[Field, Field, float, np.random.Generator], Field]
"""Maps (along_mm, across_mm, pitch_mm, rng) to a height between 0 and 1."""


def texture_height(contact: ContactShape, x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return the texture of a contact in mm over object coordinates in mm. rng: draws its phase."""
    if contact.texture == "none" or contact.texture_mm == 0.0:
        return np.zeros_like(x_mm)
    along, across = _axes(x_mm, z_mm, np.deg2rad(contact.texture_deg), 0.0)
    relief = TEXTURES[contact.texture](along, across, contact.pitch_mm, rng)
    return (np.float32(contact.texture_mm) * relief).astype(np.float32)


def _wave(distance: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    phase = np.float32(rng.uniform(0.0, 2.0 * np.pi))
    wave = np.sin(distance * np.float32(2 * np.pi / pitch_mm) + phase)
    return (0.5 + 0.5 * wave).astype(np.float32)


def _fabric(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    weave = _wave(along, pitch_mm, rng) * _wave(across, pitch_mm, rng)
    return (0.6 * weave + 0.4 * _mottle(along, across, (2.0, 2.0), rng)).astype(np.float32)


def _letters(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    """Return embossed strokes in two lines of writing; the strokes are raised."""
    canvas = np.ones((256, 256), np.float32)
    height_px = max(int(256 * pitch_mm / 30.0), 4)
    for row in (128 - height_px, 128 + height_px // 2):
        for column in range(10, 240, int(0.8 * height_px) + 1):
            ends = rng.integers(0, height_px, (2, 4)) * np.array([0.6, 1.0, 0.6, 1.0])
            for x0, y0, x1, y1 in ends.astype(int):
                cv2.line(canvas, (column + x0, row + y0), (column + x1, row + y1), 0.0, 2)
    return _sampled(np.asarray(cv2.GaussianBlur(canvas, (0, 0), 1.0), np.float32), along, across)


def _mottle(along: Field, across: Field, scale_mm: tuple[float, float], rng: np.random.Generator) -> Field:
    """Return smooth noise with the given feature sizes along and across, between 0 and 1."""
    field = rng.standard_normal((256, 256)).astype(np.float32)
    sigma_px = [max(0.25 * size * 256 / 30.0, 0.5) for size in scale_mm]
    field = cv2.GaussianBlur(field, (0, 0), sigmaX=sigma_px[0], sigmaY=sigma_px[1])
    low, high = np.percentile(field, (2.0, 98.0))
    return _sampled(np.clip((field - low) / (high - low), 0.0, 1.0).astype(np.float32), along, across)


def _sampled(canvas: Field, along: Field, across: Field) -> Field:
    """Sample a 30 mm square canvas at coordinates in mm; it is continued by mirroring."""
    scale, centre = canvas.shape[0] / 30.0, canvas.shape[0] / 2
    columns = (along * scale + centre).astype(np.float32)
    rows = (across * scale + centre).astype(np.float32)
    sampled = cv2.remap(canvas, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(sampled, np.float32)


TEXTURES: dict[str, Texture] = {
    "ribs": lambda along, across, pitch, rng: _wave(along, pitch, rng),
    "knurl": lambda along, across, pitch, rng: np.maximum(
        _wave(along + across, pitch, rng), _wave(along - across, pitch, rng)
    ),
    # wood grain: fine lines along the axis that meander and break off
    "grain": lambda along, across, pitch, rng: _mottle(along, across, (8.0 * pitch, pitch), rng),
    "leather": lambda along, across, pitch, rng: _mottle(along, across, (pitch, pitch), rng),
    "fabric": _fabric,
    "letters": _letters,
}
"""Textures by their name in the catalogue ("none" is a smooth surface)."""


@dataclass(frozen=True, slots=True)
class Bulge:
    """A broad body behind the face, in image axes (x right, y down), that does not turn with the object.

    radii_mm: of curvature along and across `angle_deg` (counter-clockwise as seen).
    """

    radii_mm: tuple[float, float]
    angle_deg: float

    def height(self, x_mm: Field, y_mm: Field) -> Field:
        """Return the height in mm away from the gel, at coordinates relative to the bulge's middle."""
        along, across = _axes(x_mm, y_mm, np.deg2rad(self.angle_deg), 0.0)
        first, second = (np.float32(0.5 / radius) for radius in self.radii_mm)
        return np.asarray(along * along * first + across * across * second, np.float32)


def draw_bulge(kind: str, rng: np.random.Generator) -> Bulge:
    """Draw the bulge behind a face: rounder for a peel, nearly flat for a sheet."""
    low, high = {"skin": (18.0, 60.0), "creases": (60.0, 250.0)}.get(kind, (22.0, 110.0))
    across = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Bulge((across * float(rng.uniform(1.0, 2.5)), across), float(rng.uniform(0.0, 180.0)))


def soft_relief(kind: str, x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return the relief of a face, mm away from the gel over object coordinates in mm."""
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
    """Return a flat face that ends at an edge and falls off beyond it; the edge itself is raised."""
    tilt = float(rng.uniform(0.0, 2.0 * np.pi))
    along, across = _axes(x_mm, z_mm, tilt, rng.uniform(0.5, 2.8))
    across = across - np.float32(rng.normal(0.0, 0.004)) * along * along
    fall = np.float32(rng.uniform(0.05, 0.22)) * np.maximum(across, 0.0)
    return fall - _line(along, across, 30.0, rng) * np.float32(rng.uniform(0.5, 1.0))


def _corner(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    tilt, opening = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(1.2, 2.5))
    place = rng.uniform(-1.5, 1.5, 2)
    x, z = x_mm - np.float32(place[0]), z_mm - np.float32(place[1])
    relief = np.zeros_like(x_mm)
    for leg in (tilt, tilt + opening):
        along, across = _axes(x, z, leg, 0.0)
        half = float(rng.uniform(3.0, 9.0)) / 2
        relief = np.minimum(relief, -_line(along - np.float32(half), across, half, rng, ridge=True))
    return relief


def _skin(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return a peel: bumps and ridges of one size, with finer ones between them."""
    size_mm = float(rng.uniform(0.35, 0.9))
    rough = _noise(x_mm.shape, size_mm, rng) + np.float32(0.5) * _noise(x_mm.shape, 0.5 * size_mm, rng)
    return np.float32(rng.uniform(0.005, 0.014)) * rough


def _creases(x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return wrinkles in one direction, or a grid in two."""
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
    """Return a thin ridge or groove that extends `half_mm` to both sides. ridge: None to draw which one."""
    up = rng.random() < 0.65 if ridge is None else ridge
    height = np.float32(np.exp(rng.uniform(np.log(0.02), np.log(0.075))) * (1.0 if up else -0.8))
    width = np.float32(rng.uniform(0.2, 0.4))
    ends = np.clip((np.float32(half_mm) - np.abs(along)) / np.float32(0.6) + np.float32(0.5), 0.0, 1.0)
    return height * ends * np.exp(-((across / width) ** 2))


def _axes(x_mm: Field, z_mm: Field, tilt_rad: float, off_mm: float) -> tuple[Field, Field]:
    cos, sin = np.float32(np.cos(tilt_rad)), np.float32(np.sin(tilt_rad))
    return cos * x_mm - sin * z_mm, sin * x_mm + cos * z_mm - np.float32(off_mm)


def _noise(shape: tuple[int, ...], size_mm: float, rng: np.random.Generator) -> Field:
    """Return smooth noise of standard deviation 1 on the grid of faces."""
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
