"""A tactile sensor that is read and estimated in a thread, for programs with a main loop."""

import numpy as np
import pytest

from drivers.clock import NS_PER_S
from drivers.errors import DeviceTimeoutError, InputError, NotConnectedError, StaleFrameError
from rig.contract_checks import gel, pressed_bar
from rig.live.sensor_background import BACKGROUND_FRAMES
from rig.python.fingertip import LiveFingertip
from support.played_sensor import play
from support.waiting import until

FIRST_FRAMES = 2
"""Frames with which it is checked that the sensor is not frozen."""


@pytest.mark.heavy
def test_angle_counts_from_the_settled_contact_and_has_the_sign_of_the_fingertip(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    untouched = [gel(320, 240, i) for i in range(FIRST_FRAMES + BACKGROUND_FRAMES + 3)]
    bars = [pressed_bar(20.0 + max(0, i - 30), i) for i in range(50)]
    sensor = play(monkeypatch, untouched + bars, sign=-1)
    tip = LiveFingertip("fake", "B")
    sensor.ready = lambda: not tip.is_connected or tip.angle().time_s == sensor.newest.time_ns / NS_PER_S
    with pytest.raises(NotConnectedError):
        tip.angle()
    tip.connect()
    found = [tip.angle()]
    while sensor.images:
        tip.next(5.0)
        found.append(tip.angle())
    assert (found[0].angle_deg, found[0].state) == (None, "no_contact")
    known = [each for each in found if each.angle_deg is not None]
    assert known[0].angle_deg == pytest.approx(0.0, abs=1.0)
    assert known[-1].angle_deg == pytest.approx(-19.0, abs=4.0)
    assert known[-1].sigma_deg
    tip.disconnect()
    assert not sensor.connected


def test_each_frame_is_new_once_and_a_failure_reaches_the_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    play(monkeypatch, [np.full((32, 24, 3), i, np.uint8) for i in range(FIRST_FRAMES + 1)])
    tip = LiveFingertip("fake", "B", estimator=None)
    tip.connect()
    assert tip.next(5.0).image[0, 0, 0] == FIRST_FRAMES
    until(lambda: tip._newest.failure is not None)
    with pytest.raises(DeviceTimeoutError, match="PLAYED"):
        tip.next(5.0)
    with pytest.raises(DeviceTimeoutError, match="PLAYED"):
        tip.newest(1.0)
    tip.disconnect()
    tip.disconnect()
    with pytest.raises(NotConnectedError):
        tip.newest(1.0)


def test_frozen_sensor_gives_no_background(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = play(monkeypatch, [gel(320, 240, 0)] * 90)
    with pytest.raises(StaleFrameError, match="PLAYED: it has repeated its picture"):
        LiveFingertip("fake", "B").connect()
    assert not sensor.connected


def test_simulated_sensor_is_read_in_real_time() -> None:
    tip = LiveFingertip("fake", "C", estimator=None)
    assert (tip.rate_hz, tip.size_px, tip.is_connected) == (60.0, (240, 320), False)
    tip.connect()
    first, second = tip.next(5.0), tip.next(5.0)
    assert second.time_ns > first.time_ns
    assert first.image.shape == (320, 240, 3)
    with pytest.raises(StaleFrameError, match="no frame of the last"):
        tip.newest(-1.0)
    with pytest.raises(DeviceTimeoutError, match="no new frame"):
        tip.next(0.0)
    tip.disconnect()


def test_finger_without_a_sensor_is_an_input_error() -> None:
    with pytest.raises(InputError, match="no sensor on finger 'A', only on B, C"):
        LiveFingertip("fake", "A")
