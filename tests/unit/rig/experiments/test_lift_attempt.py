"""One attempt at a lift: its row, its reaction, and an arm without a force sensor."""

from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.bench import Bench
from drivers.errors import DeviceError
from drivers.types import ArmState
from fakes.devices.arm import FakeArm
from protocols.operator import Operator
from protocols.reaction import Reaction, ReactionKind
from rig.bench.source import BenchSource
from rig.config import BenchConfig
from rig.config.objects import parse_object
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings
from rig.sessions.reading import recorded_arm_states
from rig.tactile.estimators import choose_estimator
from support.benches import short_phases


def test_row_has_the_speed_slider_fraction(light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    state = FakeArm.state

    def slid(arm: FakeArm) -> ArmState:
        return replace(state(arm), speed_fraction=0.4)

    def fail(*_: object) -> None:
        raise DeviceError("arm: gone")

    monkeypatch.setattr(FakeArm, "state", slid)
    monkeypatch.setattr("rig.experiments.lift_attempt.run_lift", fail)
    attempt = attempt_lift(TrialSettings(light_bench, 0, choose_estimator()), LiftTask(1, "t1", 1))
    assert attempt.row.speed_fraction == 0.4


class _Unreachable(BenchSource):
    def for_lift(self, *_: object) -> AbstractContextManager[tuple[Bench, Operator]]:
        raise DeviceError("arm: no connection")


def test_lift_without_a_bench_is_a_fault_without_duration(light_bench: BenchConfig) -> None:
    settings = TrialSettings(light_bench, 0, choose_estimator())
    attempt = attempt_lift(settings, LiftTask(1, "t1", 1), _Unreachable())
    assert attempt.fault == "DeviceError: arm: no connection"
    assert attempt.row.bench_s == 0.0
    assert attempt.files == {}


CUP = """id = "cup"
name = "blue cup"
orientations_deg = [0]
grip_mm = [1.24, 2.49]
largest_grip_mm = 10.58

[[position]]
name = "middle"
offset_m = 0.01
width_m = 0.03
surface = "flat"
lift_height_m = 0.05
"""


def test_reaction_uses_the_largest_grip_of_a_user_defined_object(
    light_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    reactions: list[Reaction] = []

    def lift(*given: Any) -> None:
        reactions.append(given[3])
        raise DeviceError("arm: gone")

    monkeypatch.setattr("rig.experiments.lift_attempt.run_lift", lift)
    bench = light_bench.model_copy(update={"objects": (parse_object(CUP, "cup.toml"),)})
    settings = TrialSettings(bench, 0, choose_estimator(), react=ReactionKind.TIGHTEN)
    assert attempt_lift(settings, LiftTask(1, "cup", 1)).row.object == "cup"
    assert reactions[0].largest_grip_steps == 17


@pytest.mark.heavy
@pytest.mark.parametrize("estimator", ["toskov", pytest.param("slip", marks=pytest.mark.heavy)])
def test_lift_of_an_arm_without_force_sensor_is_recorded_without_a_wrench(
    light_bench: BenchConfig, tmp_path: Path, estimator: str
) -> None:
    arm = light_bench.arm.model_copy(update={"force_sensor": False})
    bench = light_bench.model_copy(update={"arm": arm})
    settings = TrialSettings(bench, 0, choose_estimator(estimator))
    with short_phases():
        attempt = attempt_lift(settings, LiftTask(1, "t1", 1), folder=tmp_path)
    assert attempt.row.accepted
    (recording,) = attempt.files.values()
    states = list(recorded_arm_states(recording))
    assert states
    assert {state.wrench for state in states} == {None}
