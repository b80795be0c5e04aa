"""A tactile sensor that is read and estimated in a thread, for programs with a main loop."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.bench import Fingertip
from drivers.clock import NS_PER_S, SystemClock
from drivers.errors import DeviceTimeoutError, InputError, NotConnectedError, StaleFrameError
from drivers.types import Frame, Image
from rig.contract_checks import gel, pressed_bar
from rig.python import fingertip
from rig.python.fingertip import BACKGROUND_FRAMES, LiveFingertip
from support.waiting import until


@dataclass
class PlayedSensor:
    """Gives images when `ready`, each with the time now; then nothing."""

    images: list[Image]
    serial: str = "PLAYED"
    connected: bool = False
    clock: SystemClock = field(default_factory=SystemClock)
    ready: Callable[[], bool] = lambda: True

    def connect(self) -> None:
        self.connected = True

    def disconnect(self) -> None:
        self.connected = False

    def next_frame(self, timeout_s: float) -> Frame:
        if not self.images:
            self.clock.sleep_until(self.clock.now_ns() + NS_PER_S // 2)
            raise DeviceTimeoutError("PLAYED: no frame")
        until(self.ready)
        self.clock.sleep_until(self.clock.now_ns() + NS_PER_S // 100)
        self.newest = Frame(self.images.pop(0), self.clock.now_ns(), 0, self.serial)
        return self.newest

    def newest_frame(self, max_age_s: float) -> Frame:
        return self.newest


def play(monkeypatch: pytest.MonkeyPatch, images: list[Image], sign: int = 1) -> PlayedSensor:
    sensor = PlayedSensor(images)

    @contextmanager
    def bench(config: Any) -> Iterator[Any]:
        tips = (Fingertip(sensor, "B", sign),)  # type: ignore[arg-type]
        yield SimpleNamespace(fingertips=tips, clock=sensor.clock)

    monkeypatch.setattr(fingertip, "unconnected_bench", bench)
    return sensor


def test_angle_counts_from_the_settled_contact_and_has_the_sign_of_the_fingertip(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    untouched = [gel(320, 240, i) for i in range(BACKGROUND_FRAMES + 4)]
    bars = [pressed_bar(20.0 + max(0, i - 30), i) for i in range(50)]
    sensor = play(monkeypatch, untouched + bars, sign=-1)
    tip = LiveFingertip("fake", "B")
    sensor.ready = lambda: not tip.connected or tip.angle().time_s == sensor.newest.time_ns / NS_PER_S
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
    play(monkeypatch, [np.full((32, 24, 3), i, np.uint8) for i in range(BACKGROUND_FRAMES + 2)])
    tip = LiveFingertip("fake", "B", estimator=None)
    tip.connect()
    assert tip.next(5.0).image[0, 0, 0] == BACKGROUND_FRAMES + 1
    until(lambda: tip._failure is not None)
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
    assert (tip.rate_hz, tip.size_px, tip.connected) == (60.0, (240, 320), False)
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
