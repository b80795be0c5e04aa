"""The DIGIT driver with a sensor served over HTTP: settings, faults, reopening, sequence numbers."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, OutOfLimitsError
from drivers.video.digit import Digit
from drivers.video.stream import decode
from fakes.gel.sensor import GelSensor
from fakes.wire.mjpeg.server import MjpegServer
from support.connected import connected
from support.frame_files import write_folder
from support.slow_motion import CLOCK
from support.waiting import LIMIT_S

GEL = GelSensor(5)


def drawn(time_ns: int) -> np.ndarray:
    return GEL.render(None, 0.0, np.random.default_rng(time_ns))


@pytest.fixture
def light() -> list[tuple[float, float, float]]:
    """LED settings that the sensor received."""
    return []


@pytest.fixture
def server(light: list[tuple[float, float, float]]) -> Iterator[MjpegServer]:
    server = MjpegServer("D1", drawn, 60.0, CLOCK, on_light=lambda *rgb: light.append(rgb))
    server.start()
    yield server
    server.stop()


@pytest.fixture
def digit(server: MjpegServer) -> Iterator[Digit]:
    with connected(Digit("D1", 60.0, address=server.url, clock=CLOCK)) as digit:
        yield digit


def until(digit: Digit, kind: str, count: int = 1, said: str = "") -> None:
    """Read until a counter has grown by a number, and an error contains these words."""
    target, last = digit.counters()[kind] + count, ""
    ends = time.monotonic() + LIMIT_S
    while digit.counters()[kind] < target or said not in last:
        assert time.monotonic() < ends, (digit.counters(), last)
        try:
            digit.next_frame(0.2)
        except DeviceTimeoutError as error:
            last = str(error)


def test_frames_after_the_green_ones_are_upright_and_keep_the_received_bytes(digit: Digit) -> None:
    frame = digit.next_frame(1.0)
    assert (digit.counters()["warm_up"], digit.counters()["green"]) == (10, 0)
    assert frame.image.shape == (320, 240, 3)
    assert frame.jpeg is not None
    assert np.array_equal(decode(frame.jpeg), frame.image)
    assert np.abs(frame.image.astype(int) - drawn(frame.time_ns).astype(int)).mean() < 3.0
    assert np.abs(frame.image.astype(int) - np.rot90(drawn(frame.time_ns), 2).astype(int)).mean() > 10.0


def test_every_served_frame_arrives_once_at_the_rate(server: MjpegServer, digit: Digit) -> None:
    frames = [digit.next_frame(1.0) for _ in range(60)]
    numbers = [frame.sequence for frame in frames]
    served = [n for low, high in server.snapshot()["ranges"] for n in range(low, high + 1)]
    assert numbers == [n for n in served if numbers[0] <= n <= numbers[-1]]
    assert server.snapshot()["skipped"] == 0
    span_ns, periods = frames[-1].time_ns - frames[0].time_ns, numbers[-1] - numbers[0]
    assert span_ns / periods == pytest.approx(1e9 / 60, rel=0.01)
    assert digit.time_kind == "peer"


def test_size_is_set_before_rate_and_then_light(light: list[tuple[float, float, float]]) -> None:
    seen: list[str] = []
    server = MjpegServer("D1", drawn, 30.0, SystemClock(), on_light=lambda *rgb: seen.append("light"))
    configure = server.sensor.configure
    server.sensor.configure = lambda settings: (seen.extend(settings), configure(settings))[1]
    server.start()
    with connected(Digit("D1", 30.0, (480, 640), server.url)) as digit:
        assert digit.next_frame(1.0).image.shape == (640, 480, 3)
    server.stop()
    assert seen == ["size_px", "rate_hz", "light", "light"]


def test_light_is_set_again_after_reopening(server: MjpegServer, digit: Digit, light: list[Any]) -> None:
    digit.set_light(1.0, 0.5, 0.0)
    server.inject("disconnect", duration_s=0.3)
    until(digit, "reopened")
    assert light == [(1.0, 1.0, 1.0), (1.0, 0.5, 0.0), (1.0, 0.5, 0.0)]
    with pytest.raises(OutOfLimitsError, match="0 to 1"):
        digit.set_light(1.1, 0.0, 0.0)


def test_light_set_while_disconnected_is_set_on_connecting_and_needs_leds(
    server: MjpegServer, light: list[Any], tmp_path: Path
) -> None:
    digit = Digit("D1", 60.0, address=server.url)
    digit.set_light(0.0, 0.0, 1.0)
    with connected(digit):
        pass
    digit.set_light(0.0, 1.0, 0.0)
    assert light == [(0.0, 0.0, 1.0)]
    write_folder(tmp_path, drawn, 60.0, 30)
    with connected(Digit("D1", 60.0, address=str(tmp_path))) as digit:
        with pytest.raises(DeviceError, match="no LEDs"):
            digit.set_light(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("fault", "counter", "words"),
    [("green", "green", "are green"), ("shift", "shifted", "are shifted"), ("truncate", "damaged", "end is")],
)
def test_damaged_images_are_withheld_counted_and_named(
    server: MjpegServer, digit: Digit, fault: str, counter: str, words: str
) -> None:
    server.inject(fault, frames=5)
    until(digit, counter, 5)
    before = digit.next_frame(1.0).sequence
    assert digit.next_frame(1.0).sequence == before + 1
    assert digit.counters()[counter] == 5
    assert digit.counters()["reopened"] == 0
    server.inject(fault)
    until(digit, counter, said=words)


def test_dropped_frames_leave_gaps_and_frozen_ones_are_counted(server: MjpegServer, digit: Digit) -> None:
    first = digit.next_frame(1.0).sequence
    server.inject("drop", frames=4)
    until(digit, "dropped", 4)
    frames = [first, *(digit.next_frame(1.0).sequence for _ in range(3))]
    assert digit.counters()["dropped"] == 4
    assert frames[-1] - frames[0] >= 4
    assert server.snapshot()["withheld"] == 4
    assert len(server.snapshot()["ranges"]) == 2
    server.inject("freeze", frames=6)
    until(digit, "frozen", 6)
    for _ in range(5):
        digit.next_frame(1.0)
    assert digit.counters()["frozen"] == 6


def test_lost_sensor_is_reopened_and_its_sequence_continues(server: MjpegServer, digit: Digit) -> None:
    before = digit.next_frame(1.0)
    server.inject("disconnect")
    until(digit, "frames", 0, said="opening it again")
    server.inject("clear")
    until(digit, "reopened")
    after = digit.newest_frame(1.0)
    assert after.sequence - before.sequence == pytest.approx(
        (after.time_ns - before.time_ns) * 60e-9, abs=1.1
    )
    assert server.snapshot()["last"] >= after.sequence


def test_unsupported_digit_mode_is_rejected_with_the_supported_ones() -> None:
    with pytest.raises(InputError, match=r"240 x 320 px at 60 or 30 Hz; 480 x 640 px at 30 or 15 Hz"):
        Digit("D1", 60.0, (480, 640))
    with pytest.raises(InputError, match="does not exist"):
        Digit("D1", 60.0, address="/nowhere/at/all")
    with pytest.raises(InputError, match="rate_hz"):
        Digit("D1", -1.0, address="http://h/")
