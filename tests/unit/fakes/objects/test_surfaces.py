"""Simulated surfaces, and how deep a force presses them into the gel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from fakes.objects.catalogue import GraspSite, load_catalogue
from fakes.objects.shapes import Ball, ContactShape, Cylinder, Pad
from fakes.objects.surfaces import (
    FAR_MM,
    GEL_DOME_RADIUS_MM,
    GEL_STIFFNESS_N_MM3,
    Surface,
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


@pytest.mark.parametrize(("name", "site"), SITES, ids=[name for name, _ in SITES])
def test_every_site_touches_the_gel_near_its_middle(name: str, site: GraspSite) -> None:
    """Otherwise a grasp would press on nothing, or only on the border of the sensor."""
    surface = build_surface(site, 1, 2)
    assert 0.0 < depth_for_force(surface, 1.0) < 1.6


def test_far_side_is_the_mirror_image_of_the_near_side() -> None:
    contact = ContactShape((Cylinder(radius_mm=6.0, axis_deg=25.0, bend_per_mm=0.01, x_mm=1.5),))
    near, far = build_surface(contact, 1, 3).height_mm, build_surface(contact, -1, 3).height_mm
    assert np.array_equal(far, near[:, ::-1])


def test_far_side_has_a_texture_of_its_own() -> None:
    contact = ContactShape((Pad(length_mm=40.0, width_mm=40.0),), texture="leather", texture_mm=0.2)
    near, far = build_surface(contact, 1, 3).height_mm, build_surface(contact, -1, 3).height_mm
    assert not np.allclose(far, near[:, ::-1], atol=0.01)


def test_axis_of_a_cylinder_turns_counter_clockwise_as_seen() -> None:
    height = build_surface(ContactShape((Cylinder(radius_mm=5.0, axis_deg=30.0),)), 1, 0).height_mm
    rows, columns = np.nonzero(height < 0.1)
    slope = np.polyfit(columns, rows, 1)[0]
    assert np.degrees(np.arctan2(-slope, 1.0)) == pytest.approx(30.0, abs=2.0)


def test_unknown_side_is_refused() -> None:
    with pytest.raises(InputError, match="side"):
        build_surface(load_catalogue()["1"].sites[0], 0, 1)


def test_ball_sinks_as_the_foundation_says() -> None:
    """Winkler: force = pi * stiffness * radius * depth^2 for a ball, the gel's dome adding curvature."""
    surface = build_surface(ContactShape((Ball(radius_mm=30.0),)), 1, 0)
    radius = 1.0 / (1.0 / GEL_DOME_RADIUS_MM + 2.0 * surface.height_mm[128, 160] / (32.5 * 0.12) ** 2)
    expected = np.sqrt(1.0 / (np.pi * GEL_STIFFNESS_N_MM3 * radius))
    assert depth_for_force(surface, 1.0) == pytest.approx(expected, rel=0.03)


@given(
    st.sampled_from(sorted(SURFACES)),
    st.floats(0.0, 4.0),
    st.floats(1e-3, 2.0),
    st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03)),
)
def test_depth_grows_with_force(name: str, force_n: float, more_n: float, tilt: tuple[float, float]) -> None:
    surface: Surface = SURFACES[name]
    assert depth_for_force(surface, force_n + more_n, tilt) > depth_for_force(surface, force_n, tilt)


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


def test_depth_follows_a_tilt_turned_with_the_object() -> None:
    surface = build_surface(ContactShape((Ball(radius_mm=25.0),)), 1, 0)
    straight = depth_for_force(surface, 0.8, (0.02, 0.0))
    assert depth_for_force(surface, 0.8, (0.0, -0.02), angle_deg=90.0) == pytest.approx(straight, rel=0.02)


@pytest.mark.parametrize("force_n", [-0.1, float("nan"), float("inf")])
def test_impossible_force_is_refused(force_n: float) -> None:
    with pytest.raises(InputError, match="force"):
        depth_for_force(SURFACES[next(iter(SURFACES))], force_n)


def test_an_object_held_beside_the_gel_presses_nothing() -> None:
    surface = build_surface(load_catalogue()["t1"].sites[0], 1, 2)
    assert depth_for_force(surface, 1.0, centre_mm=(0.0, 40.0)) == 0.0
