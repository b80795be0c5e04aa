"""Markers on a gel: found, followed, and turned into centre and angle, or a reason why not."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.errors import InputError
from fakes.gel.dots import MarkerPrint, Shear, shear_of
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.surfaces import Surface
from rig.tactile.contact.dots import find_dots, without_markers
from rig.tactile.estimators import KOLAMURI, choose_estimator
from rig.tactile.peers.kolamuri import Degenerate, DotTracker, Rotation, find_rotation
from rig.tactile.sample import SlipSample, State

SHAPE, MM_PER_PX, FRAME_NS = (320, 240), (0.06, 0.06), 16_666_667
Points = NDArray[np.float64]
GRID = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2) * 25.0


def turned(points: Points, angle_deg: float, centre: tuple[float, float]) -> Points:
    """Counter-clockwise as seen, in an image whose y points down."""
    angle = math.radians(angle_deg)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return (points - centre) @ turn.T + centre


@given(
    angle_deg=st.floats(1.0, 170.0).flatmap(lambda a: st.sampled_from([a, -a])),
    x=st.floats(-200, 300),
    y=st.floats(-200, 300),
)
def test_centre_and_angle_of_any_rotation_are_found(angle_deg: float, x: float, y: float) -> None:
    found = find_rotation(GRID, turned(GRID, angle_deg, (x, y)))
    assert isinstance(found, Rotation)
    assert math.degrees(found.angle_rad) == pytest.approx(angle_deg, abs=1e-6)
    assert found.centre_px == pytest.approx((x, y), abs=1e-5)


@given(dx=st.floats(-30, 30), dy=st.floats(-30, 30))
def test_a_shift_has_no_centre(dx: float, dy: float) -> None:
    found = find_rotation(GRID, GRID + np.array([dx, dy]))
    assert found is (Degenerate.STILL if math.hypot(dx, dy) < 0.15 else Degenerate.TRANSLATION)


def test_too_few_markers_are_refused() -> None:
    for count in range(3):
        assert find_rotation(GRID[:count], turned(GRID[:count], 10.0, (0.0, 0.0))) is Degenerate.TOO_FEW


@given(direction_deg=st.floats(0, 180), angle_deg=st.floats(2, 90))
def test_markers_on_a_line_are_refused(direction_deg: float, angle_deg: float) -> None:
    line = turned(np.column_stack([np.arange(0.0, 100.0, 12.0), np.zeros(9)]), direction_deg, (0.0, 0.0))
    assert find_rotation(line, turned(line, angle_deg, (20.0, 5.0))) is Degenerate.COLLINEAR


def test_points_of_different_number_are_input_errors() -> None:
    with pytest.raises(InputError, match=r"\(N, 2\)"):
        find_rotation(GRID, GRID[1:])
    with pytest.raises(InputError, match="finite"):
        find_rotation(GRID, GRID * np.nan)


def printed(shear: Shear | None = None) -> NDArray[np.uint8]:
    touching = np.zeros(SHAPE, bool)
    touching[80:240, 60:180] = True
    light = MarkerPrint(SHAPE, MM_PER_PX, 3).light_left(shear, touching)
    return (light * np.array([150.0, 110.0, 180.0])).astype(np.uint8)


def test_markers_of_an_untouched_gel_are_found_and_removed() -> None:
    markers = find_dots(printed())
    apart = np.hypot(*(markers[:, None] - markers[None]).transpose(2, 0, 1))
    nearest = np.sort(apart, axis=1)[:, 1]
    assert len(markers) >= 100
    assert nearest == pytest.approx(25.0, abs=4.0)
    assert without_markers(printed()).min() >= 105


@pytest.mark.parametrize("twist_deg", [8.0, -8.0])
def test_twisted_gel_turns_its_markers(twist_deg: float) -> None:
    tracker = DotTracker(printed())
    motion = tracker.update(printed())
    for share in np.linspace(0.0, 1.0, 6):
        motion = tracker.update(printed(Shear(share * twist_deg, (0.3, -0.5), (0.0, 0.0))))
    inside = motion.seen & (np.abs(motion.first_px - (119.5, 159.5)) < (50.0, 70.0)).all(axis=1)
    found = find_rotation(motion.first_px[inside], motion.now_px[inside])
    assert isinstance(found, Rotation)
    assert math.degrees(found.angle_rad) == pytest.approx(twist_deg, abs=0.3)
    assert found.centre_px == pytest.approx((119.5 + 5.0, 159.5 - 8.3), abs=2.0)


def pressed(sensor: GelSensor, turns: list[float | None], follows: bool) -> list[NDArray[np.uint8]]:
    """Frames of a flat bar 5 mm wide that turns about the pad's middle."""
    height = np.zeros((200, 300), np.float32)
    height[:70], height[130:] = 5.0, 5.0
    bar = Surface(height, 0.08)
    rng = np.random.default_rng(5)
    frames = []
    for turn in turns:
        shear = shear_of(turn, (0.0, 0.0), (0.0, 0.0)) if follows and turn is not None else None
        imprint = None if turn is None else Imprint(bar, turn, depth_mm=0.35, shear=shear)
        frames.append(sensor.render(imprint, 0.0, rng))
    return frames


def followed(frames: list[NDArray[np.uint8]]) -> list[SlipSample]:
    estimator = choose_estimator(KOLAMURI).make(frames[0])
    return [estimator.update(frame, i * FRAME_NS) for i, frame in enumerate(frames)]


@pytest.mark.heavy
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_estimator_measures_the_rotation_of_the_gel(sign: float) -> None:
    turns = [None, *[0.0] * 9, *(sign * np.arange(0.5, 6.5, 0.5)).tolist()]
    samples = followed(pressed(GelSensor(7, markers=True), turns, True))
    assert sum(sample.angle_deg is not None for sample in samples[8:]) >= 10
    assert samples[0].state is State.NO_CONTACT
    for sample, turn in zip(samples[8:], turns[8:], strict=True):
        if sample.angle_deg is not None:
            assert sample.angle_deg == pytest.approx(shear_of(turn, (0, 0), (0, 0)).twist_deg, abs=0.8)
    assert samples[-1].state is State.TRACKING


def test_a_gel_without_markers_is_refused() -> None:
    samples = followed(pressed(GelSensor(7), [None, *[0.0] * 8, 3.0, 6.0], True))
    assert {s.state for s in samples[1:]} == {State.UNOBSERVABLE}


@pytest.mark.heavy
def test_real_markers_are_followed_through_real_slips(real_data: Path) -> None:
    clips = sorted((real_data / "marker_slip_clips").glob("*_exp_num_1_camera_*.avi"))
    assert len(clips) == 6
    for clip in clips:
        frames = read(clip)
        tracker = DotTracker(frames[0])
        seen = [tracker.update(frame).seen.mean() for frame in frames[1:70]]
        assert len(tracker.first_px) >= 28, clip.name
        assert min(seen) >= 0.85, clip.name


def read(clip: Path) -> list[NDArray[np.uint8]]:
    video, frames = cv2.VideoCapture(str(clip)), []
    while len(frames) < 70:
        good, frame = video.read()
        if not good:
            break
        frames.append(np.ascontiguousarray(frame[..., ::-1]))
    return frames
