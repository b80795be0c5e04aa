"""Simulated surfaces, and how deep a force presses them into the gel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.objects.catalogue import GraspSite, load_catalogue
from fakes.objects.shapes import ContactShape, Cylinder
from fakes.objects.surfaces import (
    FAR_MM,
    GEL_DOME_RADIUS_MM,
    GEL_STIFFNESS_N_MM3,
    build_surface,
    depth_for_force,
)

SITES = [(f"{m.name} {i}", site) for m in load_catalogue().values() for i, site in enumerate(m.sites)]
SURFACES = {name: build_surface(site, 1, 4) for name, site in SITES[::5]}


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("name", "site"), SITES, ids=[name for name, _ in SITES])
def test_surface_is_zero_at_its_closest_point_and_finite(name: str, site: GraspSite, side: int) -> None:
    height = build_surface(site, side, 2).height_mm
    assert height.dtype == np.float32
    assert height.shape[0] == height.shape[1]
    assert height.min() == 0.0
    assert np.isfinite(height).all()
    assert height.max() <= FAR_MM


def test_far_side_is_the_mirror_image_of_the_near_side() -> None:
    contact = ContactShape((Cylinder(radius_mm=6.0, axis_deg=25.0, bend_per_mm=0.01, x_mm=1.5),))
    near, far = build_surface(contact, 1, 3).height_mm, build_surface(contact, -1, 3).height_mm
    assert np.array_equal(far, near[:, ::-1])


@given(st.sampled_from(sorted(SURFACES)), st.floats(0.05, 2.0))
def test_the_depth_carries_the_force(name: str, force_n: float) -> None:
    """Integrate the foundation over the gel by hand, on the solver's own points."""
    surface = SURFACES[name]
    heights = surface.height_mm[::3, ::3].astype(float)
    axis = (np.arange(0, len(surface.height_mm), 3) - 0.5 * (len(surface.height_mm) - 1)) * surface.mm_per_px
    x, y = np.meshgrid(axis, axis)
    gap = heights + (x * x + y * y) / (2.0 * GEL_DOME_RADIUS_MM)
    gap = gap[(np.abs(x) <= 7.2) & (np.abs(y) <= 9.6)]
    depth = depth_for_force(surface, force_n)
    carried = GEL_STIFFNESS_N_MM3 * (3 * surface.mm_per_px) ** 2 * np.maximum(depth - gap, 0.0).sum()
    assert carried == pytest.approx(force_n, rel=1e-3)
