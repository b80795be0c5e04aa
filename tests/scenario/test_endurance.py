"""A few seconds of `rig benchmark endurance`, in real time, with the real drivers."""

import pytest

from rig.benchmark.wire.endurance import WANDER_DEG, Minute, measure_endurance
from rig.config import BenchConfig

pytestmark = [pytest.mark.real_time, pytest.mark.long]


def test_a_still_contact_keeps_its_angle_and_loses_no_frame(unhurried_bench: BenchConfig) -> None:
    seen: list[tuple[int, Minute]] = []
    told = measure_endurance(2, lambda *minute: seen.append(minute), unhurried_bench, minute_s=3.0)
    assert seen == list(enumerate(told, start=1))
    rate_hz = sum(tactile.rate_hz for tactile in unhurried_bench.tactile) + unhurried_bench.camera.rate_hz
    for minute in told:
        assert minute.dropped == 0
        assert minute.frames == pytest.approx(3.0 * rate_hz, rel=0.1)
        assert minute.answered > 0.95
        assert minute.wander_deg < WANDER_DEG
    assert told[-1].threads == told[0].threads
    assert told[-1].files == told[0].files
