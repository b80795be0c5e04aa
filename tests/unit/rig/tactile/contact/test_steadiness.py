"""The rules for touch and for a settled contact."""

from rig.tactile.contact.gate import Steadiness, TouchDebounce


def settled_at(levels: list[float], frames: int, drifting: bool = False) -> list[bool]:
    steadiness = Steadiness(frames, drifting)
    settled = []
    for level in levels:
        steadiness.update((level,))
        settled.append(steadiness.settled)
    return settled


def test_slow_drift_settles_only_relative_to_the_previous_frame() -> None:
    drift = [100.0 * 1.03**frame for frame in range(6)]
    assert not any(settled_at(drift, 3))
    assert settled_at(drift, 3, drifting=True) == [False, False, True, True, True, True]


def test_every_level_must_be_constant_to_settle() -> None:
    steadiness = Steadiness(2)
    assert steadiness.update((100.0, 1.0))
    assert steadiness.update((100.0, 1.2))
    assert not steadiness.update((102.0, 1.2))
    assert steadiness.settled


def test_touch_needs_three_frames_without_a_gap() -> None:
    touch = TouchDebounce()
    seen = []
    for contact in (True, False, True, True, True, False):
        touch.update(contact)
        seen.append(touch.sure)
    assert seen == [False, False, False, True, True, False]
