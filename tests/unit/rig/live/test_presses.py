"""Repeated presses on simulated sensors: the zero of each press, its sigma, and the slip alarm. No clock."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from drivers.clock import NS_PER_S, SystemClock, to_ns
from drivers.images import with_jpeg
from drivers.types import Frame
from fakes.devices.desk import CYCLE_S, OFF_S, TOUCH_S, TURNS_S
from rig.frames.slip_alarm import SlipAlarm
from rig.live.desk_sensor import DeskSensor, Reading
from rig.tactile.estimators import EstimatorChoice, choose_estimator
from rig.tactile.sample import SlipSample
from support.desk_frames import desk_digit
from support.marks import long
from support.random_presses import OBJECTS, blank, random_presses

CLOCK, SLIP = SystemClock(), choose_estimator("slip")


def pressed_again(presses: int, seed: int, rate_hz: float, until_s: float) -> Iterator[Frame]:
    """Yield the frames of several cycles of the sensor, each up to a time in the cycle."""
    digit, from_s = desk_digit(), TOUCH_S - 1.0
    in_cycle = from_s + np.arange(round((until_s - from_s) * rate_hz)) / rate_hz
    times_s = np.add.outer(CYCLE_S * np.arange(presses), in_cycle).ravel()
    for number, time_s in enumerate(times_s.tolist()):
        image = digit.draw(to_ns(time_s), np.random.default_rng((seed, number)))
        yield with_jpeg(Frame(image, to_ns(time_s), number, digit.serial))


def figures_of_press(readings: Sequence[Reading], press: int) -> tuple[float, float, int]:
    """Return the mean error, the share of frames with a sigma up to 5 degrees, and the number of slips."""
    digit, begins_s = desk_digit(), press * CYCLE_S
    held = [r for r in readings if TOUCH_S + 1.0 < r.time_ns / NS_PER_S - begins_s < OFF_S - 0.2]
    off, sigmas = [], []
    for reading in held:
        truth, sample = digit.turn_deg(reading.time_ns), reading.sample
        assert truth is not None
        assert sample is not None
        assert sample.angle_deg is not None
        off.append(abs(sample.angle_deg - truth))
        sigmas.append(sample.sigma_deg or np.inf)
    slips = [time_s for time_s in held[-1].slips_s if begins_s <= time_s < begins_s + CYCLE_S]
    assert all(time_s > begins_s + TURNS_S[0] for time_s in slips), "no slip before the object turns"
    return float(np.mean(off)), float(np.mean(np.array(sigmas) <= 5.0)), len(slips)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "rate_hz", "presses", "until_s"),
    [
        (0, 60.0, 2, 7.0),
        (5, 30.0, 2, 7.0),
        *long(*((seed, rate_hz, 4, OFF_S + 0.2) for seed in (0, 1, 5) for rate_hz in (30.0, 60.0))),
    ],
)
def test_each_press_has_a_good_zero_and_no_slip_before_the_object_turns(
    seed: int, rate_hz: float, presses: int, until_s: float
) -> None:
    sensor = DeskSensor("D", SLIP, 1, None, None)
    readings = [sensor.take(frame, CLOCK) for frame in pressed_again(presses, seed, rate_hz, until_s)]
    turns = sum(begins_s < until_s for begins_s in TURNS_S)
    for press in range(presses):
        mean_off_deg, sure, slips = figures_of_press(readings, press)
        print(f"press {press + 1}: mean error {mean_off_deg:.2f} deg, sigma at most 5 deg in {sure:.1%}")
        assert mean_off_deg <= 0.3
        assert sure >= 0.99
        assert slips == turns


def alarms(
    choice: EstimatorChoice, presses: int, seed: int, turn_deg_s: float
) -> tuple[dict[int, int], dict[int, float]]:
    """Return by press the number of alarms before the object turns, and the rotation at the first alarm."""
    estimator, alarm = choice.make(blank(seed)), SlipAlarm()
    false, turned = dict.fromkeys(range(presses), 0), {}
    for frame in random_presses(presses, seed, turn_deg_s=turn_deg_s):
        sample: SlipSample = estimator.update(frame.image, frame.time_ns)
        on = alarm.update(sample)
        if frame.turned_deg == 0.0:
            false[frame.press] += on
        elif on:
            turned.setdefault(frame.press, frame.turned_deg)
    return false, turned


@pytest.mark.slow
@pytest.mark.parametrize("presses", [len(OBJECTS), *long(200)])
def test_objects_pressed_at_rest_raise_no_alarm(presses: int) -> None:
    false, _ = alarms(SLIP, presses, 0, 0.0)
    assert not any(false.values()), {OBJECTS[press % len(OBJECTS)]: n for press, n in false.items() if n}
