"""The contract of a device's diagnostics, if it provides any."""

import math

from drivers.bench import Bench


def test_diagnostics_have_valid_types_and_ranges(bench: Bench) -> None:
    """Identity is text, counters are not negative, durations are below 1 s, the offset is finite or None."""
    for device in (*bench.actuators, *bench.frame_sources):
        assert all(isinstance(text, str) for text in device.identity().values())
        assert all(count >= 0 for count in device.counters().values())
        assert all(0.0 < taken_s < 1.0 for taken_s in device.round_trips_s())
        offset_s = device.clock_offset_s()
        assert offset_s is None or math.isfinite(offset_s)
