"""The estimator `ecc` follows a rotation and refuses contacts without an angle."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State

Image = NDArray[np.uint8]
Press = Callable[..., Image]
FRAME_NS = 16_666_667


def followed(blank: Image, frames: list[Image]) -> list[SlipSample]:
    estimator = choose_estimator("ecc").make(blank)
    return [estimator.update(frame, i * FRAME_NS) for i, frame in enumerate(frames)]


@pytest.mark.heavy
@pytest.mark.parametrize("sign", [1, -1])
def test_rotation_is_followed_with_its_sign(sign: int, press: Press, blank: Image) -> None:
    turns = [0.0] * 8 + [sign * float(turn) for turn in range(31)]
    samples = followed(blank, [press(turn, seed=i) for i, turn in enumerate(turns)])
    errors = [abs((s.angle_deg or 0.0) - turn) for s, turn in zip(samples, turns, strict=True)]
    assert all(s.state in (State.TRACKING, State.REKEYED) for s in samples)
    assert max(errors) < 3.5
    assert samples[-1].contact_area_px > 1000


def test_disc_is_refused(press: Press, blank: Image) -> None:
    frames = [press(turn, half_axes=(50.0, 50.0), seed=turn) for turn in range(12)]
    samples = followed(blank, frames)
    assert {s.state for s in samples} == {State.UNOBSERVABLE}
    assert {s.angle_deg for s in samples} == {None}


@pytest.mark.heavy
def test_angle_continues_after_a_time_without_contact(press: Press, blank: Image) -> None:
    frames = [press(t, seed=t) for t in (0, 0, 0, 0, 0, 0, 0, 10)]
    frames += [press(None, seed=i) for i in range(40)] + [press(10, seed=i) for i in range(8)]
    samples = followed(blank, frames)
    assert {s.state for s in samples[8:48]} == {State.NO_CONTACT}
    assert samples[48].state is State.REKEYED
    assert samples[-1].angle_deg == pytest.approx(10.0, abs=1.5)
