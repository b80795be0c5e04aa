"""Conversion of the controller's bits and modes to typed errors; shared state; clock map."""

import math
import subprocess
import sys
import threading

import pytest

from drivers.clock import NS_PER_S
from drivers.errors import DeviceError, ProtectiveStopError
from drivers.types import ArmMode, Pose
from drivers.ur5e.processes import ClockMap
from drivers.ur5e.shared_state import SharedState, StateSample
from drivers.ur5e.status import (
    arm_mode,
    from_ur,
    program_reason,
    stop_reason,
    to_ur,
)

SIX = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


def sample(safety: int = 1, mode: int = 7, runtime: int = 2, number: int = 0) -> StateSample:
    vectors, payload = (SIX, SIX, SIX, SIX), (1.5, (0.0, 0.0, 0.08))
    return StateSample(
        1.0 * number, number, number, *vectors, *payload, 1.0, mode, safety, 3, runtime, number, 0
    )


@pytest.mark.parametrize(
    ("safety", "mode", "expected", "error", "said"),
    [
        (1 << 0, 7, ArmMode.RUNNING, None, ""),
        (1 << 1, 7, ArmMode.RUNNING, None, ""),
        (1 << 2 | 1 << 10, 7, ArmMode.PROTECTIVE_STOP, ProtectiveStopError, "protective stop"),
        (1 << 2 | 1 << 6, 3, ArmMode.EMERGENCY_STOP, DeviceError, "emergency stop"),
        (1 << 5, 7, ArmMode.EMERGENCY_STOP, DeviceError, "emergency stop"),
        (1 << 7 | 1 << 10, 3, ArmMode.EMERGENCY_STOP, DeviceError, "emergency stop"),
        (1 << 3, 7, ArmMode.UNKNOWN, DeviceError, "recovery"),
        (1 << 4, 7, ArmMode.UNKNOWN, DeviceError, "safeguard"),
        (1 << 8, 7, ArmMode.UNKNOWN, DeviceError, "violation"),
        (1 << 9, 7, ArmMode.UNKNOWN, DeviceError, "fault"),
        (1 << 10, 7, ArmMode.UNKNOWN, DeviceError, "stopped for safety"),
        (0, 7, ArmMode.UNKNOWN, DeviceError, "safety system"),
        (1, 3, ArmMode.UNKNOWN, DeviceError, "power off"),
        (1, 5, ArmMode.UNKNOWN, DeviceError, "brakes"),
        (1, 99, ArmMode.UNKNOWN, DeviceError, "mode 99"),
    ],
)
def test_safety_bits_and_modes_are_interpreted(
    safety: int, mode: int, expected: ArmMode, error: type[DeviceError] | None, said: str
) -> None:
    state = sample(safety, mode)
    assert arm_mode(state) is expected
    reason = stop_reason(state)
    assert type(reason) is (error or type(None))
    assert said in str(reason)
    assert str(program_reason(state)) == str(reason)
    assert "control program is stopped" in str(program_reason(sample(runtime=1)))


def test_readers_get_the_newest_sample_and_never_a_mix_of_two() -> None:
    board, done = SharedState(), threading.Event()
    assert board.read() is None
    board.write(sample(number=1))
    board.write(sample(number=2))
    assert board.read() == sample(number=2)

    def write() -> None:
        for number in range(3, 4000):
            board.write(sample(number=number))
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    last = 0
    while not done.is_set():
        seen = board.read()
        if seen is not None:
            assert seen.timestamp_s == seen.received_ns == seen.samples >= last
            last = seen.samples
    writer.join()
    board.close()
    board.close()
    assert board.read() is None


READING = """
import sys
from drivers.ur5e.shared_state import SharedState
state = SharedState(int(sys.argv[1]))
least = state.polled_ns()
print(flush=True)
for _ in range(400_000):
    least = min(least, state.polled_ns())
print(least)
"""


@pytest.mark.heavy
def test_poll_time_is_never_read_half_written() -> None:
    """A poll time that was read as 0 stopped an arm although its program polled."""
    state = SharedState()
    state.note_poll(1000)
    command = [sys.executable, "-c", READING, str(state.fd)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(state.fd,)) as reader:
        assert reader.stdout is not None
        reader.stdout.readline()
        while reader.poll() is None:
            for time_ns in range(1000, 2000):
                state.note_poll(time_ns)
        assert int(reader.stdout.read()) >= 1000
    state.close()


def test_sample_time_follows_the_fastest_delivery_and_a_slow_drift() -> None:
    times, offset_ns = ClockMap(), 5 * NS_PER_S
    for cycle in range(2000):
        late_ns = 100_000 + (cycle * 7919 % 13) * 300_000
        dated = times.to_host_ns(cycle * 2_000_000, cycle * 2_000_000 + offset_ns + late_ns)
        assert cycle < 13 or dated == cycle * 2_000_000 + offset_ns + 100_000
    times = ClockMap()
    for second in range(100):
        arrived_ns = second * (NS_PER_S + 50_000) + 200_000  # 50 ppm
        assert 0 <= arrived_ns - times.to_host_ns(second * NS_PER_S, arrived_ns) <= 20 * 50_000


def test_poses_in_the_notation_of_the_controller() -> None:
    pose = Pose((0.1, 0.2, 0.3), (0.6, 0.0, 0.0, 0.8))
    assert to_ur(pose) == pytest.approx((0.1, 0.2, 0.3, 2 * math.acos(0.8), 0.0, 0.0))
    assert from_ur(to_ur(pose)).quaternion_xyzw == pytest.approx(pose.quaternion_xyzw)
