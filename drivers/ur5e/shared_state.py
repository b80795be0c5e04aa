"""The newest state of the arm, in memory that the stream process writes and others read.

There are two places for a sample and a counter of samples: the writer fills the place that is not
the newest, then counts. Reading costs no lock, no message, and never waits for the writer, which
may be stopped in the middle of a sample for as long as the system likes.
"""

import contextlib
import mmap
import os
import struct
from dataclasses import dataclass
from typing import Any

from drivers.values import Vector3, Vector6

_WORD = 8
_SAMPLE = struct.Struct("<d2q6d6d6d6dd3dd4i2Q")
_COUNT, _LOOKED = 0, 1 + 2 * _SAMPLE.size // _WORD
_GUIDING_LOST = _LOOKED + 1
"""Words: the counter, the time of the last look, and 1 if guiding by hand has ended by itself."""
_SIZE = _WORD * (_GUIDING_LOST + 1)


@dataclass(frozen=True, slots=True)
class StateSample:
    """One data package of the arm's controller.

    timestamp_s: the controller's own time. received_ns: monotonic time at which this timestamp was
    first seen; sampled_ns: the timestamp on the monotonic clock, by the fastest delivery so far.
    pose: x y z in m and rotation vector in rad of the TCP in the base; speed likewise per second;
    wrench in N and N m in base axes. payload_kg and payload_cog_m (from the flange) are nan where the
    controller does not tell. speed_fraction: where the pendant's speed slider stands, 0 to 1.
    samples and gaps count packages seen and missed.
    """

    timestamp_s: float
    received_ns: int
    sampled_ns: int
    joints_rad: Vector6
    pose: Vector6
    speed: Vector6
    wrench: Vector6
    payload_kg: float
    payload_cog_m: Vector3
    speed_fraction: float
    robot_mode: int
    safety_bits: int
    status_bits: int
    runtime_state: int
    samples: int
    gaps: int


class SharedState:
    """The shared memory. `fd` is handed on to the processes that share it."""

    def __init__(self, fd: int | None = None) -> None:
        self.fd = os.memfd_create("arm-state") if fd is None else fd
        if fd is None:
            os.ftruncate(self.fd, _SIZE)
        self._memory = mmap.mmap(self.fd, _SIZE)
        # Written whole: `struct` clears a place before it writes there, and another process would read the 0.
        self._words = memoryview(self._memory).cast("Q")

    def close(self) -> None:
        """Let go of the memory. Safe to call twice."""
        if not self._memory.closed:
            self._words.release()
            self._memory.close()
            os.close(self.fd)

    def write(self, sample: StateSample) -> None:
        """Publish a sample; one process writes."""
        count = self._words[_COUNT]
        _SAMPLE.pack_into(
            self._memory,
            _place(count + 1),
            *(sample.timestamp_s, sample.received_ns, sample.sampled_ns),
            *(*sample.joints_rad, *sample.pose, *sample.speed, *sample.wrench),
            *(sample.payload_kg, *sample.payload_cog_m, sample.speed_fraction),
            *(sample.robot_mode, sample.safety_bits, sample.status_bits, sample.runtime_state),
            *(sample.samples, sample.gaps),
        )
        self._words[_COUNT] = count + 1

    def look(self, time_ns: int) -> None:
        """Say that the program that drives the arm looks at it now, monotonic time."""
        with contextlib.suppress(ValueError):  # closed
            self._words[_LOOKED] = time_ns

    def looked_ns(self) -> int:
        """When it looked last; 0 before the first time."""
        return self._words[_LOOKED]

    def note_guiding_lost(self, lost: bool) -> None:
        """Note whether guiding by hand was ended because the program did not look at the arm."""
        with contextlib.suppress(ValueError):  # closed
            self._words[_GUIDING_LOST] = lost

    def guiding_lost(self) -> bool:
        """Whether guiding by hand was ended because the program did not look; False after `close`."""
        with contextlib.suppress(ValueError):  # closed
            return bool(self._words[_GUIDING_LOST])
        return False

    def read(self) -> StateSample | None:
        """The newest sample; None before the first and after `close`."""
        try:
            while True:
                count = self._words[_COUNT]
                values = _SAMPLE.unpack_from(self._memory, _place(count))
                if self._words[_COUNT] == count:  # otherwise its place may have been written anew meanwhile
                    return _sample(values) if count else None
        except ValueError:  # closed, maybe by another thread just now
            return None


def _place(count: int) -> int:
    return _WORD + count % 2 * _SAMPLE.size


def _sample(values: tuple[Any, ...]) -> StateSample:
    timestamp_s, received_ns, sampled_ns, *rest = values
    joints, pose, speed, wrench = (tuple(rest[i : i + 6]) for i in range(0, 24, 6))
    payload_kg, *rest = rest[24:]
    cog = (rest[0], rest[1], rest[2])
    return StateSample(
        timestamp_s, received_ns, sampled_ns, joints, pose, speed, wrench, payload_kg, cog, *rest[3:]
    )
