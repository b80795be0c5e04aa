"""Conversion of the controller's bits and modes to typed errors; shared state; clock map."""

import math
import subprocess
import sys
import threading

import pytest

from drivers.clock import NS_PER_S
from drivers.errors import DeviceError, OutOfLimitsError, ProtectiveStopError
from drivers.motion import check_joints, check_motion
from drivers.types import ArmLimits, ArmMode, Pose
from drivers.ur5e.processes import ClockMap
from drivers.ur5e.shared_state import SharedState, StateSample
from drivers.ur5e.status import (
    JOINT_RANGE_RAD,
    arm_mode,
    from_ur,
    program_reason,
    refused,
    stop_reason,
    to_ur,
)

SIX = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
LIMITS = ArmLimits((0.0, -0.5, 0.0), (0.8, 0.5, 0.6), 0.5, 1.5, 5.0)


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


def test_every_refusal_has_a_cause() -> None:
    assert isinstance(program_reason(sample(safety=1 << 2)), ProtectiveStopError)
    assert "control program is stopped" in str(program_reason(sample(runtime=1)))
    assert program_reason(sample()) is None
    assert "'moveL' was rejected" in str(refused("moveL"))


def test_shared_state_returns_newest_sample_to_every_reader() -> None:
    board = SharedState()
    assert board.read() is None
    board.write(sample(number=1))
    board.write(sample(number=2))
    assert board.read() == sample(number=2)
    board.close()
    board.close()
    assert board.read() is None


def test_readers_never_get_a_mix_of_two_samples() -> None:
    board, done = SharedState(), threading.Event()

    def write() -> None:
        for number in range(1, 4000):
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


def test_sample_time_follows_the_fastest_delivery() -> None:
    times, offset_ns = ClockMap(), 5 * NS_PER_S
    taken_ns = dated = 0
    for cycle in range(2000):
        taken_ns = cycle * 2_000_000
        late_ns = 100_000 + (cycle * 7919 % 13) * 300_000
        dated = times.to_host_ns(taken_ns, taken_ns + offset_ns + late_ns)
    assert dated == taken_ns + offset_ns + 100_000


def test_clock_map_follows_a_slow_drift() -> None:
    times = ClockMap()
    arrived_ns = dated = 0
    for second in range(100):
        drift_ns = second * 50_000  # 50 ppm
        arrived_ns = second * NS_PER_S + drift_ns + 200_000
        dated = times.to_host_ns(second * NS_PER_S, arrived_ns)
    assert 0 <= arrived_ns - dated <= 20 * 50_000


INSIDE = Pose((0.4, 0.0, 0.3))


def test_motion_outside_the_limits_is_rejected() -> None:
    check_motion(LIMITS, INSIDE, 0.1, 0.5)
    for target, speed, acceleration, what in (
        (Pose((0.9, 0.0, 0.3)), 0.1, 0.5, "workspace"),
        (Pose((math.nan, 0.0, 0.3)), 0.1, 0.5, "workspace"),
        (Pose((0.4, 0.0, 0.3), (math.nan, 0.0, 0.0, 1.0)), 0.1, 0.5, "not a valid pose"),
        (INSIDE, 0.6, 0.5, "speed"),
        (INSIDE, 0.0, 0.5, "speed"),
        (INSIDE, math.nan, 0.5, "speed"),
        (INSIDE, 0.1, math.inf, "acceleration"),
    ):
        with pytest.raises(OutOfLimitsError, match=what):
            check_motion(LIMITS, target, speed, acceleration)
    check_joints(SIX, JOINT_RANGE_RAD, INSIDE)
    for joints, what in (((0, 0, 7.0, 0, 0, 0), "joint 3"), (None, "reach")):
        with pytest.raises(OutOfLimitsError, match=what):
            check_joints(joints, JOINT_RANGE_RAD, INSIDE)


def test_poses_in_the_controllers_notation() -> None:
    pose = Pose((0.1, 0.2, 0.3), (0.6, 0.0, 0.0, 0.8))
    assert to_ur(pose) == pytest.approx((0.1, 0.2, 0.3, 2 * math.acos(0.8), 0.0, 0.0))
    assert from_ur(to_ur(pose)).quaternion_xyzw == pytest.approx(pose.quaternion_xyzw)
