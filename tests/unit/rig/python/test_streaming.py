"""`rig.estimator`: one frame after the other, its reference, and what it rejects."""

import resource
from typing import Any

import numpy as np
import pytest

import rig
from drivers.errors import InputError
from drivers.types import Image
from rig.contract_checks import gel, pressed_bar
from rig.tactile.sample import SlipSample, State
from support.desk_frames import desk_frames

RATE_HZ = 30.0


def streamed(estimator: rig.StreamingEstimator, turns: list[float], first: int = 0) -> list[rig.SlipSample]:
    """Give the frames of a bar turned by these angles, after those before `first`."""
    return [
        estimator.update(pressed_bar(20.0 + turn, first + i), (first + i) / RATE_HZ)
        for i, turn in enumerate(turns)
    ]


@pytest.mark.heavy
def test_angle_counts_from_the_reference() -> None:
    estimator = rig.estimator("slip", background=gel(320, 240))
    assert estimator.update(gel(320, 240, 1), -1.0).state == "no_contact"
    streamed(estimator, [0.0] * 12 + [float(n) for n in range(1, 9)] + [8.0] * 12)
    estimator.set_reference()
    *_, last = streamed(estimator, [8.0] * 3 + [8.0 + n for n in range(1, 6)], first=32)
    assert last.angle_deg == pytest.approx(5.0, abs=1.5)
    assert last.sigma_deg is not None
    assert last.slip
    assert last.time_s == pytest.approx(39 / RATE_HZ)


@pytest.mark.heavy
def test_sign_turns_angle_and_rate_around() -> None:
    turns = [0.0] * 12 + [float(n) for n in range(1, 9)]
    plain, turned = (
        streamed(rig.estimator(background=gel(320, 240), sign=sign), turns)[-1] for sign in (1, -1)
    )
    assert plain.angle_deg
    assert turned.angle_deg == -plain.angle_deg
    assert plain.rate_deg_s
    assert turned.rate_deg_s == -plain.rate_deg_s


@pytest.mark.heavy
def test_reference_without_contact_is_rejected_and_the_old_one_stays() -> None:
    estimator = rig.estimator("ellipse", background=gel(320, 240))
    with pytest.raises(InputError, match="press an object on the gel"):
        estimator.set_reference()
    streamed(estimator, [0.0] * 12)
    estimator.set_reference()
    last = streamed(estimator, [3.0] * 4, first=12)[-1].angle_deg
    for number in range(40):
        estimator.update(gel(320, 240, number), 1.0 + number / RATE_HZ)
    with pytest.raises(InputError, match=r"no frame in the 0\.4 s before"):
        estimator.set_reference()
    again = [estimator.update(pressed_bar(23.0, n), 3.0 + n / RATE_HZ) for n in range(4)][-1]
    assert again.angle_deg == pytest.approx(last, abs=1.0)


@pytest.mark.heavy
def test_memory_does_not_grow_over_many_frames() -> None:
    """20,000 frames of a press that repeats: 11 minutes at 30 Hz."""
    frames = [frame.image for frame in desk_frames(8.0)]
    estimator = rig.estimator(background=frames[0])
    peaks_mb = []
    for number in range(20_000):
        estimator.update(frames[number % len(frames)], number / RATE_HZ)
        if number % 5_000 == 4_999:
            peaks_mb.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    assert peaks_mb[-1] - peaks_mb[0] < 5.0


def test_given_image_may_be_reused_and_mirrored_views_are_taken() -> None:
    class Keeps:
        def __init__(self, background: np.ndarray) -> None:
            self.kept: list[np.ndarray] = []

        def update(self, image: np.ndarray, time_ns: int) -> SlipSample:
            self.kept.append(image)
            return SlipSample(time_ns, State.TRACKING, float(self.kept[0].mean()), contact_area_px=1.0)

    estimator = rig.estimator(Keeps, background=gel(80, 60))
    buffer = np.full((80, 60, 3), 7, np.uint8)
    assert estimator.update(buffer[..., ::-1], 0.0).angle_deg == 7.0
    buffer[...] = 9
    assert estimator.update(buffer, 1.0).angle_deg == 7.0


@pytest.mark.parametrize(
    ("image", "time_s", "match"),
    [
        (np.zeros((80, 60), np.uint8), 1.0, r"give \(H, W, 3\)"),
        (np.zeros((60, 80, 3), np.uint8), 1.0, "use one size"),
        (np.zeros((80, 60, 3), np.float32), 1.0, "give uint8 RGB"),
        ([[1]], 1.0, "give uint8 RGB"),
        (gel(80, 60), 0.4, "before the last one's, 0.5"),
        (gel(80, 60), float("nan"), "time_s is nan: give a number"),
        (gel(80, 60), "soon", "time_s is 'soon': give a number"),
    ],
)
def test_invalid_frame_or_time_is_rejected_and_changes_nothing(image: Any, time_s: Any, match: str) -> None:
    estimator = rig.estimator(background=gel(80, 60))
    first = estimator.update(gel(80, 60, 1), 0.5)
    with pytest.raises(InputError, match=match):
        estimator.update(image, time_s)
    again = estimator.update(gel(80, 60, 1), 0.5)
    assert (again.time_ns, again.state, again.angle_deg) == (first.time_ns, first.state, first.angle_deg)
    assert estimator.update(gel(80, 60, 2), 0.6).time_s == 0.6


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"background": None}, "give uint8 RGB"),
        ({"name": "toskov"}, "needs the wrench at the arm's wrist"),
        ({"name": 3}, "give a name or a class"),
    ],
)
def test_invalid_argument_is_rejected(arguments: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        rig.estimator(**{"background": gel(80, 60), **arguments})


CONTACT = "this background looks like a contact"


def desk(from_s: float) -> list[Image]:
    """Images of a simulated fingertip: without contact from 0 s to 3 s, with one from 4 s on."""
    return [frame.image for frame in desk_frames(from_s + 1.0, from_s=from_s)]


@pytest.mark.heavy
def test_background_with_a_contact_is_named_as_a_warning() -> None:
    empty, clear = desk(0.0), desk(4.0)
    with pytest.warns(UserWarning, match=CONTACT):
        rig.estimator("ellipse", background=clear[0])
    weak = (0.75 * empty[0] + 0.25 * clear[0]).astype(np.uint8)
    estimator = rig.estimator("ellipse", background=weak)
    with pytest.warns(UserWarning, match=f"{CONTACT}: lift the object, take another background") as live:
        [estimator.update(image, number / RATE_HZ) for number, image in enumerate(empty)]
    with pytest.warns(UserWarning, match=f"{CONTACT}: give a frame without contact") as stored:
        rig.estimate([*empty, *clear], weak, estimator="ellipse")
    assert len(live) == 1
    assert live[0].filename == stored[0].filename == __file__
