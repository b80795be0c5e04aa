"""The rule for a settled contact, which every estimator reports, and the series of angles."""

import numpy as np
import pytest

from drivers.clock import to_ns
from rig.contract_checks import gel, pressed_bar
from rig.tactile.angles import FUSED, Angles
from rig.tactile.estimators import ESTIMATORS, choose_estimator
from rig.tactile.sample import SlipSample, State
from rig.tactile.settling import SETTLED_S, Settling, SettlingByArea


def settled_at(levels: list[float], drifting: bool, rate_hz: float) -> list[bool]:
    """Whether a contact with these levels, 30 ms apart and repeated at higher rates, has settled."""
    settling, settled, repeats = Settling(0.06, drifting), [], round(0.03 * rate_hz)
    for frame, level in enumerate(np.repeat(levels, repeats).tolist()):
        settling.update((level,), to_ns(frame / rate_hz))
        settled.append(settling.settled)
    return settled[::repeats]


@pytest.mark.parametrize("rate_hz", [1000.0 / 30.0, 200.0])
def test_slow_drift_settles_only_relative_to_the_previous_frame(rate_hz: float) -> None:
    drift = [100.0 * 1.03**frame for frame in range(6)]
    assert not any(settled_at(drift, False, rate_hz))
    assert settled_at(drift, True, rate_hz) == [False, False, True, True, True, True]


def test_every_level_must_be_constant_to_settle() -> None:
    settling = Settling(0.01)
    changed = []
    for number, levels in enumerate([(100.0, 1.0), (100.0, 1.2), (102.0, 1.2)]):
        settling.update(levels, to_ns(0.02 * number))
        changed.append(settling.changed)
    assert changed == [True, True, False]
    assert settling.settled


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
    frames = [gel(320, 240, 1), *(pressed_bar(20.0, seed) for seed in range(18))]
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


MS = 1_000_000
LATE_NS = 1_700_000_000 * 1000 * MS
"""A clock that counts from 1970: as a float in s it would be off by 0.2 us."""


def samples() -> list[SlipSample]:
    tracking = State.TRACKING
    return [
        SlipSample(LATE_NS + 20 * MS, tracking, 2.0, 0.2, contact_area_px=60.0),
        SlipSample(LATE_NS + 10 * MS + 1, tracking, 1.0, None, contact_area_px=50.0),
        SlipSample(LATE_NS + 30 * MS, State.LOST),
    ]


def test_samples_become_columns_in_order_of_time() -> None:
    angles = Angles.of(samples(), "D1", LATE_NS)
    assert angles.time_ns.tolist() == [LATE_NS + 10 * MS + 1, LATE_NS + 20 * MS, LATE_NS + 30 * MS]
    np.testing.assert_array_equal(angles.angle_deg, [1.0, 2.0, np.nan])
    np.testing.assert_array_equal(angles.sigma_deg, [np.nan, 0.2, np.nan])
    assert angles.states == ("tracking", "tracking", "lost")
    assert angles.contact_area_px.tolist() == [50.0, 60.0, 0.0]
    assert Angles.of(samples(), FUSED).contact_area_px.size == 0


def test_selected_samples_keep_all_columns() -> None:
    angles = Angles.of(samples(), "D1", LATE_NS)
    known = angles.known
    assert (len(known), known.states, known.contact_area_px.size) == (2, ("tracking",) * 2, 2)
    inside = angles.between(LATE_NS + 20 * MS, LATE_NS + 30 * MS)
    assert (inside.angle_deg.tolist(), inside.source, inside.zero_ns) == ([2.0], "D1", LATE_NS)


def test_rotation_since_a_zero_has_the_objects_sign() -> None:
    zero = SlipSample(0, State.TRACKING, 1.0, 0.5, unseen_deg=0.4)
    sample = SlipSample(1, State.TRACKING, 4.0, 0.5, unseen_deg=0.4, rate_deg_s=2.0)
    turned = sample.since_zero(-1, 1.0, zero)
    assert (turned.angle_deg, turned.rate_deg_s) == (-3.0, -2.0)
    assert turned.sigma_deg == pytest.approx(0.3), "rotations before both cancel"
    assert sample.since_zero(1, None, None).angle_deg is None


@pytest.mark.parametrize("zero_ns", [0, LATE_NS])
def test_angle_is_interpolated_over_short_gaps_only(zero_ns: int) -> None:
    series = Angles(np.array([0.0, 0.05, 0.101, 0.111, 0.121]), [1.0, 3.0, 5.0, np.nan, 7.0], zero_ns=zero_ns)
    cases = {-1: None, 0: 1.0, 25: 2.0, 50: 3.0, 60: None, 101: 5.0, 111: 6.0, 121: 7.0, 122: None}
    for time_ms, expected in cases.items():
        found = series.at_ns(zero_ns + time_ms * MS)
        assert found == (None if expected is None else pytest.approx(expected)), time_ms
    assert Angles(np.empty(0), np.empty(0)).at_ns(zero_ns) is None
