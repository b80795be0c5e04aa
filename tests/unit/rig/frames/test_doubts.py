"""Backgrounds with a contact in them and first frames from before are named, sound ones are not."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.images import encode_png
from rig.frames.estimates import Estimation, background_doubts, frame_doubts
from rig.frames.series import FrameSeries, TimedFrame, make_background
from rig.frames.times import FrameTime
from rig.tactile.estimators import choose_estimator

Image = NDArray[np.uint8]
Draw = Callable[..., Image]


def series(images: Sequence[Image]) -> FrameSeries:
    frames = [
        TimedFrame(str(i), FrameTime(f"{i / 60}", i * 16_666_667), image) for i, image in enumerate(images)
    ]
    return FrameSeries("drawn", lambda: iter(frames))


@pytest.fixture
def lift(press: Draw) -> list[Image]:
    """Six frames without contact, then a contact that turns and leaves."""
    free = [press(None, seed=i) for i in range(6)]
    turning = [press(10 + 4 * i, (85, 25), seed=10 + i) for i in range(14)]
    return [*free, *turning, *[press(None, seed=40 + i) for i in range(6)]]


def warnings(images: Sequence[Image], background: Image | None, path: Path) -> list[str]:
    """The warnings of an estimate; background: of the set, or None for frames without one."""
    spec = None if background is None else str(path / "bare.png")
    if background is not None:
        (path / "bare.png").write_bytes(encode_png(background))
    return list(Estimation(choose_estimator("ellipse"), spec).of_series(series(images)).doubts)


@pytest.mark.heavy
def test_a_sound_background_raises_no_doubt(lift: list[Image], blank: Image, tmp_path: Path) -> None:
    assert warnings(lift, blank, tmp_path) == []
    assert warnings(lift, None, tmp_path) == []
    background, _ = make_background("first:6", series(lift))
    assert background_doubts("first:6", background, series(lift)) == []


@pytest.mark.heavy
@pytest.mark.parametrize("place", [6, 10, 15])
def test_a_background_with_a_contact_in_it_is_named(lift: list[Image], place: int, tmp_path: Path) -> None:
    (doubt,) = warnings(lift, lift[place], tmp_path)
    assert "this background looks like a contact" in doubt
    assert "--background auto" in doubt


def test_background_of_the_set_is_checked_as_well(lift: list[Image]) -> None:
    own = replace(series(lift), empty=lambda: lift[10])
    (doubt,) = Estimation(choose_estimator("ellipse")).of_series(own).doubts
    assert "this background looks like a contact" in doubt


def test_a_contact_that_begins_among_the_first_frames_is_named(lift: list[Image]) -> None:
    background, _ = make_background("first:8", series(lift))
    (doubt,) = background_doubts("first:8", background, series(lift))
    assert "--background first:8 are not alike" in doubt


def test_other_light_than_the_backgrounds_is_no_contact(
    lift: list[Image], press: Draw, tmp_path: Path
) -> None:
    dim = press(None, seed=99, light=(0.8, 0.9, 0.85))
    assert warnings(lift, dim, tmp_path) == []


FIRST_FRAMES: dict[str, tuple[Callable[[list[Image]], list[Image]], str]] = {
    "sound": (lambda lift: lift, ""),
    "a contact from the first frame on": (lambda lift: lift[8:], ""),
    "few frames": (lambda lift: lift[:3], ""),
    "slightly darker": (lambda lift: [(lift[0] * 0.85).astype(np.uint8), *lift], ""),
    "dark": (lambda lift: [(lift[0] * 0.3).astype(np.uint8), *lift], "the first frame is dark"),
    "from before": (lambda lift: [lift[12], *lift], "the first frame differs from all frames after it"),
    "grey": (
        lambda lift: [np.repeat(i.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2) for i in lift],
        "no colour",
    ),
}


@pytest.mark.parametrize("name", FIRST_FRAMES)
def test_stale_dark_or_grey_frames_are_named(lift: list[Image], name: str) -> None:
    change, said = FIRST_FRAMES[name]
    doubts = frame_doubts(series(change(lift)))
    assert len(doubts) == bool(said)
    assert said in "".join(doubts)


def test_contact_growing_from_the_second_frame_raises_no_doubt(lift: list[Image], press: Draw) -> None:
    growing = [press(15, (20 + 12 * i, 10 + 4 * i), seed=60 + i) for i in range(6)]
    assert frame_doubts(series([lift[0], *growing])) == []
