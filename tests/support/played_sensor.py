"""A fingertip of a bench that gives prepared images, for `rig.python.fingertip`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.bench import Fingertip
from drivers.clock import NS_PER_S, SystemClock
from drivers.errors import DeviceTimeoutError
from drivers.types import Frame, Image
from rig.python import fingertip
from support.waiting import until


@dataclass
class PlayedSensor:
    """Gives images when `ready`, each with the time now; then nothing."""

    images: list[Image]
    serial: str = "PLAYED"
    connected: bool = False
    clock: SystemClock = field(default_factory=SystemClock)
    ready: Callable[[], bool] = lambda: True
    rate_hz: float = 60.0
    waits: bool = False

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
