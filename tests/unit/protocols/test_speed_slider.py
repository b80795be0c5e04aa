"""Motions get more time if the arm's speed slider slows them, as in the first lift with a new object."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivers.motion import Motion
from drivers.types import ArmState, Holding, Pose
from fakes.devices.arm import FakeArm

SLIDER = 0.1


@pytest.fixture
def slowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow all motions of simulated arms in time, as the slider on the pendant does."""
    moved, state = FakeArm.move_linear, FakeArm.state

    def move_linear(arm: FakeArm, base_T_tcp: Pose, speed: float, acceleration: float) -> Motion:  # noqa: N803
        return moved(arm, base_T_tcp, SLIDER * speed, SLIDER**2 * acceleration)

    def with_slider(arm: FakeArm) -> ArmState:
        return replace(state(arm), speed_fraction=SLIDER)

    monkeypatch.setattr(FakeArm, "move_linear", move_linear)
    monkeypatch.setattr(FakeArm, "state", with_slider)


@pytest.mark.heavy
@pytest.mark.usefixtures("slowed")
def test_lift_at_a_tenth_of_the_speed_is_completed(lift_of: Callable[..., Any]) -> None:
    lift = lift_of()
    assert lift.run() == "done"
    assert lift.bench.hand.state.holding is Holding.FREE
