"""Shapes that an object shows to a fingertip: heights away from the gel, over object coordinates.

`x_mm` runs along the object (right), `z_mm` down the image. A height is 0 at the closest point
and grows away from the gel, in mm. Every shape has a place, and an axis along which it may
bend and taper.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.floating]

SURFACE_MM_PER_PX = 0.12
"""Pitch of the grid that faces are drawn on."""
FLANK = 4.0
"""Slope, mm/mm, of every side wall: a vertical wall has no height, and the gel bridges it anyway."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape(ABC):
    """One part of a contact, and where it lies.

    x_mm, z_mm: its middle. axis_deg: counter-clockwise as seen. drop_mm: how far it lies behind
    the closest part. bend_per_mm: curvature of the axis. taper_per_mm: relative growth of the
    width along it.
    """

    x_mm: float = 0.0
    z_mm: float = 0.0
    axis_deg: float = 0.0
    drop_mm: float = 0.0
    bend_per_mm: float = 0.0
    taper_per_mm: float = 0.0

    def along_and_across(self, x_mm: Field, z_mm: Field) -> tuple[Field, Field]:
        """Return coordinates along the part's axis and across it, mm."""
        axis = np.deg2rad(self.axis_deg)
        cos, sin = np.float32(np.cos(axis)), np.float32(np.sin(axis))
        x, z = x_mm - np.float32(self.x_mm), z_mm - np.float32(self.z_mm)
        along, across = cos * x - sin * z, sin * x + cos * z
        across = across - np.float32(0.5 * self.bend_per_mm) * along * along
        return along, across / np.clip(1.0 + np.float32(self.taper_per_mm) * along, 0.4, 2.5)

    def height(self, x_mm: Field, z_mm: Field) -> Field:
        """Return the height in mm away from the gel at object coordinates in mm."""
        return self.relief(*self.along_and_across(x_mm, z_mm)) + np.float32(self.drop_mm)

    @abstractmethod
    def relief(self, along: Field, across: Field) -> Field:
        """Return the height in mm above the closest point at coordinates along the axis and across it."""


def _arc(distance: Field, radius_mm: float) -> Field:
    """Height of a circle's arc at a distance from its lowest point, continued by the flank."""
    edge = radius_mm * FLANK / np.hypot(1.0, FLANK)
    inside = np.minimum(distance, np.float32(edge))
    arc = radius_mm - np.sqrt(np.square(np.float32(radius_mm)) - inside * inside)
    return (arc + FLANK * (distance - inside)).astype(np.float32)


def _beyond(distance: Field, half_mm: float) -> Field:
    return np.maximum(np.abs(distance) - np.float32(half_mm), 0.0).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ball(Shape):
    """A sphere of `radius_mm`."""

    radius_mm: float

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        return _arc(np.hypot(along, across), self.radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(Shape):
    """A rod or the side of a can; ends after `length_mm` in a rounding of `end_radius_mm`.

    `waist_radius_mm` bends the generatrix away from the gel (a barrel), 0 keeps it straight.
    """

    radius_mm: float
    length_mm: float = 60.0
    end_radius_mm: float = 3.0
    waist_radius_mm: float = 0.0

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        height = _arc(np.abs(across), self.radius_mm)
        height = height + _arc(_beyond(along, self.length_mm / 2), self.end_radius_mm)
        return height + _crown(along, self.waist_radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pad(Shape):
    """A flat face with a rounded rectangular outline and rounded edges.

    corner_mm rounds the outline, edge_mm the edge; crown_radius_mm makes the face slightly
    convex across the axis, 0 keeps it flat.
    """

    length_mm: float
    width_mm: float
    corner_mm: float = 1.0
    edge_mm: float = 0.5
    crown_radius_mm: float = 0.0

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        inset = self.corner_mm + self.edge_mm
        outside = np.hypot(
            _beyond(along, self.length_mm / 2 - inset), _beyond(across, self.width_mm / 2 - inset)
        )
        height = _arc(_beyond(outside, self.corner_mm), self.edge_mm)
        return height + _crown(across, self.crown_radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge(Shape):
    """A straight edge: two faces that fall off at `slope` (mm/mm) from a nose of `nose_mm`.

    `slope_below` is the face down the image; equal to `slope` where not given (0 stands for that).
    """

    nose_mm: float
    slope: float = 0.7
    slope_below: float = 0.0
    length_mm: float = 60.0

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        below = self.slope_below or self.slope
        slope = np.where(across > 0.0, np.float32(below), np.float32(self.slope))
        height = np.hypot(slope * across, slope * slope * np.float32(self.nose_mm))
        height = height - slope * slope * np.float32(self.nose_mm)
        return height + _arc(_beyond(along, self.length_mm / 2), 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rim(Shape):
    """A ring of `radius_mm` made of a wire or lip of `wire_mm` radius."""

    radius_mm: float
    wire_mm: float

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        from_ring = np.abs(np.hypot(along, across) - np.float32(self.radius_mm))
        return _arc(from_ring, self.wire_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spikes(Shape):
    """Round tips of `tip_mm` radius, `pitch_mm` apart, on a cylinder of `radius_mm`."""

    radius_mm: float
    pitch_mm: float
    tip_mm: float
    depth_mm: float

    def relief(self, along: Field, across: Field) -> Field:
        """See `Shape.relief`."""
        row = np.round(across / np.float32(self.pitch_mm * 0.866))
        shifted = along + np.float32(self.pitch_mm / 2) * (row % 2)
        pitch = np.float32(self.pitch_mm)
        across_tip = across - row * np.float32(0.866) * pitch
        along_tip = shifted - np.round(shifted / pitch) * pitch
        tip = np.minimum(_arc(np.hypot(along_tip, across_tip), self.tip_mm), np.float32(self.depth_mm))
        return tip + _arc(np.abs(across), self.radius_mm)


def _crown(distance: Field, radius_mm: float) -> Field:
    if radius_mm == 0.0:
        return np.zeros_like(distance)
    return (distance * distance / np.float32(2.0 * radius_mm)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class ContactShape:
    """What an object shows at one grasp site: the nearest of its parts, with a texture.

    texture names one of `fakes.objects.relief.TEXTURES`; texture_mm is its height, pitch_mm its
    spacing, texture_deg its direction. `smooth_round` marks contacts whose turning cannot be
    seen. `exact`: made to size, as a gauge is; everyday objects are a few per cent off.
    """

    parts: tuple[Shape, ...]
    texture: str = "none"
    texture_mm: float = 0.0
    pitch_mm: float = 1.0
    texture_deg: float = 0.0
    smooth_round: bool = field(default=False)
    exact: bool = False


SHAPES: dict[str, type[Shape]] = {
    "ball": Ball,
    "cylinder": Cylinder,
    "pad": Pad,
    "edge": Edge,
    "rim": Rim,
    "spikes": Spikes,
}
"""Shapes by the name that the catalogue uses."""
