"""What a device says of itself, where it says anything."""

import math

from drivers.bench import Bench


def test_what_a_device_tells_of_itself_can_be_so(bench: Bench) -> None:
    """Texts, counts, durations below a second, a finite offset or none."""
    for device in (*bench.actuators, *bench.frame_sources):
        assert all(isinstance(text, str) for text in device.identity().values())
        assert all(count >= 0 for count in device.counters().values())
        assert all(0.0 < taken_s < 1.0 for taken_s in device.round_trips_s())
        offset_s = device.clock_offset_s()
        assert offset_s is None or math.isfinite(offset_s)
