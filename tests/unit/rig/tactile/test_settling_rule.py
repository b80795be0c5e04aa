"""The rule for a settled contact, and that every estimator reports it."""

import pytest

from drivers.clock import to_ns
from rig.contract_checks import gel, pressed_bar
from rig.tactile.estimators import ESTIMATORS, choose_estimator
from rig.tactile.settling import SETTLED_S, Settling, SettlingByArea, Steadiness


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


def test_contact_settles_by_its_area_after_frames_and_time_and_again_in_the_next_grasp() -> None:
    rule, found = SettlingByArea(), []
    areas = [0.0] * 3 + [100.0, 200.0] + [300.0] * 20 + [0.0] * 5 + [280.0] * 3 + [0.0] * 40 + [300.0] * 20
    for frame, area in enumerate(areas):
        found.append(rule.update(area, to_ns(frame / 60.0)))
    settled = 5 + round(SETTLED_S * 60.0)
    assert found[:25] == [False] * settled + [True] * (25 - settled)
    assert found[25:33] == [False] * 5 + [True] * 3, "a short gap is the same grasp"
    assert found[73:].index(True) == round(SETTLED_S * 60.0), "a new grasp"


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if name != "toskov"])
def test_every_estimator_reports_when_a_contact_has_settled(name: str) -> None:
    estimator = choose_estimator(name).make(gel(320, 240))
    frames = [gel(320, 240, 1), *(pressed_bar(20.0, seed) for seed in range(14))]
    samples = [estimator.update(image, to_ns(number / 60.0)) for number, image in enumerate(frames)]
    assert [sample.settled for sample in samples[:9]] == [samples[0].settled] + [False] * 8
    assert not samples[0].settled
    assert samples[-1].settled


STEPS_PX = (5800, 13600, 17500, 20700, 23400)
"""Areas of a contact after each count of a closing, from a simulated lift."""


def settled_with(rests_s: float, rate_hz: float) -> int | None:
    """Return the area at which a contact settles that grows in steps `rests_s` apart."""
    settling = Settling()
    rests = [rests_s] * (len(STEPS_PX) - 1) + [0.5]
    areas = [px for px, rest_s in zip(STEPS_PX, rests, strict=True) for _ in range(round(rest_s * rate_hz))]
    for frame, area_px in enumerate(areas):
        if settling.update((area_px, 0.2), to_ns(frame / rate_hz)):
            return area_px
    return None


@pytest.mark.parametrize("rate_hz", [25.0, 30.0, 60.0])
@pytest.mark.parametrize("rests_s", [0.05, 0.12])
def test_pause_between_finger_steps_is_not_settled(rests_s: float, rate_hz: float) -> None:
    assert settled_with(rests_s, rate_hz) == STEPS_PX[-1]


def test_constant_contact_settles_once() -> None:
    assert settled_with(0.3, 60.0) == STEPS_PX[0]
    settling = Settling()
    result = [settling.update((100, 0.2), to_ns(frame / 60.0)) for frame in range(30)]
    assert sum(result) == 1
    assert settling.settled
