"""The loop from frames to samples: arm states, unreadable frames, several estimators, times per frame."""

from pathlib import Path

import numpy as np
import pytest

from calibration.store import CalibrationFile, save
from calibration.verdict import Assessment
from drivers.errors import CalibrationError
from drivers.types import ArmMode, ArmState, Image, Pose
from rig.frames.estimates import (
    Estimate,
    apply_zero,
    contact_ms,
    estimate_frames,
    estimate_series,
    estimate_together,
    figures,
    frame_ms,
    read_scale,
    shift_mm,
)
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.tactile.sample import SlipSample, State, TactileEstimator

IMAGE = np.zeros((40, 30, 3), np.uint8)


class Recorder(TactileEstimator):
    """Records its calls in a list, which several estimators may share."""

    def __init__(self, name: str, calls: list[tuple[str, int]]) -> None:
        self._name, self._calls = name, calls

    def update(self, image: Image, time_ns: int) -> SlipSample:
        self._calls.append((self._name, time_ns))
        return SlipSample(time_ns, State.TRACKING, 1.0)

    def arm(self, state: ArmState) -> None:
        self._calls.append(("arm", state.time_ns))


def frames(*times_ns: int, unreadable: int | None = None) -> list[TimedFrame]:
    times = (FrameTime(f"{time_ns}e-9", time_ns) for time_ns in times_ns)
    return [TimedFrame(time.text, time, None if time.time_ns == unreadable else IMAGE) for time in times]


def test_arm_states_are_passed_before_later_frames() -> None:
    calls: list[tuple[str, int]] = []
    still = Pose((0.0, 0.0, 0.0)), (0.0,) * 6, None, ArmMode.RUNNING
    states = [ArmState(time_ns, *still) for time_ns in (5, 10, 15, 25)]
    list(estimate_frames(Recorder("a", calls), frames(10, 20), states))
    assert calls == [("arm", 5), ("arm", 10), ("a", 10), ("arm", 15), ("a", 20)]


def test_unreadable_frame_is_lost_and_has_no_cost() -> None:
    calls: list[tuple[str, int]] = []
    series = FrameSeries("clip", lambda: iter(frames(1, 2, 3, unreadable=2)))
    found = estimate_series(series, Recorder("a", calls))
    assert calls == [("a", 1), ("a", 3)]
    assert [time.time_ns for time in found.times] == [1, 2, 3]
    assert [of.state for of in found.samples] == [State.TRACKING, State.LOST, State.TRACKING]
    assert [of.cost_s is None for of in found.samples] == [False, True, False]
    assert found.unreadable == 1


def test_each_frame_is_estimated_by_all_estimators_before_the_next() -> None:
    calls: list[tuple[str, int]] = []
    made = {name: Recorder(name, calls) for name in ("a", "b")}
    samples = estimate_together(made, iter(frames(1, 2)))
    assert calls == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]
    assert [[of.time_ns for of in timed] for timed in samples.values()] == [[1, 2]] * 2


def timed(number: int, state: State, cost_s: float | None, jumped: bool = False) -> SlipSample:
    angle_deg = 0.0 if state is State.TRACKING else None
    time_ns = number * 10_000_000
    return SlipSample(time_ns, state, angle_deg, contact_area_px=900.0, jumped=jumped, cost_s=cost_s)


TIMED = [
    *(timed(number, State.NO_CONTACT, 0.0005) for number in range(20)),
    *(timed(20 + number, State.TRACKING, 0.001 * (number + 1)) for number in range(11)),
    timed(31, State.LOST, None),  # could not be read
    timed(32, State.LOST, 0.0001, jumped=True),  # was not processed
    timed(33, State.UNOBSERVABLE, 0.012),
]


@pytest.mark.parametrize(
    ("samples", "expected"), [(TIMED, (6.5, 10.9, 11.89)), (TIMED[:20], (None, None, None))]
)
def test_only_processed_frames_with_contact_are_timed(
    samples: list[SlipSample], expected: tuple[float | None, ...]
) -> None:
    times = tuple(FrameTime(str(sample.time_s), sample.time_ns) for sample in samples)
    found = figures(apply_zero(Estimate(times, tuple(samples)), None))
    assert (found.median_ms, found.p90_ms, found.p99_ms) == pytest.approx(expected)
    assert contact_ms(TIMED) == pytest.approx([float(ms) for ms in range(1, 13)])
    assert frame_ms([]) is None


def test_shift_is_scaled_along_x_and_y_by_the_gel_calibration(tmp_path: Path) -> None:
    def scale(value: dict[str, object]) -> tuple[float, float]:
        file, created = tmp_path / "tactile-D1.yaml", "2026-01-01T00:00:00+00:00"
        save(CalibrationFile("tactile", {"tactile": "D1"}, value, Assessment(), created), file)
        return read_scale(file)

    mm_per_px = scale({"mm_per_px": (0.05, 0.06)})
    assert shift_mm((10.0, -20.0), mm_per_px) == (0.5, -1.2)
    assert shift_mm(None, mm_per_px) == (None, None)
    for damaged in ({"mm_per_px": 0.05}, {}):
        with pytest.raises(CalibrationError, match="holds no mm_per_px; press balls"):
            scale(damaged)
