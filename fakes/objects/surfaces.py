"""The simulated object's surface at a grasp, and its depth in the gel under a force.

A surface is the height map that one fingertip touches: heights away from the gel in mm, over object
coordinates (columns along the object's x axis, rows down). The opposite finger touches the mirror image.
Textures are added to a shape. Soft objects have special faces: in real recordings a handle, a rubber or
a fruit fills the contact with a broad faint bulge, which is mostly the shape of the gel and therefore does
not turn. Only the fine relief turns with the object: a line, an edge, a crease or the skin.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from fakes.objects.catalogue import GraspSite
from fakes.objects.shapes import SURFACE_MM_PER_PX, ContactShape, Field, Shape

KINDS = ("lines", "edge", "corner", "skin", "creases")
"""Kinds of soft faces by their relief: one to three thin lines; the edge of a flat face; a bent line; a rough
peel; fine wrinkles or a grid, as of a sheet.
"""
Texture = Callable[[Field, Field, float, np.random.Generator], Field]
"""Maps (along_mm, across_mm, pitch_mm, rng) to a height between 0 and 1."""


def _texture_height(contact: ContactShape, x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return the texture of a contact in mm. rng: draws its phase."""
    if contact.texture == "none" or contact.texture_mm == 0.0:
        return np.zeros_like(x_mm)
    along, across = _axes(x_mm, z_mm, np.deg2rad(contact.texture_deg))
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
    return _sample(np.asarray(cv2.GaussianBlur(canvas, (0, 0), 1.0), np.float32), along, across)


def _mottle(along: Field, across: Field, scale_mm: tuple[float, float], rng: np.random.Generator) -> Field:
    """Return smooth noise with the given feature sizes along and across, between 0 and 1."""
    field = rng.standard_normal((256, 256)).astype(np.float32)
    sigma_px = [max(0.25 * size * 256 / 30.0, 0.5) for size in scale_mm]
    field = cv2.GaussianBlur(field, (0, 0), sigmaX=sigma_px[0], sigmaY=sigma_px[1])
    low, high = np.percentile(field, (2.0, 98.0))
    return _sample(np.clip((field - low) / (high - low), 0.0, 1.0).astype(np.float32), along, across)


def _sample(canvas: Field, along: Field, across: Field) -> Field:
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
        along, across = _axes(x_mm, y_mm, np.deg2rad(self.angle_deg))
        first, second = (np.float32(0.5 / radius) for radius in self.radii_mm)
        return np.asarray(along * along * first + across * across * second, np.float32)


def draw_bulge(kind: str, rng: np.random.Generator) -> Bulge:
    """Draw the bulge behind a face: rounder for a peel, nearly flat for a sheet."""
    low, high = {"skin": (18.0, 60.0), "creases": (60.0, 250.0)}.get(kind, (22.0, 110.0))
    across = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Bulge((across * float(rng.uniform(1.0, 2.5)), across), float(rng.uniform(0.0, 180.0)))


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
        along, across = _axes(x, z, leg)
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
        _, across = _axes(x_mm, z_mm, tilt + turn)
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


def _axes(x_mm: Field, z_mm: Field, tilt_rad: float, off_mm: float = 0.0) -> tuple[Field, Field]:
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


SURFACE_PX = 256
FAR_MM = 6.0
"""Height of points outside the object."""

GEL_HALF_MM = (7.2, 9.6)
"""Half the sensing area of a DIGIT, across and along (19 x 14 mm, Lambeta et al. 2020)."""
GEL_STIFFNESS_N_MM3 = 0.11
"""Force per area and depth (Winkler foundation) of a soft 2 mm silicone pad."""
GEL_DOME_RADIUS_MM = 62.0
"""Radius of the gel's slightly convex face; therefore even a flat object makes a round contact that grows."""

_FORCE_STRIDE = 3
_JITTERED = {"radius_mm": 0.04, "width_mm": 0.03, "nose_mm": 0.06, "waist_radius_mm": 0.10}
_BEND_JITTER_PER_MM = 0.0006


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Heights of an object's face: (N, N) float32 mm away from the gel, 0 at the closest point.

    The origin, at which the fingers close, is the middle of the array.
    """

    height_mm: NDArray[np.float32]
    mm_per_px: float


def build_surface(site: GraspSite | ContactShape, side: int, seed: int) -> Surface:
    """Make the surface that one finger touches at a grasp site.

    side: +1 for the finger on the external camera's side, -1 for the opposite finger, which touches the same
    geometry mirrored in x with another phase of the texture. seed: of this specimen's small deviations (equal
    on both sides) and of the textures' phases. Raises `InputError` for another side.
    """
    if side not in (1, -1):
        raise InputError(f"side of a surface is {side}: use 1 (camera's side) or -1")
    contact = site.contact if isinstance(site, GraspSite) else site
    x_mm, z_mm = _grid()
    specimen = np.random.default_rng((seed, 11))
    parts = contact.parts if contact.exact else [_jitter(part, specimen) for part in contact.parts]
    height = np.minimum.reduce([part.height(x_mm, z_mm) for part in parts])
    if side < 0:
        height = height[:, ::-1]
    phase = np.random.default_rng((seed, 13, side + 1))
    return _surface(height + _texture_height(contact, side * x_mm, z_mm, phase))


def soft_surface(kind: str, side: int, seed: int) -> Surface:
    """Make the relief of a soft face under one finger; the two fingers touch different reliefs.

    kind: one of `KINDS`. side: +1 or -1.
    """
    return _surface(_RELIEFS[kind](*_grid(), np.random.default_rng((seed, 71, side + 1))).astype(np.float32))


def face_surface(site: GraspSite, kind: str | None, side: int, seed: int) -> Surface:
    """Return the surface at a grasp site: a soft face of a kind, or the object's own if kind is None."""
    return build_surface(site, side, seed) if kind is None else soft_surface(kind, side, seed)


def _surface(height_mm: Field) -> Surface:
    height = np.minimum(height_mm - height_mm.min(), np.float32(FAR_MM))
    return Surface(np.ascontiguousarray(height, np.float32), SURFACE_MM_PER_PX)


def depth_for_force(
    surface: Surface,
    force_n: float,
    tilt: tuple[float, float] = (0.0, 0.0),
    angle_deg: float = 0.0,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    bulge: Bulge | None = None,
) -> float:
    """Return the depth of the surface's origin in the gel under a normal force, mm.

    The gel is a Winkler foundation: each area element carries its depth times the stiffness. The total force
    increases with depth, so the depth follows exactly from the sorted heights. tilt, angle_deg, centre_mm and
    bulge (around centre_mm) as in `fakes.gel.pad.Imprint`. The depth may be slightly negative for a tilted
    face, and is 0 if no part of the surface is over the gel. Raises `InputError` for a negative or non-finite
    force.
    """
    if not (np.isfinite(force_n) and force_n >= 0.0):
        raise InputError(f"force on the gel is {force_n} N: it must be finite and not negative")
    clearance = np.sort(_clearance(surface, tilt, angle_deg, centre_mm, bulge))
    if not clearance.size:
        return 0.0
    cell_mm2 = (_FORCE_STRIDE * surface.mm_per_px) ** 2
    summed = np.cumsum(clearance, dtype=np.float64)
    count = np.arange(1, len(clearance) + 1)
    load = force_n / (GEL_STIFFNESS_N_MM3 * cell_mm2)
    carried = count[:-1] * clearance[1:] - summed[:-1]
    touching = int(np.searchsorted(carried, load))
    return float((load + summed[touching]) / count[touching])


def _clearance(
    surface: Surface, tilt: tuple[float, float], angle_deg: float, centre_mm: tuple[float, float],
    bulge: Bulge | None,
) -> Field:  # fmt: skip
    """Return the gap between object and gel at depth 0, mm, for the points over the gel."""
    heights = surface.height_mm[::_FORCE_STRIDE, ::_FORCE_STRIDE]
    first, step = -0.5 * (len(surface.height_mm) - 1) * surface.mm_per_px, _FORCE_STRIDE * surface.mm_per_px
    axis = np.float32(first) + np.float32(step) * np.arange(len(heights), dtype=np.float32)
    cos, sin = np.float32(np.cos(np.deg2rad(angle_deg))), np.float32(np.sin(np.deg2rad(angle_deg)))
    from_x = cos * axis[None, :] + sin * axis[:, None]
    from_y = cos * axis[:, None] - sin * axis[None, :]
    x, y = from_x + np.float32(centre_mm[0]), from_y + np.float32(centre_mm[1])
    over_gel = (np.abs(x) <= GEL_HALF_MM[0]) & (np.abs(y) <= GEL_HALF_MM[1])
    dome = (x * x + y * y) / np.float32(2.0 * GEL_DOME_RADIUS_MM)
    gap = heights + dome + np.float32(tilt[0]) * from_x + np.float32(tilt[1]) * from_y
    if bulge is not None:
        gap = gap + bulge.height(from_x, from_y)
    return gap[over_gel]


def _grid() -> tuple[Field, Field]:
    axis = ((np.arange(SURFACE_PX) - 0.5 * (SURFACE_PX - 1)) * SURFACE_MM_PER_PX).astype(np.float32)
    x_mm, z_mm = np.meshgrid(axis, axis)
    return x_mm, z_mm


def _jitter(part: Shape, rng: np.random.Generator) -> Shape:
    """Return a specimen of a part, with sizes changed by a few per cent and a slightly bent axis."""
    changes = {
        name: value * float(rng.uniform(1.0 - spread, 1.0 + spread))
        for name, spread in _JITTERED.items()
        if (value := getattr(part, name, 0.0)) > 0.0
    }
    bend = part.bend_per_mm + float(rng.uniform(-_BEND_JITTER_PER_MM, _BEND_JITTER_PER_MM))
    return replace(part, bend_per_mm=bend, **changes)
