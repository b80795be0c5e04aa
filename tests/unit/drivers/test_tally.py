"""What is dropped, repeated and frozen, and that encoded bytes and pixels tell the same."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.tally import FROZEN_FRAMES, FrameTally
from drivers.types import Frame


def frame(number: int, brightness: int, jpeg: bytes | None = None) -> Frame:
    return Frame(np.full((2, 3, 3), brightness, np.uint8), number, number, "D1", jpeg)


@given(st.sets(st.integers(0, 60), min_size=1))
def test_gaps_in_the_numbers_are_drops(numbers: set[int]) -> None:
    tally = FrameTally()
    for number in sorted(numbers):
        tally.add(frame(number, number))
    assert tally.frames == len(numbers)
    assert tally.dropped == len(set(range(min(numbers), max(numbers) + 1)) - numbers)


@pytest.mark.parametrize("encoded", [False, True])
def test_a_source_is_frozen_after_so_many_equal_pictures_and_no_sooner(encoded: bool) -> None:
    tally = FrameTally()
    for number in range(FROZEN_FRAMES + 1):
        assert not tally.frozen
        tally.add(frame(number, 7, b"seven" if encoded else None))
        assert tally.repeated == (number > 0)
    assert tally.frozen
    tally.add(frame(FROZEN_FRAMES + 1, 8, b"eight" if encoded else None))
    assert not tally.frozen
    assert not tally.repeated


def test_pictures_of_another_size_are_other_pictures() -> None:
    tally = FrameTally()
    tally.add(frame(0, 7))
    tally.add(Frame(np.full((3, 3, 3), 7, np.uint8), 1, 1, "D1"))
    assert not tally.repeated
