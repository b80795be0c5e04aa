"""The pump delivers every frame once, fingertips in order of capture, for all phases and jitter."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, StaleFrameError
from drivers.types import ArmState, Frame, Image
from fakes.clock import SimulatedClock
from fakes.devices.arm import FakeArm
from fakes.devices.camera import FakeSource, Shutter
from fakes.faults import FaultScript
from protocols.observer import LiftObserver
from protocols.pump import LEFT_SHARE, Imprint, Pump, imprint, share_left
from protocols.steps import arm_limit_s
from rig.bench.assembly import build_bench
from rig.config import load_bench

BENCH = load_bench("fake")


class Seen(LiftObserver):
    """An observer that records what it receives."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []

    def touching(self, serial: str) -> bool:
        return False

    def frame(self, frame: Frame) -> None:
        self.frames.append(frame)


def pumped(shutters: list[Shutter], duration_s: float) -> tuple[list[Frame], int]:
    """The frames of three sources with these shutter times, and the start time of the pump."""
    bench, _ = build_bench(BENCH)
    assert isinstance(bench.clock, SimulatedClock)

    def noise(time_ns: int, rng: np.random.Generator) -> np.ndarray:
        return rng.integers(0, 255, (8, 8, 3), dtype=np.uint8)

    sources = [
        FakeSource((f"S{n}",), shutter, noise, bench.clock, FaultScript(), n)
        for n, shutter in enumerate(shutters)
    ]
    tips = tuple(replace(tip, sensor=s) for tip, s in zip(bench.fingertips, sources[:2], strict=True))
    bench = replace(bench, fingertips=tips, camera=sources[2])
    seen = Seen()
    with pumping(bench, seen) as pump:
        began = bench.clock.now_ns()
        pump.run_for(duration_s)
    return seen.frames, began


@contextmanager
def pumping(bench: Bench, observer: LiftObserver | None = None) -> Iterator[Pump]:
    """A started pump of a connected bench."""
    with bench.connection():
        bench.clock.sleep_until(to_ns(0.2))
        pump = Pump(bench, observer or Seen())
        pump.start()
        yield pump


PHASES = st.floats(0.0, 0.016)


@pytest.mark.heavy
@given(PHASES, PHASES, PHASES, st.floats(0.0, 0.0015))
def test_all_frames_of_the_fingertips_are_delivered_in_order_of_capture(
    one: float, two: float, three: float, jitter_s: float
) -> None:
    shutters = [Shutter(60.0, one, jitter_s=jitter_s), Shutter(60.0, two), Shutter(30.0, three, 0.02)]
    frames, began = pumped(shutters, 0.5)
    times = [frame.time_ns for frame in frames if frame.serial != "S2"]
    assert times == sorted(times)
    for serial in ("S0", "S1", "S2"):
        numbers = [frame.sequence for frame in frames if frame.serial == serial]
        assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert max(times) < began + to_ns(0.5 + 0.02 + 2 / 60.0)
    assert frames[-1].time_ns > began + to_ns(0.4)


def test_fingertip_frame_does_not_wait_for_a_slow_camera() -> None:
    bench_late_s = 0.12
    frames, _ = pumped([Shutter(60.0, 0.0), Shutter(60.0, 0.008), Shutter(30.0, 0.004, bench_late_s)], 0.5)
    behind = [
        max((f.time_ns for f in frames[:i] if f.serial != "S2"), default=0) - frame.time_ns
        for i, frame in enumerate(frames)
        if frame.serial == "S2" and i > 20
    ]
    assert min(behind) > to_ns(bench_late_s - 0.02)


@pytest.mark.parametrize("phase_s", [0.0, 0.005, 0.008, 0.014])
def test_camera_picture_is_not_processed_shortly_before_a_fingertip_frame(phase_s: float) -> None:
    tips = [Shutter(60.0, 0.0, jitter_s=0.0), Shutter(60.0, 0.003, jitter_s=0.0)]
    frames, _ = pumped([*tips, Shutter(30.0, phase_s, jitter_s=0.0)], 0.5)
    order = [frame.serial for frame in frames]
    assert order.count("S2") > 10
    assert {before for before, serial in pairwise(order) if serial == "S2"} == {"S1"}


@pytest.mark.parametrize(
    ("kind", "said", "after_s"),
    [("drop", "SIM-C0001", 0.4), ("freeze", r"SIM-C0001: it has repeated its picture for 0\.5 s", 0.8)],
)
def test_silent_or_frozen_camera_is_an_error_while_the_fingertips_continue(
    kind: str, said: str, after_s: float
) -> None:
    bench, _ = build_bench(BENCH)
    with pumping(bench) as pump:
        began_ns = bench.clock.now_ns()
        bench.camera._active = lambda active, index: active == kind  # type: ignore[attr-defined]
        with pytest.raises(StaleFrameError, match=said):
            pump.run_for(2.0)
        assert bench.clock.now_ns() - began_ns < to_ns(after_s)


def test_run_for_ends_after_its_last_frame_is_delivered() -> None:
    late = Shutter(60.0, 0.0, latency_s=0.3)
    frames, began = pumped([late, Shutter(60.0, 0.002), Shutter(30.0, 0.005)], 0.4)
    last = max(frame.time_ns for frame in frames if frame.serial == "S0")
    assert last > began + to_ns(0.4 - 1.2 / 60.0)


def test_frame_of_another_sensor_is_a_fault() -> None:
    bench, _ = build_bench(BENCH)
    sensor = bench.fingertips[0].sensor
    with pumping(bench) as pump:
        pump.run_for(0.2)
        frames = sensor.next_frame
        sensor.next_frame = lambda timeout_s: replace(frames(timeout_s), serial="SIM-D0002")  # type: ignore[method-assign]
        with pytest.raises(DeviceError, match="SIM-D0001: it delivers frames of SIM-D0002"):
            pump.run_for(1.0)


@pytest.mark.heavy
def test_time_limit_names_what_was_missed_and_the_devices_if_frames_are_in_time() -> None:
    with pumping(build_bench(BENCH)[0]) as pump, pytest.raises(DeviceTimeoutError) as raised:
        pump.run_until(lambda: False, 1.5, "the arm did not stop")
    assert str(raised.value).startswith("bench: the arm did not stop within 1.5 s; check the devices")
    assert "if the computer may be overloaded, end other programs on it" in str(raised.value)


def test_time_limit_of_the_arm_follows_a_speed_slider_that_is_moved_during_the_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, state = build_bench(BENCH)[0], FakeArm.state
    moved_ns = to_ns(0.4)

    def with_slider(arm: FakeArm) -> ArmState:
        fraction = 1.0 if bench.clock.now_ns() < moved_ns else 0.1
        return replace(state(arm), speed_fraction=fraction)

    monkeypatch.setattr(FakeArm, "state", with_slider)
    with pumping(bench) as pump, pytest.raises(DeviceTimeoutError, match="within 3 s"):
        pump.run_until(lambda: False, partial(arm_limit_s, 0.3), "the arm did not end the motion")
    assert bench.clock.now_ns() == pytest.approx(to_ns(3.2), abs=to_ns(0.1))


def test_time_limit_names_the_overloaded_computer_if_frames_are_late() -> None:
    bench, _ = build_bench(BENCH)

    class Slow(Seen):
        """An observer that takes longer for a frame than the time between two."""

        def frame(self, frame: Frame) -> None:
            bench.clock.sleep_until(bench.clock.now_ns() + to_ns(0.05))

    with pumping(bench, Slow()) as pump, pytest.raises(DeviceTimeoutError) as raised:
        pump.run_for(2.0)
    said = str(raised.value)
    assert said.startswith(
        "bench: the frames of 2 s were not processed within 5 s; the fingertips' frames are"
    )
    assert "s late: the computer is overloaded; end other programs on it, or set a lower rate_hz" in said


SIZE = (320, 240, 3)


def gel(contact: float = 0.0, light: float = 1.0, drift: float = 0.0, seed: int = 0) -> Image:
    """A gel with noise, a bar-shaped contact, light of some strength, and drifting light across the frame."""
    rng = np.random.default_rng(seed)
    image = rng.normal(110.0, 2.0, SIZE)
    image[140:170, 80:160] += 60.0 * contact
    image *= light * (1.0 + drift * np.linspace(-1.0, 1.0, SIZE[1])[None, :, None])
    return np.clip(image, 0, 255).astype(np.uint8)


def untouched() -> Imprint:
    return np.mean([imprint(gel(seed=seed)) for seed in range(1, 9)], axis=0)


@pytest.mark.heavy
@given(
    light=st.floats(0.7, 1.3),
    drift=st.floats(-0.2, 0.2),
    strength=st.floats(0.2, 1.0),
    seed=st.integers(9, 99),
)
def test_release_is_detected_in_any_light(light: float, drift: float, strength: float, seed: int) -> None:
    held = imprint(gel(strength, seed=100))
    assert share_left(untouched(), held, imprint(gel(0.0, light, drift, seed))) < LEFT_SHARE
    assert share_left(untouched(), held, imprint(gel(strength, light, drift, seed))) > LEFT_SHARE


def test_remaining_imprint_in_the_gel_is_not_a_contact() -> None:
    held = imprint(gel(1.0))
    assert share_left(untouched(), held, imprint(gel(0.3, seed=9))) == pytest.approx(0.3, abs=0.1)
