"""What a minute of `rig benchmark endurance` comes to, and its limits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.clock import NS_PER_S, SystemClock, to_ns
from drivers.types import Frame, Image
from protocols.observer import Phase
from rig.benchmark.wire.endurance import Minute, StillContact, judge_endurance
from rig.config import load_bench

LATE, FAR = "capture to angle, 99th percentile, ms", "farthest angle from the first minute, deg"
MINUTE = Minute(9000, 0, 5.0, 9.0, 0.1, 1.0, 300.0, 20, 40)


def missed(*minutes: Minute) -> list[str]:
    return [limit.name for limit in judge_endurance(list(minutes), 1e3 / 60.0) if not limit.met]


def test_each_limit_can_be_missed() -> None:
    assert missed(MINUTE, MINUTE) == []
    assert missed(MINUTE, replace(MINUTE, dropped=1)) == ["frames dropped"]
    assert missed(replace(MINUTE, p99_ms=17.0), MINUTE) == [LATE]
    assert missed(MINUTE, replace(MINUTE, wander_deg=0.31)) == [FAR]
    assert missed(MINUTE, replace(MINUTE, wander_deg=math.nan)) == [FAR]
    assert missed(MINUTE, replace(MINUTE, answered=0.9)) == ["share of frames answered, worst minute"]
    assert missed(MINUTE, replace(MINUTE, memory_mb=311.0)) == ["growth of memory since the first minute, MB"]
    assert missed(MINUTE, replace(MINUTE, threads=21)) == ["threads more than in the first minute"]
    assert missed(MINUTE, replace(MINUTE, files=41)) == ["open files more than in the first minute"]


def picture(value: int, rng: np.random.Generator) -> Image:
    return np.clip(rng.normal(value, 2.0, (320, 240, 3)), 0, 255).astype(np.uint8)


def test_a_minute_counts_what_came_and_keeps_nothing_of_it() -> None:
    bench, rng = load_bench("wire"), np.random.default_rng(0)
    clock = SystemClock()
    contact = StillContact(bench, clock)
    serials = [tactile.serial for tactile in bench.tactile]

    def show(numbers: list[int]) -> None:
        for number in numbers:
            for serial in (*serials, bench.camera.serial):
                contact.frame(Frame(picture(120, rng), clock.now_ns() - to_ns(0.004), number, serial))

    show([1, 2, 3])
    contact.phase(Phase.GRASP, clock.now_ns())
    show([4, 5])
    first = contact.minute()
    assert (first.frames, first.dropped, first.answered) == (15, 0, 0.0)
    assert math.isnan(first.wander_deg)  # nothing touches
    assert 4.0 <= first.p50_ms <= first.p99_ms < NS_PER_S
    show([6, 9])
    second = contact.minute()
    assert (second.frames, second.dropped) == (6, 6)
    assert second.memory_mb > 10.0
    assert min(second.threads, second.files) >= 1
    assert not contact.touching(serials[0])


def test_wandering_is_from_the_first_minute() -> None:
    """And not from what came before it, while the contact settled."""
    bench = load_bench("wire")
    contact = StillContact(bench, SystemClock())
    for tip in contact._tips.values():
        tip.angles_deg, tip.late_ns = [0.0, 3.0], [1_000_000]
    contact.begin_minute()
    for angles, wander in (([1.0, 1.2], 0.1), ([1.1, 1.6], 0.5)):
        for tip in contact._tips.values():
            tip.angles_deg, tip.late_ns = list(angles), [1_000_000]
        assert contact.minute().wander_deg == pytest.approx(wander)
