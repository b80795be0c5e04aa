"""The loop from frames to samples: arm states, unreadable frames, several estimators."""

import numpy as np

from drivers.types import ArmMode, ArmState, Image, Pose
from rig.frames.estimates import estimate_frames, estimate_series, estimate_together
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
    return [
        TimedFrame(
            str(time_ns), FrameTime(f"{time_ns}e-9", time_ns), None if time_ns == unreadable else IMAGE
        )
        for time_ns in times_ns
    ]


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
    assert [(time.time_ns, of.state) for time, of in zip(found.times, found.samples, strict=True)] == [
        (1, State.TRACKING),
        (2, State.LOST),
        (3, State.TRACKING),
    ]
    assert [of.cost_s is None for of in found.samples] == [False, True, False]
    assert found.unreadable == 1


def test_each_frame_is_estimated_by_all_estimators_before_the_next() -> None:
    calls: list[tuple[str, int]] = []
    made = {name: Recorder(name, calls) for name in ("a", "b")}
    samples = estimate_together(made, iter(frames(1, 2)))
    assert calls == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]
    assert {name: [of.time_ns for of in timed] for name, timed in samples.items()} == {
        "a": [1, 2],
        "b": [1, 2],
    }
