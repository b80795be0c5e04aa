"""Frames of any size and content, in addition to the checks of `rig.contract_checks`."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drivers.types import Image
from rig.contract_checks import STEP_NS, gel, require_possible
from rig.tactile.contact.relative import full_area, work_size
from rig.tactile.estimators import ESTIMATORS, PUBLISHED, choose_estimator
from rig.tactile.sample import MAX_SIDE_PX, MOST_ELONGATED, State


@given(height=st.integers(8, MAX_SIDE_PX), width=st.integers(8, MAX_SIDE_PX), aspect=st.floats(0.5, 2.0))
def test_reduced_copy_is_never_empty_and_its_area_never_exceeds_the_frame(
    height: int, width: int, aspect: float
) -> None:
    if max(height, width) > MOST_ELONGATED * min(height, width):
        return
    columns, rows = work_size((height, width, 3), aspect)
    assert columns >= 1
    assert rows >= 1
    assert full_area(columns * rows, (rows, columns), (height, width)) <= height * width


@pytest.mark.heavy
def test_largest_frame_size_is_processed() -> None:
    largest = gel(1024, MAX_SIDE_PX)
    for name in ("slip", "ellipse", "kolamuri"):
        require_possible(choose_estimator(name).make(largest).update(largest, 0), largest)


SHAPE = (40, 30, 3)
CONTENT = st.one_of(
    hnp.arrays(np.uint8, SHAPE),
    st.integers(0, 255).map(lambda grey: np.full(SHAPE, grey, np.uint8)),
    st.integers(0, 3599).map(lambda i: np.eye(1, 3600, i, dtype=np.uint8).reshape(SHAPE) * np.uint8(255)),
    st.tuples(st.integers(0, 39), st.integers(0, 29)).map(
        lambda corner: np.pad(
            np.full((40 - corner[0], 30 - corner[1], 3), 255, np.uint8),
            ((corner[0], 0), (corner[1], 0), (0, 0)),
        )
    ),
)
"""Noise, one grey, one bright value, and a bright rectangle in a corner."""


@pytest.mark.heavy
@pytest.mark.parametrize("name", ESTIMATORS)
@given(background=CONTENT, frames=st.lists(CONTENT, min_size=1, max_size=6))
def test_any_image_is_estimated_or_refused(name: str, background: Image, frames: Sequence[Image]) -> None:
    estimator = choose_estimator(name).make(background)
    for i, frame in enumerate(frames):
        frame.setflags(write=False)
        sample = estimator.update(frame, i * STEP_NS)
        require_possible(sample, frame)
        tracked = sample.state in (State.TRACKING, State.REKEYED)
        assert tracked or sample.angle_deg is None or PUBLISHED in name
        assert sample.angle_deg is not None or not tracked or PUBLISHED in name
