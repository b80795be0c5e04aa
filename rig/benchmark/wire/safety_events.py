"""The events of `rig benchmark safety`: the program under test, and the motions allowed after each event."""

import math
import os
import random
import resource
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from drivers.children import python_command
from drivers.errors import DeviceError
from protocols.safe_end import REACH_M
from protocols.steps import CLEARANCE_M
from rig.benchmark.wire.world import (
    Moment,
    Stage,
    Standstill,
    TrueState,
    at,
    bench_ns,
    carried,
    dropped,
    let_pass,
    random_moment,
    standstill,
)
from rig.config import BenchConfig

MOVED_M = 0.001
LINE_M = 0.002
"""Distance from the line above the grasp beyond which the tool is beside it."""
BOUNDARY_M = 0.005
"""Tolerance around the height above which a hand counts as free; within it both safe ends are accepted."""
COUNTS = 1.5
"""Largest difference in counts at which the fingers count as unmoved."""
FINGERS_REST_S = 0.1


class After(StrEnum):
    """Motions that are allowed after the arm has come to a standstill.

    STAYS: none. SAFE_END: those of `protocols.safe_end` for a hand that is free, around an object or holding
    one. NOTICED: the agreed lift continues until the event is detected; then the safe end. FINGERS: the same,
    but the event can only be detected at the next motion of the fingers, so there is no time limit.
    """

    STAYS = "stays"
    SAFE_END = "safe end"
    NOTICED = "noticed"
    FINGERS = "at the next finger motion"


@dataclass(frozen=True, slots=True)
class Event:
    """An event. signals: to the program, in order. fault: device and kind. disk_full: writing fails."""

    name: str
    after: After
    signals: tuple[signal.Signals, ...] = ()
    fault: tuple[str, str] | None = None
    disk_full: bool = False


EVENTS = (
    Event("Ctrl-C", After.SAFE_END, (signal.SIGINT,)),
    Event("Ctrl-C twice", After.STAYS, (signal.SIGINT, signal.SIGINT)),
    Event("SIGTERM", After.SAFE_END, (signal.SIGTERM,)),
    Event("SIGHUP", After.SAFE_END, (signal.SIGHUP,)),
    Event("SIGQUIT", After.SAFE_END, (signal.SIGQUIT,)),
    Event("kill -9", After.STAYS, (signal.SIGKILL,)),
    Event("SIGSTOP", After.STAYS, (signal.SIGSTOP,)),
    Event("protective stop", After.STAYS, fault=("arm", "protective_stop")),
    Event("emergency stop", After.STAYS, fault=("arm", "emergency_stop")),
    Event("gripper lost", After.NOTICED, fault=("gripper", "disconnect")),
    Event("fingertip lost", After.NOTICED, fault=("SIM-D0001", "disconnect")),
    Event("camera lost", After.NOTICED, fault=("camera", "disconnect")),
    Event("fingers blocked", After.FINGERS, fault=("gripper", "blocked")),
    Event("fingers stuck", After.FINGERS, fault=("gripper", "stuck")),
    Event("false success", After.FINGERS, fault=("gripper", "false_success")),
    Event("fingers overshoot", After.FINGERS, fault=("gripper", "overshoot")),
    Event("disk full", After.NOTICED, disk_full=True),
)
BY_NAME = {event.name: event for event in EVENTS}


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run: its number, its event, and the moment of the event."""

    number: int
    event: Event
    moment: Moment

    def __str__(self) -> str:
        return f"run {self.number}, {self.event.name}, {self.moment.stage}"


def plan_runs(seed: int, full: bool) -> list[PlannedRun]:
    """Draw the runs of a benchmark: each event once in a random stage or, if `full`, once in every stage."""
    rng = random.Random(seed)  # noqa: S311 - moments, no secrets
    if full:
        cells = [(event, stage) for event in EVENTS for stage in Stage]
    else:
        stages = ([*Stage] * math.ceil(len(EVENTS) / len(Stage)))[: len(EVENTS)]
        rng.shuffle(stages)
        cells = list(zip(EVENTS, stages, strict=True))
    rng.shuffle(cells)
    return [
        PlannedRun(number, event, random_moment(stage, rng))
        for number, (event, stage) in enumerate(cells, start=1)
    ]


@dataclass(frozen=True, slots=True)
class Judged:
    """Result of an event. unasked: the unconfirmed motion in words; "" without one."""

    stop: Standstill
    dropped: bool
    unasked: str


def judge(event: Event, stage: Stage, track: Sequence[TrueState], event_ns: int, grasp_m: float) -> Judged:
    """Judge what happened after an event. stage: of the lift at the event. grasp_m: height of the tool."""
    stop = standstill(track, event_ns)
    unasked = _unasked(event, track, stop, grasp_m)
    if not unasked and carried(track, grasp_m, set_down=stage is Stage.RELEASE):
        unasked = "the object was carried"
    return Judged(stop, dropped(track, grasp_m), unasked)


def _unasked(event: Event, track: Sequence[TrueState], stop: Standstill, grasp_m: float) -> str:
    there, later = at(track, stop.time_ns), [s for s in track if s.time_ns > stop.time_ns]
    high_m = there.tool_m[2] - grasp_m - REACH_M
    if event.after is After.STAYS:
        return _arm_moved(there, later) or _fingers_moved(event, track, stop)
    if event.after is After.SAFE_END:
        if not there.held and high_m > BOUNDARY_M and (moved := _arm_moved(there, later)):
            return moved
        if any(state.counts > there.counts + COUNTS for state in later):
            return "fingers closed"
    return _left_the_line(later, grasp_m)


def _arm_moved(there: TrueState, later: Sequence[TrueState]) -> str:
    way_m = max((math.dist(state.tool_m, there.tool_m) for state in later), default=0.0)
    return f"the arm moved by {1e3 * way_m:.1f} mm" if way_m > MOVED_M else ""


def _fingers_moved(event: Event, track: Sequence[TrueState], stop: Standstill) -> str:
    """Return how far the fingers moved after they had rested, in words.

    Fingers on their way at the event go on to where they were sent. Those around something that they do not
    hold may open after a fault of the arm.
    """
    rests = _fingers_rest(track, stop.time_ns)
    way = [state.counts - rests.counts for state in track if state.time_ns > rests.time_ns]
    opened = event.fault is not None and not rests.held
    if max(way, default=0.0) > COUNTS or (min(way, default=0.0) < -COUNTS and not opened):
        return f"the fingers moved by {max(way, key=abs):+.0f} counts"
    return ""


def _fingers_rest(track: Sequence[TrueState], since_ns: int) -> TrueState:
    """Return the state when the fingers had first rested for `FINGERS_REST_S`."""
    rests = at(track, since_ns)
    for state in track:
        if state.time_ns <= since_ns:
            continue
        if state.time_ns - max(rests.time_ns, since_ns) > FINGERS_REST_S * 1e9:
            break
        if abs(state.counts - rests.counts) > 1e-6:
            rests = state
    return rests


def _left_the_line(later: Sequence[TrueState], grasp_m: float) -> str:
    """Return a violation in words: below the approach height the tool may only move on one vertical line.

    It may not move below the grasp.
    """
    low = [state for state in later if state.tool_m[2] < grasp_m + CLEARANCE_M - BOUNDARY_M]
    if any(math.dist(state.tool_m[:2], low[0].tool_m[:2]) > LINE_M for state in low):
        return "the arm moved sideways beside the object"
    if any(state.tool_m[2] < grasp_m - MOVED_M for state in low):
        return "the arm moved below the grasp"
    return ""


TABLE_M = 0.02
TWICE_S = 0.15
"""Time between two signals, so that the first one has taken effect."""
DASHBOARD_PORT = 29999
POWER_S = 6.0


def as_real(bench: BenchConfig) -> BenchConfig:
    """Return a bench without [fakes], which counts as real and so must have the height of its table."""
    table = bench.table.model_copy(update={"top_m": TABLE_M})
    return bench.model_copy(update={"fakes": None, "table": table})


def start_trial(bench: Path, session: Path, object_id: str) -> subprocess.Popen[str]:
    """Start a trial of two lifts that continues with the second one.

    bench: file of a bench that counts as real.
    """
    command = python_command("-m", "rig", "trial", "--lifts", 2, "--object", object_id)
    command += ["--bench", str(bench), "--out", str(session), "--resume", "--yes", "--no-report"]
    return subprocess.Popen(  # noqa: S603 - our own program, no shell
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,  # no file: messages must arrive although the disk is full
        text=True,
        errors="replace",
        start_new_session=True,  # a Ctrl-C at the benchmark's terminal is the benchmark's
        preexec_fn=_reset_signals,
    )


def wait_for_end(program: subprocess.Popen[str], limit_s: float) -> str:
    """Wait for the end of a program and its children; after the time limit kill them.

    Return its last line on stderr, or everything from a traceback on; after the time limit, a line that
    reports it. Its few lines fit into the pipe.
    """
    try:
        lines = program.communicate(timeout=limit_s)[1].splitlines()
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        lines = [*program.communicate()[1].splitlines(), f"did not end within {limit_s:.0f} s"]
    lines = [line.rstrip() for line in lines if line.strip()]
    first = next((i for i, line in enumerate(lines) if "Traceback" in line), -1)
    return "\n".join(lines[first:])


def _reset_signals() -> None:
    """Let the program receive every signal, also if this benchmark was started to outlive its terminal."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
        with suppress(OSError):
            signal.signal(number, signal.SIG_DFL)


def strike(event: Event, program: subprocess.Popen[str], call: Callable[..., Mapping[str, Any]]) -> int:
    """Let an event happen to a program; return the time of its last part, ns, see `bench_ns`.

    call: the fakes' side channel's. On a full disk the process cannot write another byte to any file.
    """
    for number in event.signals[:-1]:
        program.send_signal(number)
        let_pass(call, TWICE_S)
    event_ns = bench_ns(call)
    for number in event.signals[-1:]:
        program.send_signal(number)
    if event.fault is not None:
        device, kind = event.fault
        call("fault", device=device, kind=kind)
    if event.disk_full:
        _, hard = resource.prlimit(program.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (0, hard))
    return event_ns


def switch_on(host: str) -> None:
    """Switch an arm on and release its brakes at the pendant, if an emergency stop took its power."""
    if _dashboard(host, "robotmode").endswith("RUNNING"):
        return
    _dashboard(host, "brake release")
    deadline = time.monotonic() + POWER_S
    while not _dashboard(host, "robotmode").endswith("RUNNING"):
        if time.monotonic() > deadline:
            raise DeviceError("safety: the simulated arm cannot be switched on again")
        time.sleep(0.1)


def _dashboard(host: str, request: str) -> str:
    with socket.create_connection((host, DASHBOARD_PORT), timeout=2.0) as connection:
        lines = connection.makefile("rb")
        lines.readline()  # its greeting
        connection.sendall(f"{request}\n".encode())
        return lines.readline().decode().strip()
