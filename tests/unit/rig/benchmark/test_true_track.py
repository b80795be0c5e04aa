"""Evaluation of a true track: standstill, distance, dropped objects, and stages of a lift."""

import pytest

from drivers.clock import to_ns
from rig.benchmark.wire.campaign import (
    Moment,
    Stage,
    TrueState,
    at,
    dropped,
    next_stage,
    read_track,
    standstill,
    wait_for,
)

STEP_S = 0.004


def track_of(heights_m: list[float], held: bool = False) -> list[TrueState]:
    """A tool at these heights, one after the other each 4 ms."""
    return [TrueState(to_ns(i * STEP_S), (0.0, 0.0, z), 6.0, held) for i, z in enumerate(heights_m)]


DOWN_AND_STAY = [0.16 - 0.001 * min(i, 50) for i in range(100)]
"""0.25 m/s for 0.2 s, then rest."""


@pytest.mark.parametrize(("event_s", "after_s", "way_m"), [(0.1, 0.1, 0.025), (0.0, 0.2, 0.05), (0.3, 0, 0)])
def test_standstill_and_distance_are_measured(event_s: float, after_s: float, way_m: float) -> None:
    stood = standstill(track_of(DOWN_AND_STAY), to_ns(event_s))
    assert stood.after_s == pytest.approx(after_s, abs=1e-6)
    assert stood.way_m == pytest.approx(way_m, abs=1e-6)
    assert stood.time_ns == to_ns(max(event_s, 0.2))


def test_motion_after_a_rest_is_a_new_motion() -> None:
    on = [*DOWN_AND_STAY, *(0.11 - 0.001 * i for i in range(30))]
    assert standstill(track_of(on), to_ns(0.1)).time_ns == to_ns(0.2)
    back = [*DOWN_AND_STAY[:52], *(0.11 + 0.001 * i for i in range(30)), *([0.14] * 20)]
    assert standstill(track_of(back), to_ns(0.1)).time_ns == to_ns(0.2)


def test_object_released_in_the_air_counts_as_dropped() -> None:
    held = track_of([0.11] * 5, held=True)
    free = TrueState(to_ns(1.0), (0.0, 0.0, 0.11), 6.0, held=False)
    assert dropped([*held, free], grasp_m=0.06)
    assert not dropped([*held, free], grasp_m=0.11)
    assert not dropped(held, grasp_m=0.06)


def test_each_state_holds_until_the_next() -> None:
    samples = [(100, 0.1, 0.2, 0.3, 6.0, False), (200, 0.1, 0.2, 0.4, 7.0, True)]
    track = read_track(lambda command, since_ns: {"samples": samples}, 0)
    assert [at(track, time).counts for time in (0, 100, 199, 200, 999)] == [6.0, 6.0, 6.0, 7.0, 7.0]
    assert at(track, 250).held


LIFT = [
    ((0.30, False, False), None),
    ((0.30, True, False), Stage.APPROACH),
    ((0.16, False, False), Stage.APPROACH),
    ((0.06, True, False), Stage.APPROACH),
    ((0.06, False, False), Stage.GRASP),
    ((0.06, False, True), Stage.GRASP),
    ((0.08, True, True), Stage.LIFT),
    ((0.12, False, True), Stage.HOLD),
    ((0.11, True, True), Stage.LOWER),
    ((0.061, True, True), Stage.RELEASE),
    ((0.06, False, False), Stage.RELEASE),
    ((0.16, False, False), Stage.RELEASE),
]


def world(seen: tuple[float, bool, bool]) -> dict[str, object]:
    return {"tool_m": (0.0, 0.0, seen[0]), "tool_moving": seen[1], "held": seen[2], "now_ns": 1}


def test_stages_follow_one_another() -> None:
    stage = None
    for seen, expected in LIFT:
        stage = next_stage(stage, world(seen), 0.06)
        assert stage is expected


def test_waiting_for_a_moment_ends_with_the_lift() -> None:
    hold, course, left = Moment(Stage.HOLD, 0.0), iter(LIFT), [3, 2, 1, 0]
    assert wait_for(hold, 0.06, lambda _: world(next(course)[0]), lambda: False) is Stage.HOLD
    assert wait_for(hold, 0.06, lambda _: world(LIFT[0][0]), lambda: not left.pop(0)) is None
