"""The newest state of the arm in shared memory, written by the state process and read by other processes.

The memory has two slots for a sample and a counter of samples. The writer fills the slot that does not hold
the newest sample, then increments the counter. So a reader needs no lock and no message, and never waits for
the writer, which the operating system may suspend in the middle of a sample.
"""

import contextlib
import mmap
import os
import struct
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

from drivers.values import Vector3, Vector6

_WORD = 8
"""Bytes of a word of the shared memory."""
_SAMPLE = struct.Struct("<d2q6d6d6d6dd3dd4i2Q")
_COUNT, _POLLED = 0, 1 + 2 * _SAMPLE.size // _WORD
_GUIDING_LOST = _POLLED + 1
"""Word offsets: the counter; the time of the last poll; 1 if guiding by hand was ended by the heartbeat."""
_SIZE = _WORD * (_GUIDING_LOST + 1)


@dataclass(frozen=True, slots=True)
class StateSample:
    """One data package of the arm's controller.

    timestamp_s: time of the controller's clock. received_ns: monotonic time at which this timestamp was first
    seen. sampled_ns: the timestamp converted to the monotonic clock, by the fastest delivery so far. pose:
    x y z in m and rotation vector in rad of the TCP in the base frame. speed: the same per second. wrench: N
    and N m in base axes. payload_kg, payload_cog_m (from the flange): NaN if the controller does not report
    them. speed_fraction: position of the pendant's speed slider, 0 to 1. samples, gaps: number of packages
    received and missed.
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


_values = attrgetter(*(field.name for field in fields(StateSample)))


class SharedState:
    """The shared memory. `fd` is its file descriptor, to pass to the processes that share it."""

    def __init__(self, fd: int | None = None) -> None:
        self.fd = os.memfd_create("arm-state") if fd is None else fd
        if fd is None:
            os.ftruncate(self.fd, _SIZE)
        self._memory = mmap.mmap(self.fd, _SIZE)
        # Written as whole words: `struct` sets a slot to 0 first, and another process could read the 0.
        self._words = memoryview(self._memory).cast("Q")

    def close(self) -> None:
        """Release the memory. Safe to call twice."""
        if not self._memory.closed:
            self._words.release()
            self._memory.close()
            os.close(self.fd)

    def write(self, sample: StateSample) -> None:
        """Publish a sample. Only one process may write."""
        count = self._words[_COUNT]
        flat = [v for value in _values(sample) for v in (value if isinstance(value, tuple) else (value,))]
        _SAMPLE.pack_into(self._memory, _place(count + 1), *flat)
        self._words[_COUNT] = count + 1

    def note_poll(self, time_ns: int) -> None:
        self._note(_POLLED, time_ns)

    def polled_ns(self) -> int:
        """Monotonic time of the newest poll; 0 before the first."""
        return self._words[_POLLED]

    def note_guiding_lost(self, lost: bool) -> None:
        self._note(_GUIDING_LOST, lost)

    def _note(self, word: int, value: int) -> None:
        with contextlib.suppress(ValueError):  # closed
            self._words[word] = value

    def guiding_lost(self) -> bool:
        """Whether guiding by hand was ended because the program did not poll; False after `close`."""
        with contextlib.suppress(ValueError):  # closed
            return bool(self._words[_GUIDING_LOST])
        return False

    def read(self) -> StateSample | None:
        """Return the newest sample; None before the first one and after `close`."""
        try:
            while True:
                count = self._words[_COUNT]
                values = _SAMPLE.unpack_from(self._memory, _place(count))
                if self._words[_COUNT] == count:  # otherwise the slot may have been overwritten meanwhile
                    return _sample(values) if count else None
        except ValueError:  # closed, perhaps by another thread just now
            return None


def _place(count: int) -> int:
    return _WORD + count % 2 * _SAMPLE.size


def _sample(values: tuple[Any, ...]) -> StateSample:
    vectors = (values[i : i + 6] for i in range(3, 27, 6))
    nested = [*values[:3], *vectors, values[27], values[28:31], *values[31:]]
    return StateSample(*nested)
