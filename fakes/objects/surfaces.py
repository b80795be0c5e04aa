"""The simulated object's surface at a grasp, and its depth in the gel under a force.

A surface is the height map that one fingertip touches: heights away from the gel in mm, over object
coordinates (columns along the object's x axis, rows down). The opposite finger touches the mirror image.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputError
from fakes.objects.catalogue import GraspSite
from fakes.objects.relief import Bulge, soft_relief, texture_height
from fakes.objects.shapes import SURFACE_MM_PER_PX, ContactShape, Field, Shape

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
    parts = contact.parts if contact.exact else [_jittered(part, specimen) for part in contact.parts]
    height = np.minimum.reduce([part.height(x_mm, z_mm) for part in parts])
    if side < 0:
        height = height[:, ::-1]
    return _surface(
        height + texture_height(contact, side * x_mm, z_mm, np.random.default_rng((seed, 13, side + 1)))
    )


def soft_surface(kind: str, side: int, seed: int) -> Surface:
    """Make the relief of a soft face under one finger; the two fingers touch different reliefs.

    kind: one of `relief.KINDS`. side: +1 or -1.
    """
    return _surface(soft_relief(kind, *_grid(), np.random.default_rng((seed, 71, side + 1))))


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


def _jittered(part: Shape, rng: np.random.Generator) -> Shape:
    """Return a specimen of a part, with sizes changed by a few per cent and a slightly bent axis."""
    changes = {
        name: value * float(rng.uniform(1.0 - spread, 1.0 + spread))
        for name, spread in _JITTERED.items()
        if (value := getattr(part, name, 0.0)) > 0.0
    }
    bend = part.bend_per_mm + float(rng.uniform(-_BEND_JITTER_PER_MM, _BEND_JITTER_PER_MM))
    return replace(part, bend_per_mm=bend, **changes)
