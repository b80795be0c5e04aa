"""Shapes of contacts as height maps over object coordinates.

`x_mm` runs along the object (to the right), `z_mm` down the image. Heights are in mm, 0 at the point closest
to the gel, and increase away from the gel. Each shape has a position, and an axis along which it may bend and
taper.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.floating]

SURFACE_MM_PER_PX = 0.12
"""Pitch of the grid of height maps."""
FLANK = 4.0
"""Slope, mm/mm, of side walls. A height map cannot contain vertical walls, and the gel would bridge them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape(ABC):
    """One part of a contact, with its position.

    x_mm, z_mm: its middle. axis_deg: direction of the axis, counter-clockwise as seen. drop_mm: distance
    behind the closest part. bend_per_mm: curvature of the axis. taper_per_mm: relative growth of the width
    along the axis.
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
    """Return the height of a circular arc at a distance from its lowest point, continued by a side wall."""
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
        return _arc(np.hypot(along, across), self.radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(Shape):
    """A rod or the side of a can.

    length_mm: its length; the ends are rounded with `end_radius_mm`. waist_radius_mm: radius of curvature of
    the generatrix, which bends away from the gel as on a barrel; 0 for a straight one.
    """

    radius_mm: float
    length_mm: float = 60.0
    end_radius_mm: float = 3.0
    waist_radius_mm: float = 0.0

    def relief(self, along: Field, across: Field) -> Field:
        height = _arc(np.abs(across), self.radius_mm)
        height = height + _arc(_beyond(along, self.length_mm / 2), self.end_radius_mm)
        return height + _crown(along, self.waist_radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pad(Shape):
    """A flat face with a rounded rectangular outline and rounded edges.

    corner_mm: radius of the outline's corners. edge_mm: radius of the edge. crown_radius_mm: radius of
    curvature of the face across the axis, 0 for a flat face.
    """

    length_mm: float
    width_mm: float
    corner_mm: float = 1.0
    edge_mm: float = 0.5
    crown_radius_mm: float = 0.0

    def relief(self, along: Field, across: Field) -> Field:
        inset = self.corner_mm + self.edge_mm
        outside = np.hypot(
            _beyond(along, self.length_mm / 2 - inset), _beyond(across, self.width_mm / 2 - inset)
        )
        height = _arc(_beyond(outside, self.corner_mm), self.edge_mm)
        return height + _crown(across, self.crown_radius_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge(Shape):
    """A straight edge between two faces, rounded with radius `nose_mm`.

    slope: slope of the faces away from the gel, mm/mm. slope_below: slope of the lower face in the image; 0
    for the same as `slope`.
    """

    nose_mm: float
    slope: float = 0.7
    slope_below: float = 0.0
    length_mm: float = 60.0

    def relief(self, along: Field, across: Field) -> Field:
        below = self.slope_below or self.slope
        slope = np.where(across > 0.0, np.float32(below), np.float32(self.slope))
        height = np.hypot(slope * across, slope * slope * np.float32(self.nose_mm))
        height = height - slope * slope * np.float32(self.nose_mm)
        return height + _arc(_beyond(along, self.length_mm / 2), 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rim(Shape):
    """A ring of radius `radius_mm`, made of a wire or lip of radius `wire_mm`."""

    radius_mm: float
    wire_mm: float

    def relief(self, along: Field, across: Field) -> Field:
        from_ring = np.abs(np.hypot(along, across) - np.float32(self.radius_mm))
        return _arc(from_ring, self.wire_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spikes(Shape):
    """Round tips of radius `tip_mm`, `pitch_mm` apart, on a cylinder of radius `radius_mm`."""

    radius_mm: float
    pitch_mm: float
    tip_mm: float
    depth_mm: float

    def relief(self, along: Field, across: Field) -> Field:
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
    """The shape of an object at one grasp site: the union of its parts, with a texture.

    texture: name of one of `fakes.objects.surfaces.TEXTURES`. texture_mm, pitch_mm, texture_deg: its height,
    spacing and direction. smooth_round: whether a rotation of the contact is invisible. exact: whether sizes
    are exact, as those of a gauge; sizes of other objects vary by a few per cent.
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
"""Shapes by their name in the catalogue."""
