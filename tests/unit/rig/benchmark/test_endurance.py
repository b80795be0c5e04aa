"""Measurements of one minute of `rig benchmark endurance`, their limits, and the minute's recording."""

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import NS_PER_S, SystemClock, to_ns
from drivers.errors import RecordingError
from drivers.images import with_jpeg
from drivers.types import Frame
from protocols.observer import Phase
from rig.benchmark.wire.endurance import Minute, MinuteRecordings, StillContact, judge_endurance
from rig.config import load_bench
from rig.experiments.lift_plan import TrialSettings, new_measurement
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State

FAR = "farthest angle from the first minute, deg"
SETTINGS = TrialSettings(load_bench("wire"), 0, choose_estimator())
MINUTE = Minute(9000, 0, 0, 5.0, 9.0, 0.1, 1.0, 280.0, 300.0, 20, 40)


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, []),
        ({"dropped": 1}, ["frames dropped"]),
        ({"jumped": 1}, ["frames whose time jumped"]),
        ({"p99_ms": 900.0}, []),  # depends on the load of the computer
        ({"wander_deg": 0.31}, [FAR]),
        ({"wander_deg": math.nan}, [FAR]),
        ({"answered": 0.9}, ["share of frames answered, worst minute"]),
        ({"memory_mb": 311.0}, ["growth of memory since the first minute, MB"]),
        ({"threads": 21}, ["threads more than in the first minute"]),
        ({"files": 41}, ["open files more than in the first minute"]),
    ],
)
def test_each_limit_can_be_missed(changes: dict[str, Any], missed: list[str]) -> None:
    limits = judge_endurance([MINUTE, replace(MINUTE, **changes)])
    assert [limit.name for limit in limits if limit.met is False] == missed


@pytest.fixture
def recordings(tmp_path: Path) -> Iterator[MinuteRecordings]:
    with closing(MinuteRecordings(tmp_path)) as recordings:
        yield recordings
    assert list(tmp_path.iterdir()) == []  # complete recordings are deleted


def test_minute_counts_its_own_frames_only(recordings: MinuteRecordings) -> None:
    bench, rng = load_bench("wire"), np.random.default_rng(0)
    clock = SystemClock()
    contact = StillContact(new_measurement(SETTINGS), clock, recordings)
    serials = [tactile.serial for tactile in bench.tactile]

    def show(numbers: list[int]) -> None:
        for number in numbers:
            for serial in (*serials, bench.camera.serial):
                picture = np.clip(rng.normal(120.0, 2.0, (320, 240, 3)), 0, 255).astype(np.uint8)
                frame = Frame(picture, clock.now_ns() - to_ns(0.004), number, serial)
                contact.frame(with_jpeg(frame))

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
    assert second.recorded_mb > 0.05
    assert second.memory_mb > 10.0
    assert min(second.threads, second.files) >= 1
    assert not contact.touching(serials[0])


def test_unwritable_recording_ends_the_measurement(tmp_path: Path) -> None:
    (tmp_path / "a_file").touch()
    recordings = MinuteRecordings(tmp_path / "a_file")
    frame = Frame(np.zeros((2, 2, 3), np.uint8), 0, 0, "T1", b"x" * 200_000)
    with pytest.raises(RecordingError, match=r"000001\.mcap"):
        recordings.recorder.frame(frame)


def test_wander_is_measured_from_the_first_minute(recordings: MinuteRecordings) -> None:
    """Angles from before the first minute, while the contact settles, do not count."""
    measurement = new_measurement(SETTINGS)
    contact = StillContact(measurement, SystemClock(), recordings)

    def turn(*angles_deg: float) -> None:
        for tip in measurement.angle.tips.values():
            tip.samples += [SlipSample(0, State.TRACKING, angle) for angle in angles_deg]
        for late in contact.late_ns.values():
            late.append(1_000_000)

    turn(0.0, 3.0)
    contact.begin_minute()
    for angles, wander in (([1.0, 1.2], 0.1), ([1.1, 1.6], 0.5)):
        turn(*angles)
        assert contact.minute().wander_deg == pytest.approx(wander)
