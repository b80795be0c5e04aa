"""Paths through keep-out boxes are refused; paths around them are accepted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import OutOfLimitsError
from drivers.motion import check_way, meets
from drivers.types import ArmLimits, Box, Pose, Vector3

BOX = Box("stand", (0.4, -0.1, 0.0), (0.6, 0.1, 0.2))
LARGER = Box("", (0.399, -0.101, -0.001), (0.601, 0.101, 0.201))
"""By more than the spacing of the checked points."""
LIMITS = ArmLimits((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), 0.5, 1.5, 5.0, keep_out=(BOX,))
POINTS = st.tuples(*[st.floats(-0.5, 1.0, allow_nan=False).map(lambda v: round(v, 3))] * 3)


@given(POINTS, POINTS)
def test_line_intersects_a_box_if_one_of_its_points_is_inside(here: Vector3, there: Vector3) -> None:
    points = np.linspace(here, there, 2000)
    inside = bool(np.any(np.all((points > BOX.min_m) & (points < BOX.max_m), axis=1)))
    near = bool(np.any(np.all((points > LARGER.min_m) & (points < LARGER.max_m), axis=1)))
    assert inside <= meets(BOX, here, there) <= near


@pytest.mark.parametrize(
    ("way", "refused"),
    [
        (((0.2, 0.0, 0.1), (0.8, 0.0, 0.1)), True),
        (((0.2, 0.0, 0.1), (0.2, 0.0, 0.3), (0.8, 0.0, 0.3), (0.8, 0.0, 0.1)), False),
        (((0.5, 0.0, 0.3), (0.5, 0.0, 0.1)), True),
        (((0.5, 0.0, -0.1), (0.5, 0.0, 0.3)), True),
        (((0.5, 0.0, 0.1), (0.5, 0.0, 0.3)), False),
        (((0.5, 0.0, 0.1), (0.8, 0.0, 0.3)), True),
        (((0.5, 0.0, 0.1), (0.5, 0.02, 0.3)), True),
        (((0.5, 0.0, 0.2), (0.8, 0.0, 0.2)), False),
    ],
)
def test_hand_may_leave_a_box_only_straight_up(way: tuple[Vector3, ...], refused: bool) -> None:
    poses = [Pose(point) for point in way]
    if not refused:
        return check_way(LIMITS, poses)
    with pytest.raises(OutOfLimitsError, match="leads the hand into 'stand'"):
        check_way(LIMITS, poses)
