"""The definition of a confidently wrong answer, and that `rig benchmark seeds` applies it."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from protocols.observer import Phase
from rig.benchmark import seeds
from rig.benchmark.wrong_answers import is_confidently_wrong
from rig.sessions.recorder import FUSED_TOPIC, RecordedAngle
from rig.sessions.records import FinishedLift


@pytest.mark.parametrize(
    ("error_deg", "sigma_deg", "wrong"),
    [
        (15.0, 4.0, True),  # a sigma above 3 degrees, but more than 3 sigma off
        (-15.0, 4.0, True),
        (15.0, 6.0, False),
        (9.0, 0.1, False),
        (10.0, 0.0, False),
        (10.1, 0.0, True),
        (90.0, None, False),
    ],
)
def test_more_than_10_degrees_and_3_sigma_off_is_confidently_wrong(
    error_deg: float, sigma_deg: float | None, wrong: bool
) -> None:
    assert is_confidently_wrong(error_deg, sigma_deg) is wrong


@pytest.mark.parametrize(("sigma_deg", "count"), [(4.0, 5), (6.0, 0)])
def test_seeds_count_answers_of_any_sigma_that_are_3_sigma_off(
    monkeypatch: pytest.MonkeyPatch, sigma_deg: float, count: int
) -> None:
    angles = [RecordedAngle(time_ns, 15.0, sigma_deg, "tracking") for time_ns in range(5)]
    monkeypatch.setattr(seeds, "phase_times", lambda _: {Phase.LIFT: 0, Phase.HOLD: 3, Phase.LOWER: 5})
    monkeypatch.setattr(seeds, "recorded_truth", lambda _: None)
    monkeypatch.setattr(seeds, "interpolate", lambda _, time_ns: 0.0)
    monkeypatch.setattr(seeds, "recorded_angles", lambda *_: {FUSED_TOPIC: angles})
    row = SimpleNamespace(object="t1", lift=1, recording="lifts/001.mcap", final_truth_deg=0.0)
    lift = seeds._scored(Path(), 0, cast("FinishedLift", row))
    assert lift.confidently_wrong == count
