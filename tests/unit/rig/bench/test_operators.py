"""The operator is asked before any motion, and not more often than necessary."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from drivers.bench import Bench, Hand
from drivers.errors import DeviceError, InputError, OperatorStopError
from drivers.types import ArmMode, HandState, Holding
from drivers.ur5e.arm import UR5e
from protocols.grasps import TRIAL_OBJECTS, load_grasp_files
from protocols.readiness import make_ready
from rig.bench.assembly import build_bench
from rig.bench.operators import ConsoleOperator
from rig.bench.plan import Plan
from rig.bench.source import StandingBench, session_bench
from rig.config import BenchConfig, load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.record import RecordSettings, recording_plan
from rig.experiments.trial import trial_plan
from rig.tactile.estimators import choose_estimator
from rig.terminal.questions import ask


def real_bench() -> BenchConfig:
    """The bench `wire` as a real one; none of its devices is connected here."""
    wire = load_bench("wire")
    camera = wire.camera.model_copy(update={"address": "/dev/video0"})
    return wire.model_copy(update={"fakes": None, "camera": camera})


def planned(changes: dict[str, dict[str, Any]], objects: list[str]) -> Plan:
    """Return the plan of a trial on a real bench with changed keys."""
    values = real_bench().model_dump()
    for section, changed in changes.items():
        for key, value in changed.items():
            values[section][key] = values[section][key] | value if isinstance(value, dict) else value
    return trial_plan(TrialSettings(BenchConfig.model_validate(values), 0, choose_estimator()), objects, 1)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"arm": {"limits": {"workspace_max_m": (0.75, 0.35, 0.05)}}}, "leaves the workspace"),
        ({"arm": {"limits": {"max_speed_m_s": 0.2}}}, "0.250 m/s is more than 0.2 m/s"),
        ({"table": {"position_m": (0.74, 0.34, 0.25)}}, "it reaches 0.85 m"),
    ],
)
def test_plan_lists_motions_that_would_be_rejected(changes: dict[str, dict[str, Any]], said: str) -> None:
    plan = planned(changes, ["t1"])
    assert len(plan.refused) == 1
    assert plan.refused[0].startswith("t1/1 wrench: ")
    assert said in plan.refused[0]
    assert f"WOULD BE REFUSED: {plan.refused[0]}" in " ".join(plan.text().split())


def test_plan_gives_openings_free_space_and_grips_in_short_lines() -> None:
    stand = {"name": "stand", "min_m": (0.4, -0.7, 0.0), "max_m": (0.5, -0.6, 0.4)}
    values = {**real_bench().model_dump(), "keep_out": (stand,)}
    values["table"]["top_m"] = 0.02
    bench = BenchConfig.model_validate(values)
    texts = [
        trial_plan(TrialSettings(each, 0, choose_estimator()), list(TRIAL_OBJECTS), 5).text()
        for each in (bench, real_bench())
    ]
    assert "fingers open to 120 mm (the hand can 155), and close in steps of 0.62 mm," in texts[0]
    assert "free space: above the table (z > 35 mm); outside stand, (" in texts[0]
    assert "free space: the whole workspace." in texts[1]
    assert (
        "t1/1 wrench, grip 1.9 mm, lift 37 mm: (0.400, 0.000, 0.060) m, turned -0.8 deg about y\n" in texts[0]
    )
    assert max(len(line) for text in texts for line in text.splitlines()) <= 100


def test_object_wider_than_the_opening_is_rejected_before_any_question() -> None:
    values = real_bench().model_dump()
    values["gripper"]["limits"]["max_opening_m"] = 0.090
    bench = BenchConfig.model_validate(values)
    wide = next(f for f in load_grasp_files().values() if max(p.width_m for p in f.position) > 0.09)
    with pytest.raises(InputError, match=r"too wide.*open 90\.0 mm"):
        recording_plan(RecordSettings(bench, 0, wide, 15, 225))
    with pytest.raises(InputError, match=r"object t1 wrench, .*too wide"):
        planned({"gripper": {"limits": {"max_opening_m": 0.015}}}, ["t1"])


def test_nothing_is_connected_before_consent_and_the_question_shows_the_speed_slider(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(UR5e, "speed_fraction", lambda arm: 0.4)
    monkeypatch.setattr("rig.bench.findings.reach", lambda *_: None)
    monkeypatch.setattr(Bench, "connection", lambda bench: pytest.fail("connected"))
    asked: list[str] = []
    person = ConsoleOperator(lambda question: bool(asked.append(question)))
    with (
        session_bench(real_bench(), person, "The arm will move. Begin?") as benches,
        pytest.raises(OperatorStopError, match="nothing was moved"),
    ):
        benches.begin()
    assert "arm speed slider: at 40%" in asked[0]
    assert asked[0].endswith("\nThe arm will move. Begin?")


@pytest.mark.heavy
def test_second_program_on_a_bench_is_refused_before_any_device_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("rig.bench.source.first_findings", lambda *_: [])
    monkeypatch.setattr(Bench, "connection", lambda bench: nullcontext(bench))
    monkeypatch.setattr("rig.bench.source.HandMemory.tips_in_contact", lambda memory, bench: [])
    agreeing = ConsoleOperator(lambda question: True)
    asked = ConsoleOperator(lambda question: pytest.fail(question))
    with session_bench(real_bench(), agreeing, "Begin?") as first:
        first.begin()
        with session_bench(real_bench(), asked, "Begin?") as second:
            with pytest.raises(DeviceError, match="another rig program uses this bench"):
                second.begin()
    with session_bench(real_bench(), agreeing, "Begin?") as third:
        third.begin()


def test_unreadable_devices_are_one_message_and_real_time_lifts_compute_in_one_thread() -> None:
    values = real_bench().model_dump()
    values["arm"]["host"] = values["gripper"]["host"] = "127.0.0.9"
    values["camera"]["address"] = "/dev/video99"
    for tactile in values["tactile"]:
        tactile["address"] = "/dev/video98"
    unreachable, person = BenchConfig.model_validate(values), ConsoleOperator(lambda said: pytest.fail(said))
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        with threadpool_limits(2), session_bench(unreachable, person, "Begin?") as benches:
            with pytest.raises(DeviceError) as raised:
                benches.begin()
            assert cv2.getNumThreads() == 1
            assert {library["num_threads"] for library in threadpool_info()} == {1}
    finally:
        cv2.setNumThreads(before)
    text = str(raised.value)
    assert text.startswith("5 of 5 devices cannot be used, nothing was started: SIM-D0001 reached: ")
    assert text.count("SIM-D0002") == text.count("/dev/video99") == 1
    assert "127.0.0.9" in text


def test_simulated_bench_asks_no_questions() -> None:
    person = ConsoleOperator(lambda _: False)
    with (
        session_bench(load_bench("fake"), person, "Begin?") as benches,
        benches.for_lift(0, "t1/1") as (bench, operator),
    ):
        operator.confirm("Anything?")
        assert bench.arm.state().mode is ArmMode.RUNNING


def test_protective_stop_is_released_only_after_an_inspection() -> None:
    fault = {"device": "arm", "kind": "protective_stop", "at_s": 0.0}
    config = BenchConfig.model_validate({**load_bench("fake").model_dump(), "faults": [fault]})
    bench, _ = build_bench(config)
    refusing = ConsoleOperator(lambda _: False)
    with bench.connection():
        with pytest.raises(OperatorStopError):
            make_ready(bench, refusing)
        assert bench.arm.state().mode is ArmMode.PROTECTIVE_STOP
        make_ready(bench, ConsoleOperator(lambda _: True))
        assert bench.arm.state().mode is ArmMode.RUNNING


@pytest.mark.heavy
def test_objects_are_asked_for_when_they_change_and_after_a_fall(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    operator = ConsoleOperator(lambda question: not asked.append(question))
    for object_id, name in (("t1", "wrench"), ("t1", "wrench"), ("", ""), ("t1", "wrench"), ("7", "spam")):
        if object_id:
            operator.place(object_id, name)
        else:
            operator.note_displaced()
    assert [question.split()[2] for question in asked] == ["t1", "t1", "7"]
    asked.clear()
    standing = standing_bench(monkeypatch, operator, Holding.FREE)
    standing.place_first("t1", "it fell")
    operator.place("t1", "wrench")
    assert len(asked) == 2, "it is not asked for again after the question whether to begin"


def test_agreement_in_advance_covers_only_the_first_object() -> None:
    asked: list[str] = []
    person, unsure = (
        ConsoleOperator(lambda question: bool(asked.append(question)), agreed=True) for _ in range(2)
    )
    person.place("gauge:30", "gauge")
    person.place("gauge:30", "gauge")
    assert asked == []
    unsure.note_displaced()
    for who, said in ((person, r"gauge:30 \(gauge\) may still be there: a person has to place"),
                      (unsure, "fell or may lie anywhere")):  # fmt: skip
        with pytest.raises(OperatorStopError, match=said) as refused:
            who.place("ball:8", "ball")
        assert "--yes" not in str(refused.value)
    assert len(asked) == 2


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("remembered", "why", "asked"),
    [
        (Holding.FREE, "", []),
        (Holding.FREE, "it fell", ["Place object t1 (wrench) on its mark: it fell. Ready?"]),
        (Holding.HELD, "", ["Place object t1 (wrench) on its mark: the hand held wrench when"]),
        (Holding.UNKNOWN, "it fell", []),  # the hand is asked about first, see below
    ],
)
def test_first_object_of_a_resumed_session_is_asked_for_before_the_first_motion(
    monkeypatch: pytest.MonkeyPatch, remembered: Holding, why: str, asked: list[str]
) -> None:
    """Agreement in advance answers only if the last attempt set the object down."""
    said: list[str] = []
    person = ConsoleOperator(lambda question: bool(said.append(question)), agreed=True)
    standing = standing_bench(monkeypatch, person, remembered)
    with pytest.raises(OperatorStopError, match="a person has to place") if asked else nullcontext():
        standing.place_first("t1", why)
    assert [question[: len(start)] for question, start in zip(said, asked, strict=True)] == asked
    if remembered is Holding.UNKNOWN:
        with pytest.raises(OperatorStopError, match="it fell: a person has to place"):
            person.place("t1", "wrench")


def standing_bench(
    monkeypatch: pytest.MonkeyPatch, person: ConsoleOperator, remembered: Holding
) -> StandingBench:
    """Return a bench that counts as real and has begun. remembered: the hand's state by the last program.

    The fingers are open; a hand in an unknown state has closed them since.
    """
    bench, _ = build_bench(load_bench("fake"))
    closed = remembered is Holding.UNKNOWN
    state = HandState(remembered, "wrench", bench.base_T_home, 0.012)
    if closed:
        monkeypatch.setattr("rig.bench.source.check_hand", lambda bench: state)
    monkeypatch.setattr(
        "rig.bench.source.build_real_bench", lambda *_: replace(bench, hand=Hand(state, lambda _: None))
    )
    standing = StandingBench(real_bench(), person, "Begin?")
    standing.begin()
    bench.gripper.activate()
    return standing


def test_agreement_in_advance_answers_no_question_that_needs_an_inspection(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(OperatorStopError, match="--bench FILE --yes"):
        ConsoleOperator(ask).confirm("Begin?")
    person = ConsoleOperator(ask, agreed=True)
    person.confirm("Begin?")
    with pytest.raises(OperatorStopError, match="the person at the bench did not agree") as refused:
        person.look("Is the arm free?")
    said = capsys.readouterr().err
    assert "no terminal" in said
    assert "--yes" not in said + str(refused.value)
