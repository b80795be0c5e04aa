"""No frame is too small or too large; what every estimator must do stands in `rig.contract_checks`."""

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.contract_checks.test_estimator import STEP_NS, gel, require_possible, touched
from rig.tactile.contact.relative import full_area, work_size
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import MAX_SIDE_PX, MOST_ELONGATED


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    size=st.tuples(st.integers(8, 200), st.integers(8, 200)),
    share=st.floats(0.1, 1.0),
    name=st.sampled_from(["slip", "ellipse", "ellipse-published", "ecc", "polar", "kolamuri"]),
)
def test_no_contact_is_larger_than_the_frame(size: tuple[int, int], share: float, name: str) -> None:
    estimator = choose_estimator(name).make(gel(*size))
    for i in range(3):
        frame = touched(*size, share, i)
        require_possible(estimator.update(frame, i * STEP_NS), frame)


@given(height=st.integers(8, MAX_SIDE_PX), width=st.integers(8, MAX_SIDE_PX), aspect=st.floats(0.5, 2.0))
def test_the_reduced_copy_is_never_empty_and_its_area_never_more_than_the_frame(
    height: int, width: int, aspect: float
) -> None:
    if max(height, width) > MOST_ELONGATED * min(height, width):
        return
    columns, rows = work_size((height, width, 3), aspect)
    assert columns >= 1
    assert rows >= 1
    assert full_area(columns * rows, (rows, columns), (height, width)) <= height * width


def test_the_largest_frames_are_looked_at_small() -> None:
    largest = gel(1024, MAX_SIDE_PX)
    for name in ("slip", "ellipse", "kolamuri"):
        require_possible(choose_estimator(name).make(largest).update(largest, 0), largest)
