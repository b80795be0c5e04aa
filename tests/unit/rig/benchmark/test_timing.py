"""Times per frame: by interface, and as multiples of the reference."""

from collections.abc import Callable

import numpy as np
import pytest

from drivers.types import Image
from rig.benchmark.timing import (
    ALONE,
    LIVE,
    PYTHON,
    Reference,
    Streamed,
    interface_ms,
    reference_ms,
    times_reference,
)
from rig.frames.series import TimedFrame
from rig.frames.times import FrameTime
from rig.tactile.estimators import choose_estimator

STEP_NS = 16_666_667


@pytest.fixture
def frames(press: Callable[..., Image]) -> list[TimedFrame]:
    """10 frames without contact, 20 with a turning one, and one that could not be read."""
    images = [press(None, seed=i) for i in range(10)]
    images += [press(15.0 + i, (85, 25), seed=10 + i) for i in range(20)]
    times = [FrameTime(f"{i}", i * STEP_NS) for i in range(31)]
    return [TimedFrame(t.text, t, image) for t, image in zip(times, [*images, None], strict=True)]


def test_interface_gives_the_same_angles_as_the_estimator_alone(
    frames: list[TimedFrame], blank: Image
) -> None:
    choice = choose_estimator("slip")
    alone, streamed = choice.make(blank), Streamed(choice.make(blank), blank)
    for frame in frames:
        if frame.image is not None:
            one, other = (of.update(frame.image, frame.time_ns) for of in (alone, streamed))
            assert (one.angle_deg, one.sigma_deg) == (other.angle_deg, other.sigma_deg)
            assert one.state is other.state


def test_each_interface_is_timed_on_all_frames_with_contact(frames: list[TimedFrame], blank: Image) -> None:
    spent = interface_ms(choose_estimator("pca"), blank, frames)
    assert {name: len(ms) for name, ms in spent.items()} == {ALONE: 20, PYTHON: 20, LIVE: 20}
    assert all(ms > 0.0 for of in spent.values() for ms in of)


def test_reference_is_timed_on_every_readable_frame(frames: list[TimedFrame]) -> None:
    assert len(reference_ms(frames)) == 30
    black = np.zeros((64, 64, 3), np.uint8)
    assert [Reference().update(black, 0).angle_deg, Reference().update(black, 1).angle_deg] == [None, None]


def test_multiple_of_the_reference_is_that_of_the_medians() -> None:
    assert times_reference([1.0, 3.0, 100.0], [2.0, 2.0, 50.0]) == 1.5
    assert times_reference([], [2.0]) is None
    assert times_reference([1.0], []) is None
