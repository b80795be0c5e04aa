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
from rig.tactile.estimators import choose_estimator
from support.desk_frames import desk_digit
from support.marks import heavy
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


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("seed", "rate_hz", "presses", "until_s"),
    [
        (5, 30.0, 2, 7.0),
        *heavy((0, 60.0, 2, 7.0)),
        *heavy(*((seed, rate_hz, 4, OFF_S + 0.2) for seed in (0, 1, 5) for rate_hz in (30.0, 60.0))),
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


def alarms(presses: int, seed: int, turn_deg_s: float) -> tuple[dict[int, int], list[float]]:
    """Return the number of alarms at rest by press, and the rotations at which turning presses raised one."""
    estimator, alarm = SLIP.make(blank(seed)), SlipAlarm()
    at_rest, turned = dict.fromkeys(range(presses), 0), dict[int, float]()
    for frame in random_presses(presses, seed, turn_deg_s=turn_deg_s):
        alarm.update(estimator.update(frame.image, frame.time_ns))
        if frame.time_ns not in alarm.raised_ns:
            continue
        if frame.turned_deg == 0.0:
            at_rest[frame.press] += 1
        else:
            turned.setdefault(frame.press, frame.turned_deg)
    return at_rest, list(turned.values())


@pytest.mark.parametrize(("seed", "presses"), heavy((0, len(OBJECTS)), *((seed, 25) for seed in range(1, 9))))
def test_at_most_one_of_25_objects_pressed_at_rest_raises_the_alarm(seed: int, presses: int) -> None:
    """200 presses with --all: a barrel, whose angle moves with the pressure of the hand, may raise it."""
    at_rest, _ = alarms(presses, seed, 0.0)
    raised = [OBJECTS[press % len(OBJECTS)] for press, n in at_rest.items() if n]
    assert len(raised) <= presses // 25, raised


@pytest.mark.heavy
@pytest.mark.parametrize(("turn_deg_s", "presses"), [(15.0, len(OBJECTS)), *heavy((15.0, 25), (5.0, 25))])
def test_objects_that_turn_raise_the_alarm_within_a_degree(turn_deg_s: float, presses: int) -> None:
    at_rest, turned = alarms(presses, 0, turn_deg_s)
    assert not any(at_rest.values())
    assert len(turned) == presses
    print(f"turned at the alarm: median {np.median(turned):.2f}, at most {max(turned):.2f} deg")
    assert np.median(turned) <= 1.0
    assert max(turned) <= 2.0
