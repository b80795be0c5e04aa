"""What `rig benchmark safety` draws, and how it judges what moved: by tracks that are made up."""

import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import to_ns
from drivers.errors import InputError
from rig.benchmark.harness import Run
from rig.benchmark.wire import safety
from rig.benchmark.wire.campaign import (
    LASTS_S,
    Moment,
    PlannedRun,
    Stage,
    TrueState,
    at,
    dropped,
    next_stage,
    read_track,
    standstill,
    unasked,
    wait_for,
    wait_for_end,
)
from rig.benchmark.wire.safety import (
    BY_NAME,
    EVENTS,
    SafetyOptions,
    SafetyRun,
    judge_runs,
    measure,
    plan_runs,
    run_safety,
    safety_table,
)

STEP_S = 0.004


def track_of(heights_m: list[float], held: bool = False) -> list[TrueState]:
    """A tool at these heights, one every 4 ms."""
    return [TrueState(to_ns(i * STEP_S), (0.0, 0.0, z), 6.0, held) for i, z in enumerate(heights_m)]


DOWN_AND_STAY = [0.16 - 0.001 * min(i, 50) for i in range(100)]
"""0.25 m/s for 0.2 s, then rest."""


@pytest.mark.parametrize(("event_s", "after_s", "way_m"), [(0.1, 0.1, 0.025), (0.0, 0.2, 0.05), (0.3, 0, 0)])
def test_standstill_and_distance_are_measured(event_s: float, after_s: float, way_m: float) -> None:
    stood = standstill(track_of(DOWN_AND_STAY), to_ns(event_s))
    assert stood.after_s == pytest.approx(after_s, abs=1e-6)
    assert stood.way_m == pytest.approx(way_m, abs=1e-6)
    assert stood.time_ns == to_ns(max(event_s, 0.2))


def test_motion_after_a_rest_is_a_new_motion() -> None:
    on = [*DOWN_AND_STAY, *(0.11 - 0.001 * i for i in range(30))]
    assert standstill(track_of(on), to_ns(0.1)).time_ns == to_ns(0.2)
    back = [*DOWN_AND_STAY[:52], *(0.11 + 0.001 * i for i in range(30)), *([0.14] * 20)]
    assert standstill(track_of(back), to_ns(0.1)).time_ns == to_ns(0.2)


def test_object_released_in_the_air_counts_as_dropped() -> None:
    held = track_of([0.11] * 5, held=True)
    free = TrueState(to_ns(1.0), (0.0, 0.0, 0.11), 6.0, held=False)
    assert dropped([*held, free], grasp_m=0.06)
    assert not dropped([*held, free], grasp_m=0.11)
    assert not dropped(held, grasp_m=0.06)


def test_each_state_holds_until_the_next() -> None:
    samples = [(100, 0.1, 0.2, 0.3, 6.0, False), (200, 0.1, 0.2, 0.4, 7.0, True)]
    track = read_track(lambda command, since_ns: {"samples": samples}, 0)
    assert [at(track, time).counts for time in (0, 100, 199, 200, 999)] == [6.0, 6.0, 6.0, 7.0, 7.0]
    assert at(track, 250).held


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


def world(seen: tuple[float, bool, bool]) -> dict[str, object]:
    return {"tool_m": (0.0, 0.0, seen[0]), "tool_moving": seen[1], "held": seen[2], "now_ns": 1}


def test_stages_follow_one_another() -> None:
    stage = None
    for seen, expected in LIFT:
        stage = next_stage(stage, world(seen), 0.06)
        assert stage is expected


def test_waiting_for_a_moment_ends_with_the_lift() -> None:
    hold, course, left = Moment(Stage.HOLD, 0.0), iter(LIFT), [3, 2, 1, 0]
    assert wait_for(hold, 0.06, lambda _: world(next(course)[0]), lambda: False) is Stage.HOLD
    assert wait_for(hold, 0.06, lambda _: world(LIFT[0][0]), lambda: not left.pop(0)) is None


GRASP_M = 0.06


def test_plain_plan_has_each_event_once_and_full_plan_has_it_once_per_stage() -> None:
    plain = plan_runs(0, full=False)
    assert Counter(run.event.name for run in plain) == Counter(event.name for event in EVENTS)
    assert {run.moment.stage for run in plain} == set(Stage)
    assert all(0.0 <= run.moment.after_s <= LASTS_S[run.moment.stage] for run in plain)
    full = plan_runs(0, full=True)
    cells = Counter((run.event.name, run.moment.stage) for run in full)
    assert set(cells.values()) == {1}
    assert len(cells) == len(EVENTS) * len(Stage)
    assert [run.number for run in full] == [*range(1, len(full) + 1)]
    assert plan_runs(0, full=True) == full
    assert plan_runs(1, full=True) != full


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
    ("event", "track", "motion"),
    [
        ("Ctrl-C", STANDS_HIGH, ""),
        ("Ctrl-C", GOES_DOWN, "the arm moved by 80.0 mm"),  # a free hand does not move
        ("Ctrl-C", SET_DOWN, ""),
        ("kill -9", SET_DOWN, "the arm moved by 40.0 mm"),
        ("Ctrl-C twice", SET_DOWN, "the arm moved by 40.0 mm"),
        ("gripper lost", GOES_DOWN, ""),  # the lift goes on until it is noticed
        ("fingers blocked", SET_DOWN, ""),
        ("fingers blocked", CARRIED, "the object was carried"),
        ("fingers blocked", RISES_HELD, ""),  # the lift itself
        ("Ctrl-C", SIDEWAYS, "the arm moved sideways beside the object"),
        ("gripper lost", SIDEWAYS, "the arm moved sideways beside the object"),
        ("Ctrl-C", CLOSED, "fingers closed"),
        ("SIGSTOP", CLOSED, "the fingers moved by +3 counts"),
        ("SIGSTOP", OPENED, "the fingers moved by -3 counts"),
        ("protective stop", OPENED, ""),  # around something that they do not hold
        ("Ctrl-C", OPENED, ""),
    ],
)
def test_what_moves_after_the_standstill_was_agreed_to_or_is_told(
    event: str, track: list[TrueState], motion: str
) -> None:
    assert unasked(BY_NAME[event], Stage.LIFT, track, to_ns(0.05), GRASP_M) == motion


def test_arm_that_rises_with_the_object_in_the_release_has_carried_it() -> None:
    event = BY_NAME["fingers stuck"]
    assert unasked(event, Stage.RELEASE, RISES_HELD, to_ns(0.05), GRASP_M) == "the object was carried"
    assert unasked(event, Stage.RELEASE, STAYS_DOWN, to_ns(0.05), GRASP_M) == ""


RUN = SafetyRun(
    number=1, event="Ctrl-C", stage=Stage.APPROACH, still_s=0.1, way_mm=5.0, dropped=False, unasked="",
    kept=True, ended=3, said="rig: stopped by the operator",
)  # fmt: skip


LOST = {"event": "camera lost", "stage": Stage.LIFT, "ended": 1, "said": "rig: camera", "still_s": 1.1}


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
        ({"ready": "no"}, ["benches that could not be put in order"]),
        (LOST, []),
        ({"event": "kill -9", "ended": -signal.SIGKILL, "said": ""}, []),
    ],
)
def test_each_limit_can_be_missed(changes: dict[str, Any], missed: list[str]) -> None:
    limits = judge_runs([RUN, replace(RUN, **changes)])
    assert [limit.name for limit in limits if limit.met is False] == missed


def test_the_table_has_the_longest_of_each_stage_and_goes_into_a_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = [RUN, replace(RUN, number=2, still_s=0.2, way_mm=1.0), replace(RUN, number=3, stage=Stage.HOLD)]
    row = next(row for row in safety_table(runs).rows if row[0] == "Ctrl-C")
    assert row == ("Ctrl-C", "3", "0.20, 5.0", "-", "-", "0.10, 5.0", "-", "-", "0", "0", "0")
    monkeypatch.setattr(safety, "run_safety", lambda run, plan: runs)
    section = measure(SafetyOptions(), Run()).section
    assert section.startswith("SIMULATED, 3 runs, seed 0: longest time")
    assert "| Ctrl-C | 3 | 0.20, 5.0 |" in section
    assert section.splitlines()[-1] == "- benches that could not be put in order: 0 (at most 0)"


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
        assert re.fullmatch(said, wait_for_end(program, limit_s), re.DOTALL)


class Place:
    """Stands for a served bench: every run ends as `RUN`."""

    def run(self, planned: PlannedRun) -> SafetyRun:
        return replace(
            RUN, number=planned.number, event=planned.event.name, ready="not" if planned.number > 1 else ""
        )

    def put_in_order(self) -> str:
        return ""


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders for which a bench was served."""
    served: list[Path] = []

    @contextmanager
    def serve(folder: Path, bench: object) -> Iterator[Place]:
        served.append(folder)
        yield Place()

    monkeypatch.setattr(safety, "safety_place", serve)
    return served


def test_runs_are_stored_and_continued_with_resume_only(tmp_path: Path, starts: list[Path]) -> None:
    plan, notes = plan_runs(0, full=False), list[str]()
    first = run_safety(Run(folder=tmp_path, progress=lambda *of: notes.append(of[2])), plan)
    assert [run.number for run in first] == [planned.number for planned in plan]
    assert notes[1].endswith("5.0 mm; not in order: not")
    with pytest.raises(InputError, match="--resume"):
        run_safety(Run(folder=tmp_path), plan)
    assert run_safety(Run(folder=tmp_path, resume=True), plan) == first
    assert len(starts) == 1  # a bench is served only if a run is missing
    for seed, full in ((1, False), (0, True)):
        with pytest.raises(InputError, match="continue with the options that it was begun with"):
            run_safety(Run(seed, folder=tmp_path, resume=True), plan_runs(seed, full))
