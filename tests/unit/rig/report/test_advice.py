"""Warnings appear only in their case and contain advice."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from protocols.reaction import ReactionKind
from rig.config.measured_values import FileInUse
from rig.report.advice import trial_notices
from rig.report.session import Trial, read_trial
from rig.report.trial_page import onset_table
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.records import Lift, LiftOutcome, LiftTiming, ReactionRecord, StageTimes
from rig.tactile.angles import FUSED, MARKERS

TURNS_DEG = (12.0, -20.0, 9.0, 15.0, -11.0)
NOW = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def sound(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> Trial:
    """Return a trial without any warnings."""
    folder: Path = drawn_trial(tmp_path_factory.mktemp("advice") / "s", TURNS_DEG, (0.2,) * 5)
    return read_trial(folder, read_manifest_of(folder, TrialManifest, "no trial"))


def texts(trial: Trial) -> str:
    return " ".join(f"[{n.level}] {n.what} {n.advice}" for n in trial_notices(trial, NOW))


def rows_with(trial: Trial, **changes: Any) -> Trial:
    lifts = [replace(lift, **changes) for lift in trial.lifts]
    return replace(trial, lifts=lifts, rows=lifts)


def manifest_with(trial: Trial, **changes: Any) -> Trial:
    return replace(trial, manifest=replace(trial.manifest, **changes))


def estimates_with_sigma(trial: Trial, *divided_by: float) -> Trial:
    """Divide the sigmas of each lift; the last divisor counts for the remaining lifts, too."""
    divisors = [*divided_by, *[divided_by[-1]] * len(trial.lifts)]
    lifts = []
    for lift, by in zip(trial.lifts, divisors, strict=False):
        estimate = replace(lift.estimate, sigma_deg=lift.estimate.sigma_deg / by)
        lifts.append(replace(lift, angles={**lift.angles, FUSED: estimate}))
    return replace(trial, lifts=lifts)


def markers_hidden(trial: Trial) -> Trial:
    lifts = []
    for lift in trial.lifts:
        truth = lift.truth
        seen = truth.select((truth.time_s < 0.5) | (truth.time_s > 1.2))
        lifts.append(replace(lift, angles={**lift.angles, MARKERS: seen}))
    return replace(trial, lifts=lifts)


def slow(trial: Trial) -> Trial:
    timing = LiftTiming(number=1, attempt=0, wall_s=9.0, stages={"total": StageTimes(5.0, 15.0, 40.0)})
    return replace(trial, timing=[timing])


def with_a_fault(trial: Trial) -> Trial:
    fault = "DeviceTimeoutError: gripper: no answer"
    failed = replace(trial.rows[0], accepted=False, outcome=LiftOutcome.FAULT, fault=fault)
    return replace(trial, rows=[*trial.rows, failed])


@pytest.mark.heavy
def test_cause_of_repeated_faults_is_reported_once(sound: Trial) -> None:
    once = with_a_fault(sound)
    failed = once.rows[-1]
    silent = [replace(failed, fault=f"arm: no state for {late} s, again") for late in (0.41, 0.52)]
    said = texts(replace(once, rows=[*once.rows, *silent]))
    assert "3 attempts ended in a rig fault: wrench, lift 1." in said
    assert "The most frequent of 2 causes (2 times): arm: no state for 0.41 s, again" in said
    assert said.count("arm: no state") == 1
    assert "The cause of all: DeviceTimeoutError: gripper: no answer" in texts(once)


@pytest.mark.heavy
def test_sound_trial_has_no_warning(sound: Trial) -> None:
    assert texts(sound) == "[good] Nothing stands out. All checks of this page passed."


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("spoil", "seen", "advice"),
    [
        (lambda t: manifest_with(t, status="running", lifts_per_object=9), "5 of 9 lifts", "--resume"),
        (lambda t: replace(t, lifts=t.lifts[:2]), "Few lifts of wrench (2)", "--lifts 5"),
        (with_a_fault, "1 attempt ended in a rig fault", "gripper: no answer"),
        (lambda t: rows_with(t, outcome=LiftOutcome.FALLEN), "fell in wrench, lift 1", "Grip more firmly"),
        (lambda t: rows_with(t, final_truth_deg=0.4), "Only 0 of 5 lifts turned", "grip less firmly"),
        (
            lambda t: rows_with(t, answered=0.6, states={"tracking": 180, "unobservable": 120}),
            "'unobservable'", "grasp the object elsewhere",
        ),
        (lambda t: rows_with(t, answered=0.6, states={"lost": 120}), "'lost'", "stray light"),
        (lambda t: rows_with(t, dropped={"T1": 30, "T2": 0, "camera": 0}), "T1 150 of 900", "rig doctor"),
        (lambda t: estimates_with_sigma(t, 6.0), "Sigma is too small", "times as wide"),
        (lambda t: estimates_with_sigma(t, 6.0), "beyond 2 sigma in wrench, lift", "inspect the curves"),
        (
            # of one lift in five, so that of all frames less than a tenth is beyond 2 sigma
            lambda t: estimates_with_sigma(t, 20.0, 0.1),
            "beyond 2 sigma in wrench, lift 1 (", "inspect the curves",
        ),
        (lambda t: estimates_with_sigma(t, 0.1), "Sigma is too large", "times as narrow"),
        (
            lambda t: estimates_with_sigma(t, 0.001, 1.0),
            "a sigma of at most 5 degrees in wrench, lift 1 (0%)", "where there are edges",
        ),
        (markers_hidden, "markers were lost", "hide no marker"),
        (slow, "1 frame in 100 takes 40", "which stage"),
        (lambda t: rows_with(t, disagreements={"one pad slips": 200}), "disagree during much", "centre the"),
        (lambda t: rows_with(t, onset_truth_s=None), "event was reported although", "grips more firmly"),
        (lambda t: manifest_with(t, simulated=False), "camera and hand-eye is in use", "rig calibrate"),
    ],
)  # fmt: skip
def test_each_notice_has_observation_and_advice(
    sound: Trial, spoil: Callable[[Trial], Trial], seen: str, advice: str
) -> None:
    found = [n for n in trial_notices(spoil(sound), NOW) if seen in n.what]
    assert len(found) == 1
    assert advice in found[0].advice


@pytest.mark.heavy
def test_small_turns_of_a_reacting_trial_are_not_criticised(sound: Trial) -> None:
    reacting = manifest_with(rows_with(sound, final_truth_deg=0.4), react=ReactionKind.TIGHTEN)
    assert "grip less firmly" not in texts(reacting)


@pytest.mark.heavy
def test_an_old_and_a_weak_calibration_are_named(sound: Trial) -> None:
    used = {
        "hand-eye SIM-C0001": FileInUse(
            file="hand-eye.yaml", sha256="a", created="2026-09-01T00:00:00+00:00", verdict="good"
        ),
        "camera SIM-C0001": FileInUse(
            file="camera.yaml", sha256="b", created="2026-11-20T00:00:00+00:00", verdict="weak"
        ),
    }
    said = texts(manifest_with(sound, calibration=used))
    assert "Old calibrations: hand-eye SIM-C0001 (82 days)." in said
    assert "Weak calibrations: camera SIM-C0001." in said


@pytest.mark.parametrize(("lifts", "ends"), [(4, ["-", "-"]), (5, ["+12", "+48"])])
def test_range_of_onset_delays_needs_five_lifts(
    lift_row: Callable[..., Lift], lifts: int, ends: list[str]
) -> None:
    seen = {"onset_truth_s": 0.3, "onset_alarm_s": None}
    table = onset_table([lift_row(n, onset_estimate_s=0.31 + 0.01 * n, **seen) for n in range(lifts)])
    assert table is not None
    estimated, event = table.rows
    assert (estimated[1], estimated[3:5]) == (f"{lifts} of {lifts}", ends)
    assert event[2:5] == ["-", "-", "-"]


@pytest.mark.heavy
def test_caught_slip_is_no_false_alarm(sound: Trial) -> None:
    reaction = ReactionRecord(
        serial="T1", onset_s=0.15, event_s=0.14, command_s=0.16, standstill_s=0.2, rest_s=0.3,
        counts_added=4, onset_turn_deg=0.5, event_turn_deg=0.4, command_turn_deg=0.6,
        standstill_turn_deg=0.6, rest_turn_deg=0.6,
    )  # fmt: skip
    early = replace(reaction, onset_s=None)
    for reactions, start_s in (((reaction,), 0.15), ((early, reaction), 0.15), ((early,), None)):
        caught = rows_with(
            sound, onset_truth_s=None, onset_alarm_s=0.14, reactions=reactions, outcome=LiftOutcome.CAUGHT,
        )  # fmt: skip
        assert "although nothing slipped" not in texts(caught)
        rows = caught.lifts
        assert {row.slip_start_s for row in rows} == {start_s}
        table = onset_table(rows)
        assert (table is None) == (start_s is None)
        if table is not None:
            event = next(cells for cells in table.rows if cells[0] == "slip event")
            assert event[1:3] == ["5 of 5", "-10"]
            assert event[-1] == "0"
