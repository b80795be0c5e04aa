"""Disturbed frames: the angle is right, its sigma covers the error, or there is no angle."""

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

import rig
from drivers.clock import NS_PER_S
from drivers.types import Frame, Image
from rig.tactile.contact.background import mean_background
from support.desk_frames import desk_digit, desk_frames

RIGHT_DEG = 3.0
Change = Callable[[Image], Image]


def shifted(x: float, y: float) -> Change:
    way = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    return lambda image: np.asarray(
        cv2.warpAffine(image, way, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def lit(gain: float) -> Change:
    return lambda image: np.clip(np.rint(gain * image), 0, 255).astype(np.uint8)


def compressed(quality: int) -> Change:
    def change(image: Image) -> Image:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)

    return change


CHANGES = {
    **{f"shifted right by {px} px": shifted(px, 0) for px in (2, 4, 20)},
    **{f"shifted left by {px} px": shifted(-px, 0) for px in (2, 4, 20)},
    **{f"shifted up by {px} px": shifted(0, -px) for px in (2, 4, 8, 20)},
    **{f"brightness {gain}": lit(gain) for gain in (0.5, 0.75, 1.25, 1.5)},
    "JPEG quality 30": compressed(30),
}
QUICK = ("shifted right by 2 px", "shifted up by 8 px", "brightness 0.5", "brightness 1.5", "JPEG quality 30")


def cases() -> Iterator[Any]:
    for name in CHANGES:
        marks = [] if name in QUICK else [pytest.mark.heavy]
        yield pytest.param(name, marks=marks)


@pytest.fixture(scope="module")
def desk() -> list[Frame]:
    """Frames of a simulated press, 15 per second: 1 s without contact, then a touch and a turn."""
    return list(desk_frames(8.0, every=2))


@pytest.mark.heavy
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", list(cases()))
def test_disturbed_frames_give_no_wrong_angle_with_a_small_sigma(desk: list[Frame], name: str) -> None:
    background = mean_background([frame.image for frame in desk[:8]])
    frames = [CHANGES[name](frame.image) for frame in desk]
    found = rig.estimate(frames, background, times_s=[frame.time_ns / NS_PER_S for frame in desk])
    turned = turns_deg(desk)
    answered = np.flatnonzero(np.isfinite(found.angle_deg))
    zero = answered[np.argmin(np.abs(found.angle_deg[answered]))] if answered.size else 0
    since = answered[answered >= zero]  # the contact grows before
    error = np.abs(found.angle_deg - (turned - turned[zero]))[since]
    assert (error <= np.maximum(RIGHT_DEG, 2.0 * found.sigma_deg[since])).all()
    if answered.size:
        assert turned[answered].max() > 15.0, "the object turned in frames with an angle"


def turns_deg(desk: list[Frame]) -> np.ndarray:
    """Return how far the object has turned in each frame; 0 before the touch."""
    digit = desk_digit()
    digit.draw(0, np.random.default_rng(0))
    return np.array([digit.turn_deg(frame.time_ns) or 0.0 for frame in desk])
