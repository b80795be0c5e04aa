"""Slip events that need a reaction: thresholds from noise at rest, rearming, and delayed reactions."""

import numpy as np
import pytest

from drivers.errors import InputError
from protocols.observer import ReactionStep
from rig.lift.slip_watch import AGREES, GIVES_DEG, SlipSettings, SlipWatch, sigmas_for
from rig.tactile.sample import SlipSample, State

FRAME_NS = 16_000_000
TIP = "tip"


def answer(frame: int, angle_deg: float | None, rate_deg_s: float | None) -> SlipSample:
    return SlipSample(frame * FRAME_NS, State.TRACKING, angle_deg, None, rate_deg_s=rate_deg_s)


def resting(angle_deg: float, rate_deg_s: float, frames: int = 50, seed: int = 0) -> list[SlipSample]:
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, (angle_deg, rate_deg_s), (frames, 2))
    return [answer(i, float(a), float(r)) for i, (a, r) in enumerate(noise)]


def watch(
    *tips: str, noise_deg: float = 0.02, noise_deg_s: float = 0.5, max_turn_deg: float | None = None
) -> SlipWatch:
    made = SlipWatch(SlipSettings(max_turn_deg=max_turn_deg))
    made.begin({tip: resting(noise_deg, noise_deg_s, seed=seed) for seed, tip in enumerate(tips or (TIP,))})
    return made


def show(to: SlipWatch, *answers: tuple[int, float | None, float | None]) -> None:
    for frame, angle, rate in answers:
        to.update(TIP, answer(frame, angle, rate))


@pytest.mark.parametrize("rate", [0.0, -1.0, 1e6])
def test_impossible_false_alarm_rate_is_rejected(rate: float) -> None:
    with pytest.raises(InputError, match="--alarms-per-hour"):
        sigmas_for(rate, 60.0)


def test_thresholds_grow_with_the_sensors_own_noise() -> None:
    quiet, loud = (watch(noise_deg=0.02 * k, noise_deg_s=0.5 * k).thresholds()[TIP] for k in (1, 4))
    assert loud.angle_deg - GIVES_DEG == pytest.approx(4 * (quiet.angle_deg - GIVES_DEG))
    assert loud.rate_deg_s == pytest.approx(4 * quiet.rate_deg_s)


def test_fingertip_without_rate_raises_no_alarm() -> None:
    made = SlipWatch(SlipSettings())
    made.begin({TIP: [answer(i, 0.0, None) for i in range(50)]})
    show(made, (100, 5.0, None), (101, 6.0, 60.0))
    assert made.slip_ns() is None
    assert made.thresholds() == {}


YIELDING = [(100 + i, 0.7 * (1.0 - 0.9**i), 4.0 * 0.9**i) for i in range(60)]


@pytest.mark.parametrize(
    ("still", "slip"),
    [(YIELDING, (160, 0.75, 6.0)), ([(100, 0.45, -20.0), (101, 0.2, 20.0)], (102, 0.5, 20.0))],
    ids=["yielding gel", "rotation back"],
)
def test_rotation_away_from_rest_is_a_slip_and_other_changes_are_not(
    still: list[tuple[int, float, float]], slip: tuple[int, float, float]
) -> None:
    made = watch()
    show(made, *still)
    assert made.slip_ns() is None
    show(made, slip)
    assert made.slip_ns() == slip[0] * FRAME_NS
    assert [event.serial for event in made.events] == [TIP]


def test_slowest_fingertip_decides_whether_the_slip_continues() -> None:
    made = watch(TIP, "other")
    for frame, slowest_deg_s in ((100, 1.0), (101, 6.0)):
        made.update("other", answer(frame, 0.5, slowest_deg_s))
        show(made, (frame, 0.6, 30.0))
        assert (made.slip_ns() is None) is (slowest_deg_s < 4.0)


@pytest.mark.heavy
def test_false_alarms_from_noise_stay_below_the_requested_rate() -> None:
    """Ten minutes of rest with 1,000 permitted false alarms per hour; rearmed after each alarm."""
    made = SlipWatch(SlipSettings(false_alarms_per_hour=1000.0))
    made.begin({TIP: resting(1.5, 20.0, 2000)})
    rng = np.random.default_rng(1)
    frames = 37_500
    for frame, (angle, rate) in enumerate(rng.normal(0.0, (1.5, 20.0), (frames, 2)), start=3000):
        show(made, (frame, float(angle), float(rate)))
        if made.slip_ns() is not None:
            made.add_step(ReactionStep.STOP, frame, 0)
            made.add_step(ReactionStep.REST, frame, 0)
    asked = 1000.0 / 6.0
    assert 0.2 * asked < len(made.events) <= asked + 2.0 * asked**0.5


@pytest.mark.parametrize(
    ("share_of_b", "then"),
    [(-1.0, ((130, "b", 2.0, 60.0),)),
     (0.25 * AGREES * GIVES_DEG, ((130, "b", 2.0 * AGREES * GIVES_DEG, 10.0), (131, "a", 2.0, 10.0)))],
    ids=["opposite", "too small"],
)  # fmt: skip
def test_both_fingertips_have_to_show_a_slip(
    share_of_b: float, then: tuple[tuple[int, str, float, float], ...]
) -> None:
    made = watch("a", "b")
    for frame, angle in enumerate(np.linspace(0.0, 2.0, 30), start=100):
        made.update("a", answer(frame, float(angle), 10.0))
        made.update("b", answer(frame, share_of_b * float(angle), 10.0 if share_of_b > 0.0 else -10.0))
    assert made.slip_ns() is None
    for frame, tip, angle, rate in then:
        made.update(tip, answer(frame, angle, rate))
    assert made.slip_ns() == then[-1][0] * FRAME_NS


def slipped(made: SlipWatch, frame: int, by_deg: float, from_deg: float, closes: bool) -> bool:
    """Feed a slip and its reaction; return whether another slip would have exceeded the limit just before
    its end."""
    show(made, (frame, from_deg, 0.0), (frame + 1, from_deg + by_deg, 30.0))
    made.add_step(ReactionStep.STOP, (frame + 1) * FRAME_NS, 20)
    if closes:
        made.add_step(ReactionStep.CLOSE, (frame + 1) * FRAME_NS, 26)
        show(made, *((f, from_deg + by_deg + 3.0, 0.0) for f in range(frame + 2, frame + 12)))  # its contact
        made.add_step(ReactionStep.CLOSED, (frame + 12) * FRAME_NS, 26)
    too_much = made.another_is_too_much()
    made.add_step(ReactionStep.REST, (frame + 12) * FRAME_NS, 26)
    return too_much


def test_next_slip_is_too_much_if_150_percent_of_the_largest_passes_the_limit() -> None:
    made = watch()
    assert not slipped(made, 100, 1.5, 0.0, closes=True)
    assert not slipped(made, 200, 1.0, 4.5, closes=False)  # 2.5 degrees, and 2.25 to come: 4.75
    assert slipped(made, 300, 0.5, 5.5, closes=False)  # 3 degrees
    strict = watch(max_turn_deg=2.0)
    assert slipped(strict, 100, 1.0, 0.0, closes=False)


def test_slow_drift_is_no_slip_and_a_slip_after_it_is_detected() -> None:
    made = watch()
    drift_deg = 0.02 * FRAME_NS / 1e9
    frames = 3000
    for frame in range(frames):
        made.update(TIP, answer(100 + frame, frame * drift_deg, 30.0 if frame % 50 == 0 else 0.02))
    assert frames * drift_deg > 2 * GIVES_DEG
    assert made.slip_ns() is None
    last = 100 + frames
    show(made, (last, frames * drift_deg + 0.15, 20.0), (last + 1, frames * drift_deg + 0.6, 20.0))
    assert made.slip_ns() == (last + 1) * FRAME_NS


def test_alarm_is_rearmed_at_the_angle_after_a_reaction() -> None:
    made = watch()
    show(made, (100, 0.8, 20.0), *((f, 0.9, 0.0) for f in range(101, 115)))
    made.add_step(ReactionStep.STOP, 101 * FRAME_NS, 20)
    made.add_step(ReactionStep.REST, 114 * FRAME_NS, 24)
    assert made.slip_ns() is None
    show(made, (115, 1.0, 20.0))
    assert made.slip_ns() is None
    show(made, (116, 1.4, 20.0))
    assert made.slip_ns() == 116 * FRAME_NS


def test_rest_needs_a_tenth_of_a_second_below_the_noise_of_every_answering_fingertip() -> None:
    made = watch("a", "b")
    assert not made.at_rest()
    for frame in range(100, 108):
        made.update("a", answer(frame, 0.5, 0.0))
        made.update("b", answer(frame, 0.5, 20.0 if frame == 100 else 0.1))
    assert made.at_rest()
    made.update("b", answer(108, 0.6, 10.0))
    assert not made.at_rest()


def test_reaction_with_a_turn_limit_waits_until_the_limit_would_be_exceeded() -> None:
    made = watch(max_turn_deg=5.0)
    show(made, (100, 0.5, 5.0), (101, 0.6, 5.0))
    assert made.slip_ns() is None
    show(made, (102, 1.0, 30.0))
    assert made.slip_ns() == 102 * FRAME_NS
    assert made.events[0].raised_ns == 100 * FRAME_NS


def test_the_measured_closing_time_counts_from_the_first_reaction_on() -> None:
    def asked_after(closing_s: float) -> bool:
        made = watch(max_turn_deg=5.0)
        made.add_step(ReactionStep.STOP, 0, 20)
        made.add_step(ReactionStep.CLOSED, round(closing_s * 1e9), 24)
        made.add_step(ReactionStep.REST, round(closing_s * 1e9), 24)
        show(made, (100, 1.0, 10.0), (101, 1.0, 10.0))
        return made.slip_ns() is not None

    assert not asked_after(0.1)
    assert asked_after(0.6)
