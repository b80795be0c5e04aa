"""What `rig benchmark safety` draws, and how it judges what moved: by tracks that are made up."""

import re
import signal
import subprocess
import sys
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import to_ns
from drivers.errors import InputError
from rig.benchmark.harness import Run
from rig.benchmark.wire import campaign, safety
from rig.benchmark.wire.campaign import PlannedRun, Stage, TrueState
from rig.benchmark.wire.safety import BY_NAME, EVENTS, SafetyRun, plan_runs, run_safety

GRASP_M = 0.06


def way(
    *points: tuple[float, float], held: bool = False, counts: float = 6.0, x_m: float = 0.0
) -> list[TrueState]:
    """A tool at heights above the grasp at times, each reached on a straight way in steps of 4 ms."""
    states = []
    for (begin_s, begin_m), (end_s, end_m) in pairwise(points):
        steps = round((end_s - begin_s) / 0.004)
        for i in range(steps + 1):
            z_m = GRASP_M + begin_m + (end_m - begin_m) * i / steps
            states.append(TrueState(to_ns(begin_s) + i * to_ns(0.004), (x_m, 0.0, z_m), counts, held))
    return states


DOWN = way((0.0, 0.1), (0.2, 0.05), (0.4, 0.05))
AGAIN = [*DOWN, *way((0.404, 0.05), (0.504, 0.025))]
BACK = way((0.0, 0.1), (0.2, 0.05), (0.208, 0.05), (0.308, 0.08), (0.4, 0.08))


@pytest.mark.parametrize(
    ("track", "event_s", "after_s", "way_m"),
    [(DOWN, 0.1, 0.1, 0.025), (DOWN, 0.0, 0.2, 0.05), (DOWN, 0.3, 0, 0), (AGAIN, 0.1, 0.1, 0.025),
     (BACK, 0.1, 0.1, 0.025)],
)  # fmt: skip
def test_first_standstill_after_an_event_is_measured(
    track: list[TrueState], event_s: float, after_s: float, way_m: float
) -> None:
    stood = campaign.standstill(track, to_ns(event_s))
    assert (stood.after_s, stood.way_m) == pytest.approx((after_s, way_m), abs=1e-6)
    assert stood.time_ns == to_ns(max(event_s, 0.2))


def test_object_released_in_the_air_counts_as_dropped() -> None:
    held = way((0.0, 0.05), (0.02, 0.05), held=True)
    fallen = [*held, *way((1.0, 0.05), (1.02, 0.05))]
    assert campaign.was_dropped(fallen, GRASP_M)
    assert not campaign.was_dropped(fallen, GRASP_M + 0.05)
    assert not campaign.was_dropped(held, GRASP_M)


def test_each_state_holds_until_the_next() -> None:
    samples = [(100, 0.1, 0.2, 0.3, 6.0, False), (200, 0.1, 0.2, 0.4, 7.0, True)]
    track = campaign.read_track(lambda command, since_ns: {"samples": samples}, 0)
    assert [campaign.state_at(track, time).counts for time in (0, 100, 199, 200, 999)] == [
        6.0,
        6.0,
        6.0,
        7.0,
        7.0,
    ]
    assert campaign.state_at(track, 250).held


LIFT = [
    ((0.30, False, False), None),
    ((0.30, True, False), Stage.APPROACH),
    ((0.16, False, False), Stage.APPROACH),
    ((0.06, True, False), Stage.APPROACH),
    ((0.06, False, False), Stage.GRASP),
    ((0.06, False, True), Stage.GRASP),
    ((0.08, True, True), Stage.LIFT),
    ((0.12, False, True), Stage.HOLD),
    ((0.11, True, True), Stage.LOWER),
    ((0.061, True, True), Stage.RELEASE),
    ((0.06, False, False), Stage.RELEASE),
    ((0.16, False, False), Stage.RELEASE),
]


def test_stages_follow_one_another_and_waiting_for_one_ends_with_the_lift() -> None:
    worlds, stage = [], None
    for (z_m, moving, held), expected in LIFT:
        worlds.append({"tool_m": (0.0, 0.0, z_m), "tool_moving": moving, "held": held, "now_ns": 1})
        stage = campaign.next_stage(stage, worlds[-1], GRASP_M)
        assert stage is expected
    hold, course, left = (Stage.HOLD, 0.0, GRASP_M), iter(worlds), [3, 2, 1, 0]
    assert campaign.wait_for(*hold, lambda _: next(course), lambda: False) is Stage.HOLD
    assert campaign.wait_for(*hold, lambda _: worlds[0], lambda: not left.pop(0)) is None


def test_plain_plan_has_each_event_once_and_full_plan_has_it_once_per_stage() -> None:
    plain, full = plan_runs(0, full=False), plan_runs(0, full=True)
    assert Counter(run.event.name for run in plain) == Counter(event.name for event in EVENTS)
    assert {run.stage for run in plain} == set(Stage)
    assert all(0.0 <= run.after_s <= campaign.LASTS_S[run.stage] for run in plain)
    cells = Counter((run.event.name, run.stage) for run in full)
    assert set(cells.values()) == {1}
    assert len(cells) == len(EVENTS) * len(Stage)
    assert [run.number for run in full] == [*range(1, len(full) + 1)]
    assert plan_runs(0, full=True) == full != plan_runs(1, full=True)
    (one,) = plan_runs(0, False, [BY_NAME["arm silent"]])
    assert one.event.name == "arm silent"


def test_names_of_events_are_unique_and_faults_cover_every_device() -> None:
    assert len(BY_NAME) == len(EVENTS)
    devices = {device for event in EVENTS for device, *_ in event.faults}
    assert devices == {"arm", "gripper", "SIM-D0001", "camera"}


@pytest.mark.parametrize(
    ("options", "said"),
    [({"events": ["elbow"]}, "no event contains elbow"), ({"bench": "fake"}, "starts itself")],
)
def test_unknown_event_and_bench_without_fakes_are_rejected(
    options: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        safety.measure(safety.SafetyOptions(**options), Run(folder=tmp_path / "s"))
    assert not list(tmp_path.iterdir())


STANDS_HIGH = way((0.0, 0.09), (0.1, 0.08), (2.0, 0.08))
GOES_DOWN = way((0.0, 0.09), (0.1, 0.08), (1.0, 0.08), (1.3, 0.0), (2.0, 0.0))
SET_DOWN = way((0.0, 0.03), (0.1, 0.04), (0.5, 0.04), (0.9, 0.0), (1.5, 0.0), held=True)
SIDEWAYS = [*way((0.0, 0.03), (0.5, 0.03)), *way((0.6, 0.03), (1.0, 0.03), x_m=0.01)]
CARRIED = way((0.0, 0.03), (0.4, 0.0), (1.0, 0.0), (1.3, 0.1), held=True)
STAYS_DOWN = way((0.0, 0.0), (1.0, 0.0), held=True)
RISES_HELD = way((0.0, 0.0), (1.0, 0.0), (1.3, 0.1), held=True)
CLOSED = [*way((0.0, 0.0), (0.5, 0.0)), *way((0.6, 0.0), (1.0, 0.0), counts=9.0)]
OPENED = [*way((0.0, 0.0), (0.5, 0.0), counts=9.0), *way((0.6, 0.0), (1.0, 0.0), counts=6.0)]


@pytest.mark.parametrize(
    ("event", "track", "motion", "stage"),
    [
        ("Ctrl-C", STANDS_HIGH, "", Stage.LIFT),
        ("Ctrl-C", GOES_DOWN, "the arm moved by 80.0 mm", Stage.LIFT),  # a free hand does not move
        ("Ctrl-C", SET_DOWN, "", Stage.LIFT),
        ("kill -9", SET_DOWN, "the arm moved by 40.0 mm", Stage.LIFT),
        ("Ctrl-C twice", SET_DOWN, "the arm moved by 40.0 mm", Stage.LIFT),
        ("gripper lost", GOES_DOWN, "", Stage.LIFT),  # the lift goes on until it is noticed
        ("fingers blocked", SET_DOWN, "", Stage.LIFT),
        ("fingers blocked", CARRIED, "the object was carried", Stage.LIFT),
        ("fingers blocked", RISES_HELD, "", Stage.LIFT),  # the lift itself
        ("fingers stuck", RISES_HELD, "the object was carried", Stage.RELEASE),
        ("fingers stuck", STAYS_DOWN, "", Stage.RELEASE),
        ("Ctrl-C", SIDEWAYS, "the arm moved sideways beside the object", Stage.LIFT),
        ("gripper lost", SIDEWAYS, "the arm moved sideways beside the object", Stage.LIFT),
        ("Ctrl-C", CLOSED, "fingers closed", Stage.LIFT),
        ("SIGSTOP", CLOSED, "the fingers moved by +3 counts", Stage.LIFT),
        ("SIGSTOP", OPENED, "the fingers moved by -3 counts", Stage.LIFT),
        ("protective stop", OPENED, "", Stage.LIFT),  # around something that they do not hold
        ("Ctrl-C", OPENED, "", Stage.LIFT),
    ],
)
def test_forbidden_motion_after_the_standstill_is_named(
    event: str, track: list[TrueState], motion: str, stage: Stage
) -> None:
    assert campaign.find_unasked_motion(BY_NAME[event], stage, track, to_ns(0.05), GRASP_M) == motion


RUN = SafetyRun(
    number=1, event="Ctrl-C", stage=Stage.APPROACH, still_s=0.1, way_mm=5.0, dropped=False, unasked="",
    kept=True, ended=3, said="rig: stopped by the operator",
)  # fmt: skip
FAULT = "DeviceError: SIM-C0001: no frame for 0.25 s"
LOST = {"event": "camera lost", "stage": Stage.LIFT, "ended": 1, "said": "rig: camera", "fault": FAULT}
UNNOTICED = "faults in mid-lift not noticed or not named"


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, []),
        ({"dropped": True}, ["objects dropped"]),
        ({"unasked": "the arm moved"}, ["runs in which something moved unasked"]),
        ({"kept": False}, ["finished lifts lost"]),
        ({"still_s": 9.0}, []),  # depends on the load of the computer
        ({"way_mm": 20.1}, ["way to standstill in the approach, mm"]),
        ({"way_mm": 20.1, "stage": Stage.LIFT}, []),
        ({"ended": 1, "said": "Traceback ..."}, ["programs that ended without a reason"]),
        ({"not_continued": "no"}, ["next lifts that did not run"]),
        (LOST | {"still_s": 1.1}, []),
        (LOST | {"fault": "DeviceError: gripper"}, [UNNOTICED]),
        (LOST | {"fault": ""}, [UNNOTICED]),
        (LOST | {"fault": "", "stage": Stage.RELEASE}, []),  # the lift no longer needs the camera
        (LOST | {"dropped": True}, ["objects dropped"]),
        ({"event": "kill -9", "ended": -signal.SIGKILL, "said": ""}, []),
    ],
)
def test_each_limit_can_be_missed(changes: dict[str, Any], missed: list[str]) -> None:
    limits = safety.judge_runs([RUN, replace(RUN, **changes)])
    assert [limit.name for limit in limits if limit.met is False] == missed


def test_table_has_the_longest_of_each_stage_and_goes_into_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [RUN, replace(RUN, number=2, still_s=0.2, way_mm=1.0), replace(RUN, number=3, stage=Stage.HOLD)]
    runs += [replace(RUN, event="camera lost", dropped=True, not_continued="no")]
    monkeypatch.setattr(safety, "run_safety", lambda *_: runs)
    report = safety.measure(safety.SafetyOptions(), Run())
    first, second = report.tables[0].rows
    assert first == ("Ctrl-C", "3", "0.20, 5.0", "-", "-", "0.10, 5.0", "-", "-", "0", "0", "0", "3 of 3")
    assert second[-4:] == ("1", "0", "0", "0 of 1")
    assert report.section.startswith("SIMULATED, 4 runs, seed 0: longest time")
    assert "| Ctrl-C | 3 | 0.20, 5.0 |" in report.section
    assert report.section.splitlines()[-1] == "- next lifts that did not run: 1 (at most 0)"


@pytest.mark.parametrize(
    ("code", "limit_s", "said"),
    [
        ("print('a'); print('b  '); print()", 60.0, "b"),
        ("1 / 0", 60.0, "Traceback .*ZeroDivisionError: division by zero"),
        ("import time; time.sleep(60)", 0.1, "did not end within 0 s"),
        ("", 60.0, ""),
    ],
)
def test_last_line_of_a_program_or_its_traceback_is_returned(code: str, limit_s: float, said: str) -> None:
    script = f"import sys; sys.stdout = sys.stderr; {code}"
    with subprocess.Popen(
        [sys.executable, "-c", script], stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as program:
        assert re.fullmatch(said, campaign.wait_for_end(program, limit_s), re.DOTALL)


def test_runs_are_stored_and_continued_with_resume_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def result(planned: PlannedRun) -> SafetyRun:
        reason = "no" if planned.number > 1 else ""
        return replace(RUN, number=planned.number, event=planned.event.name, not_continued=reason)

    served: list[Path] = []
    place = nullcontext(SimpleNamespace(run=result, put_in_order=lambda: ""))
    monkeypatch.setattr(safety, "safety_place", lambda folder, _: served.append(folder) or place)
    plan, notes = plan_runs(0, full=False), list[str]()
    first = run_safety(Run(folder=tmp_path, progress=lambda *of: notes.append(of[2])), plan)
    assert [run.number for run in first] == [planned.number for planned in plan]
    assert notes[1].endswith("5.0 mm; not continued: no")
    with pytest.raises(InputError, match="--resume"):
        run_safety(Run(folder=tmp_path), plan)
    assert run_safety(Run(folder=tmp_path, resume=True), plan) == first
    assert len(served) == 1  # a bench is served only if a run is missing
    for seed, full in ((1, False), (0, True)):
        with pytest.raises(InputError, match="continue with the options that it was begun with"):
            run_safety(Run(seed, folder=tmp_path, resume=True), plan_runs(seed, full))
