"""If a contact shows only an arc of the object, its rotation is as uncertain as the pivot."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.tactile.slip.arc import pivot_doubt
from rig.tactile.slip.parameters import SHAPE

SIZE = 64
MIDDLE = complex(31.5, 31.5)
RADIUS = 20.0
PLACES = np.arange(SIZE)[None, :] + 1j * np.arange(SIZE)[:, None] - MIDDLE


def field(*edges: np.ndarray, within: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (h, w) of edges, steepest at their middle, on a dome that is ten times flatter; and the mask."""
    dome = -0.1 * PLACES / RADIUS
    total = dome + sum(edges, np.zeros_like(PLACES))
    return np.where(within, total, 0).astype(np.complex64), within.astype(np.uint8)


def arc(center: complex, radius: float) -> np.ndarray:
    """The edge of a disc: slopes outwards, 1.5 px wide."""
    out = PLACES - center
    return out / np.maximum(np.abs(out), 1e-9) * np.exp(-(((np.abs(out) - radius) / 1.5) ** 2))


def line(direction_rad: float, off_px: float) -> np.ndarray:
    """A straight edge."""
    normal = np.exp(1j * direction_rad)
    return normal * np.exp(-((((PLACES * np.conj(normal)).real - off_px) / 1.5) ** 2))


DOME = np.abs(PLACES) < RADIUS


def lens(center: complex, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A round gel against a disc that it covers in part."""
    return field(arc(center, radius), within=DOME & (np.abs(PLACES - center) < radius + 2.0))


@given(st.floats(18.0, 30.0), st.floats(0.6, 0.9), st.floats(-math.pi, math.pi))
def test_pivot_uncertainty_of_an_arc_grows_towards_its_center(
    radius: float, share: float, direction_rad: float
) -> None:
    center = share * radius * np.exp(1j * direction_rad)
    gradient, mask = lens(center, radius)
    rows, columns = np.nonzero(mask)
    lever = abs(center - (columns.mean() + 1j * rows.mean() - MIDDLE))
    wanted = SHAPE.pivot_share * math.sqrt(len(rows) / math.pi) / lever
    assert pivot_doubt(gradient, mask) == pytest.approx(min(1.0, wanted), rel=0.25)


@given(st.floats(-math.pi, math.pi))
def test_straight_edges_have_no_pivot_uncertainty(direction_rad: float) -> None:
    across = direction_rad + math.pi / 2
    assert pivot_doubt(*field(line(direction_rad, 4.0), line(across, 4.0), within=DOME)) == 0.0
    straight = pivot_doubt(*field(line(direction_rad, 4.0), within=DOME))
    assert straight < 0.05


@given(st.floats(0.0, 2.0), st.floats(8.0, 14.0))
def test_ring_around_the_middle_does_not_constrain_the_rotation(off_px: float, radius: float) -> None:
    assert pivot_doubt(*field(arc(complex(off_px), radius), within=DOME)) == 1.0
