"""Detection of a settled contact while the fingers close in steps with pauses."""

import pytest

from drivers.clock import to_ns
from rig.tactile.settling import Settling

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
