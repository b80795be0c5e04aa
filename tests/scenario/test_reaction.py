"""Lifts with a reaction to slip: rows, recordings, replay, rejected settings."""

import csv
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from protocols.reaction import ReactionKind
from rig.benchmark.reaction import times_of
from rig.benchmark.wire.campaign import as_real
from rig.config import load_bench
from rig.experiments.lift_attempt import attempt_lift
from rig.experiments.lift_plan import (
    LiftTask,
    TrialSettings,
    describe_reaction,
    require_reaction,
    stored_trial,
)
from rig.experiments.replay import run_replay
from rig.experiments.trial import run_trial
from rig.lift.slip_watch import SlipSettings
from rig.results.summary import TrialSummary
from rig.sessions.manifest import TrialManifest, read_manifest
from rig.sessions.records import Lift, LiftOutcome
from rig.sessions.rows import read_finished_lifts
from rig.tactile.estimators import choose_estimator
from support.benches import lighter, short_phases
from support.command_line import answer, refusal


def settings(react: str, max_turn_deg: float | None = None) -> TrialSettings:
    slip = SlipSettings(max_turn_deg=max_turn_deg)
    return TrialSettings(lighter(), 0, choose_estimator(), react=ReactionKind(react), slip=slip)


@pytest.fixture(scope="module", autouse=True)
def _short() -> Iterator[None]:
    with short_phases():
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one lift of the toothbrush that tightens."""
    return tmp_path_factory.mktemp("reacting") / "session"


@pytest.fixture(scope="module")
def summary(folder: Path) -> TrialSummary:
    return run_trial(folder, settings("tighten"), ["t2"], 1)


@pytest.fixture(scope="module")
def caught(folder: Path, summary: TrialSummary) -> Lift:
    return read_finished_lifts(folder)[0]


@pytest.mark.heavy
def test_tightening_catches_an_object_that_slips_otherwise(caught: Lift, one_lift: Path) -> None:
    (without,) = read_finished_lifts(one_lift)
    assert without.outcome is LiftOutcome.SLIPPED
    assert abs(without.final_truth_deg) > 10.0
    assert without.reactions is None
    assert caught.outcome is LiftOutcome.CAUGHT
    assert 0.4 < abs(caught.final_truth_deg) < 5.0
    assert caught.lift_height_m == without.lift_height_m


def test_reaction_times_are_read_from_a_session(folder: Path, caught: Lift) -> None:
    soon, *still = times_of(folder, ReactionKind.TIGHTEN)
    assert caught.reactions
    first = caught.reactions[0]
    assert soon.value == pytest.approx(1e3 * (first.command_s - first.event_s), abs=1.0)
    assert soon.met is None
    arm_ms, _, fingers_ms, _ = (row.value or 0.0 for row in still)
    took_ms = 1e3 * (first.standstill_s - first.command_s)
    assert 0.0 < arm_ms < took_ms
    assert fingers_ms == pytest.approx(took_ms - arm_ms, abs=20.0)
    assert len(times_of(folder, ReactionKind.STOP)) == 3


def test_row_has_times_angles_and_counts_of_the_reaction(caught: Lift) -> None:
    assert caught.reactions
    first = caught.reactions[0]
    assert first.serial in caught.contact_area_px
    assert first.event_s < first.onset_s + 0.05
    assert first.event_s <= first.command_s < first.standstill_s <= first.rest_s
    assert 0 < first.counts_added <= 14 - caught.grip_counts
    assert first.onset_turn_deg == pytest.approx(0.5, abs=0.1)
    assert 0.4 < abs(first.rest_turn_deg) < 2.0
    assert set(caught.slip_thresholds or {}) == set(caught.contact_area_px)


@pytest.mark.heavy
def test_replay_of_a_reaction_is_identical_and_counts_the_caught_lifts(folder: Path, caught: Lift) -> None:
    figures = answer("replay", folder, "--jobs", 1)
    assert (figures["identical"], figures["react"], figures["caught"]) == (1, "tighten", 1)


@pytest.mark.heavy
def test_replay_with_other_estimator_has_the_commands_and_no_event(folder: Path, caught: Lift) -> None:
    replay = run_replay(stored_trial(folder, "pca"), jobs=1)
    assert replay.agreement is None
    row = replay.rows[0]
    assert row.reactions
    assert caught.reactions
    assert [r.command_s for r in row.reactions] == [r.command_s for r in caught.reactions]
    assert {r.event_s for r in row.reactions} == {None}


def test_session_with_another_reaction_is_not_continued(folder: Path, summary: TrialSummary) -> None:
    manifest = read_manifest(folder)
    assert isinstance(manifest, TrialManifest)
    assert manifest.react is ReactionKind.TIGHTEN
    with pytest.raises(InputError, match="react"):
        run_trial(folder, settings("stop"), ["t2"], 1, resume=True)


def test_tables_tell_reacting_lifts_apart(folder: Path, summary: TrialSummary) -> None:
    assert (summary.reacting.kind, summary.reacting.caught, summary.reacting.lifts) == ("tighten", 1, 1)
    line = next(csv.DictReader(io.StringIO((folder / "lifts.csv").read_text())))
    assert line["react"] == "tighten"
    assert int(line["counts_added"]) > 0
    assert float(line["reaction_event_s"]) <= float(line["reaction_command_s"])


@pytest.mark.heavy
def test_limit_on_the_turn_delays_the_reaction() -> None:
    row = attempt_lift(settings("tighten", 20.0), LiftTask(1, "t2", 1)).row
    assert row.accepted
    assert row.reactions
    first = row.reactions[0]
    assert first.command_s > first.event_s + 0.02


def test_impossible_or_forbidden_reaction_is_rejected_first() -> None:
    tighten = settings("tighten")
    require_reaction(tighten, ["t1", "t2"])
    require_reaction(settings("none"), ["3"])
    with pytest.raises(InputError, match="no largest_grip_mm"):
        require_reaction(tighten, ["t1", "3"])
    with pytest.raises(InputError, match="estimates no angular rate"):
        require_reaction(replace(tighten, estimator=choose_estimator("pca")), ["t1"])
    real = as_real(load_bench("wire"))
    assert not real.simulated
    with pytest.raises(InputError, match="reactions_allowed = true"):
        require_reaction(replace(tighten, bench=real), ["t1"])
    require_reaction(replace(tighten, bench=real.model_copy(update={"reactions_allowed": True})), ["t1"])
    forbidden = lighter().model_copy(update={"reactions_allowed": False})
    with pytest.raises(InputError, match="does not permit"):
        require_reaction(replace(tighten, bench=forbidden), ["t1"])


def test_plan_lists_what_the_reaction_may_do() -> None:
    text = "\n".join(describe_reaction(settings("tighten", 5.0), ["t1", "t2"]))
    assert "more than 5 degrees" in text
    assert "t1 wrench 74.7, t2 toothbrush 8.7" in text
    assert describe_reaction(settings("none"), ["t1"]) == []


def test_object_without_largest_grip_is_rejected_before_the_session(tmp_path: Path) -> None:
    done = refusal("trial", "--object", "orange", "--react", "tighten", "--out", tmp_path / "s")
    assert "largest_grip_mm" in done
    assert not (tmp_path / "s").exists()
