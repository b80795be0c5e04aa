"""One lift on the simulated bench: its result, how faults end it, and its recording."""

import resource
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import RecordingError
from drivers.types import Frame
from protocols.observer import Phase
from rig.config import BenchConfig
from rig.experiments import lift_plan
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import LiftTask, TrialSettings, new_measurement, plan_lift
from rig.lift.measurement import LiftMeasurement
from rig.lift.result import evaluate_lift
from rig.sessions.reading import show_again
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator
from support.benches import lighter
from support.marks import heavy

TASK = LiftTask(1, "t1", 2)


def settings(estimator: str | None = None, **changes: object) -> TrialSettings:
    config = lighter().model_dump()
    return TrialSettings(BenchConfig.model_validate({**config, **changes}), 0, choose_estimator(estimator))


def fault(device: str, kind: str, at_s: float = 8.0, **more: object) -> TrialSettings:
    """A bench with a fault, and an estimator that takes little time."""
    return settings("pca", faults=[{"device": device, "kind": kind, "at_s": at_s, **more}])


def test_lift_gives_a_result_with_errors_and_counts(one_lift: Path) -> None:
    (row,) = read_finished_lifts(one_lift)
    assert row.outcome is LiftOutcome.SLIPPED
    assert row.simulated is True
    assert row.final_estimate_deg is not None
    assert abs(row.final_truth_deg) > 5.0
    assert np.sign(row.final_estimate_deg) == np.sign(row.final_truth_deg)
    assert row.re_b.mean_deg < 2.0
    assert row.onset_truth_s > 0.0
    assert set(row.dropped.values()) == {0}


@pytest.mark.heavy
def test_another_seed_gives_another_lift(one_lift: Path) -> None:
    other = TrialSettings(settings().bench, 1, choose_estimator("pca"))
    row = attempt_lift(other, LiftTask(1, "t2", 1)).row
    assert row.accepted
    assert row.final_truth_deg != read_finished_lifts(one_lift)[0].final_truth_deg


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("device", "kind", "text"),
    [
        ("arm", "protective_stop", "ProtectiveStopError"),
        ("gripper", "fault", "0x0D"),
        ("tactile", "freeze", "froze"),
        ("SIM-D0002", "disconnect", "SIM-D0002"),
        *heavy(
            ("arm", "disconnect", "connection lost"),
            ("gripper", "blocked", "no contact"),
            ("gripper", "stuck", "instead of"),
            ("gripper", "overshoot", "too far"),
            ("tactile", "drop", "no frame"),
            ("camera", "freeze", "froze"),
        ),
    ],
)
def test_fault_in_mid_lift_is_named_and_gives_no_result(device: str, kind: str, text: str) -> None:
    at_s = {"gripper": 5.5}.get(device, 9.5)
    row = attempt_lift(fault(device, kind, at_s), TASK).row
    assert not row.accepted
    assert row.outcome is LiftOutcome.FAULT
    assert text in row.fault
    assert "[" in row.fault  # how the bench was left


@pytest.mark.heavy
def test_final_angles_of_a_fallen_lift_are_those_before_the_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lift_plan, "plan_lift", lambda *of: replace(plan_lift(*of), grip_steps=2))
    row = attempt_lift(settings(), TASK).row
    assert row.accepted
    assert row.outcome is LiftOutcome.FALLEN
    assert row.final_truth_deg < -1.0  # the object turned in the hand before it fell
    assert row.final_estimate_deg == pytest.approx(row.final_truth_deg, abs=1.0)
    assert row.re_held.frames == row.re.frames  # no error is counted after the fall


@pytest.mark.heavy
def test_dropped_frames_are_counted_and_the_lift_goes_on_in_phases_of_the_stated_length() -> None:
    row = attempt_lift(fault("SIM-D0001", "drop", 9.0, duration_s=0.2), TASK).row
    assert row.accepted
    lengths_s = [row.phases_s[end] - row.phases_s[begin] for begin, end in pairwise(Phase)]
    assert lengths_s[1:] == pytest.approx([3.0, 1.5, 1.2], abs=0.3)
    assert row.dropped["SIM-D0001"] == 4  # of 0.2 s at 20 frames/s


@pytest.fixture
def small_disk() -> Iterator[None]:
    """Limit the files of this process to 2 MB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.heavy
@pytest.mark.usefixtures("small_disk")
def test_full_disk_in_mid_lift_is_an_error_and_the_lift_ends_safely(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"001\.unfinished\.mcap: cannot be written") as raised:
        attempt_lift(settings("pca"), TASK, folder=tmp_path)
    (note,) = raised.value.__notes__
    assert note in ("object set down, fingers open, arm retreated", "nothing held, fingers open, arm risen")


@pytest.mark.heavy
def test_frames_of_noise_give_no_answer(one_lift: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measurement, passed_on = new_measurement(settings()), LiftMeasurement.frame

    def noisy(to: LiftMeasurement, frame: Frame) -> None:
        if frame.serial in to.angle.tips:
            noise = np.random.default_rng(frame.sequence).normal(110, 3, frame.image.shape)
            frame = replace(frame, image=noise.clip(0, 255).astype(np.uint8), jpeg=None)
        passed_on(to, frame)

    monkeypatch.setattr(LiftMeasurement, "frame", noisy)
    show_again(one_lift / "lifts" / "001.mcap", measurement)
    row = evaluate_lift(measurement, read_finished_lifts(one_lift)[0])
    assert row.answered == 0.0
    assert row.re is None
    assert row.final_estimate_deg is None
