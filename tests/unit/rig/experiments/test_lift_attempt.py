"""One attempt at a lift: what its row says of the bench."""

from dataclasses import replace

import pytest

from drivers.errors import DeviceError
from drivers.types import ArmState
from fakes.devices.arm import FakeArm
from rig.config import BenchConfig
from rig.experiments.lift_attempt import LiftTask, TrialSettings, attempt_lift
from rig.tactile.estimators import choose_estimator


def test_the_row_says_where_the_speed_slider_stood(
    light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = FakeArm.state

    def slid(arm: FakeArm) -> ArmState:
        return replace(state(arm), speed_fraction=0.4)

    def fail(*_: object) -> None:
        raise DeviceError("arm: gone")

    monkeypatch.setattr(FakeArm, "state", slid)
    monkeypatch.setattr("rig.experiments.lift_attempt.run_lift", fail)
    attempt = attempt_lift(TrialSettings(light_bench, 0, choose_estimator()), LiftTask(1, "t1", 1))
    assert attempt.row.speed_fraction == 0.4
