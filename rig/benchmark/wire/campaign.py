"""One campaign over the wire protocols, in real time: an event at a moment of a lift, then a judged run.

The real drivers are connected to simulated devices. The motions are judged by the record of the simulated
world, and not by what the rig reports.
"""

import math
import os
import resource
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from drivers.children import python_command
from drivers.clock import NS_PER_S, to_ns
from drivers.errors import DeviceError
from drivers.types import Vector3
from protocols.safe_end import REACH_M
from protocols.steps import CLEARANCE_M
from rig.bench.fakes_process import fakes_control, started_fakes
from rig.bench.operators import ConsoleOperator
from rig.bench.source import StandingBench
from rig.config import BenchConfig, load_bench

POLL_S = 0.004
LEVEL_M = 0.0015  # a tool this near the grasp's height is at the grasp
TRIES = 3
STILL_M_S, REST_S = 0.001, 0.003
"""A tool slower than this, for this time, has come to a standstill: a safe end moves it on at once."""
ABOVE_M = 0.003  # an object released higher than this above its place falls
MOVED_M = 0.001
LINE_M = 0.002  # distance from the line above the grasp beyond which the tool is beside it
BOUNDARY_M = 0.005
"""Tolerance around the height above which a hand counts as free; within it both safe ends are accepted."""
COUNTS = 1.5  # largest difference in counts at which the fingers count as unmoved
FINGERS_REST_S = 0.1
TABLE_M = 0.02
TWICE_S = 0.15  # time between two signals, so that the first one has taken effect
DASHBOARD_PORT = 29999
POWER_S = 6.0

Result = TypeVar("Result")
Bench = TypeVar("Bench", bound="WireBench")
Call = Callable[..., Mapping[str, Any]]
"""Function `call` of the side channel of running fakes (`rig.bench.fakes_process.fakes_control`)."""


class Stage(StrEnum):
    """Stages of a lift, as an observer sees them in the motions of arm and hand."""

    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    HOLD = "hold"
    LOWER = "lower"
    RELEASE = "release"


LASTS_S = dict(zip(Stage, (1.4, 3.2, 1.3, 1.1, 0.35, 0.6), strict=True))
"""Shortest duration of each stage, approximately."""


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
    """Something that happens to the devices or to the program."""

    name: str
    after: After = After.NOTICED
    signals: tuple[signal.Signals, ...] = ()  # to the program, in order
    faults: tuple[tuple[str, str, Mapping[str, Any]], ...] = ()  # (device, kind, arguments) in order
    disk_full: bool = False  # writing fails
    named: str = ""  # a word that the fault of the lift has to contain


def fault(
    name: str, device: str, *kinds: str, after: After = After.NOTICED, named: str = "", **of: Any
) -> Event:
    """Return an event of one device. kinds: its faults, in order. of: arguments of each fault."""
    return Event(name, after, faults=tuple((device, kind, of) for kind in kinds), named=named or device)


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run: its number, its event, and the time of the event after the beginning of a stage."""

    number: int
    event: Event
    stage: Stage
    after_s: float

    def __str__(self) -> str:
        return f"run {self.number}, {self.event.name}, {self.stage}"


@dataclass(frozen=True, slots=True)
class TrueState:
    """State at a time, monotonic ns: tool in the base frame in m, finger position in counts, object held."""

    time_ns: int
    tool_m: Vector3
    counts: float
    held: bool


@dataclass(frozen=True, slots=True)
class Standstill:
    """The first standstill after an event."""

    time_ns: int
    after_s: float  # 0 if the tool stood
    way_m: float  # distance since the event


class WireBench(StandingBench):
    """The real drivers on the running fakes of a bench. All questions are answered with yes."""

    def __init__(self, config: BenchConfig) -> None:
        super().__init__(config, ConsoleOperator(lambda _: True), "")
        self.config, self.call = config, fakes_control(config).call
        self.grasp_m = config.require("table").position_m[2]


@contextmanager
def serve(kind: Callable[[BenchConfig], Bench], bench: BenchConfig | None = None) -> Iterator[Bench]:
    """Start the fakes of a bench, by default `wire`, and connect a bench of this kind to them."""
    with started_fakes(bench or load_bench("wire")) as config, closing(kind(config)) as benches:
        yield benches


def as_real(bench: BenchConfig) -> BenchConfig:
    """Return a bench without [fakes], which counts as real and so must have the height of its table."""
    table = bench.require("table").model_copy(update={"top_m": TABLE_M})
    return bench.model_copy(update={"fakes": None, "table": table})


def next_stage(stage: Stage | None, world: Mapping[str, Any], grasp_m: float) -> Stage | None:
    """Return the stage of a lift, None before the first motion, by the state of the simulated world.

    stage: in the state before. grasp_m: height of the tool that grasps.
    """
    low, moving = world["tool_m"][2] - grasp_m < LEVEL_M, world["tool_moving"]
    ends = {
        None: moving,
        Stage.APPROACH: low and not moving,
        Stage.GRASP: world["held"] and moving and not low,
        Stage.LIFT: not moving,
        Stage.HOLD: moving,
        Stage.LOWER: low,
    }
    order = [None, *Stage]
    return order[order.index(stage) + 1] if ends.get(stage) else stage


def wait_for(
    wanted: Stage, after_s: float, grasp_m: float, call: Call, over: Callable[[], bool]
) -> Stage | None:
    """Wait until a stage of the next lift has lasted for a time; return the stage then, None if it ended."""
    stage, began_ns = None, 0
    while not over():
        world = call("world")
        stage = next_stage(stage, world, grasp_m)
        if stage is wanted and not began_ns:
            began_ns = world["now_ns"]
        if began_ns and world["now_ns"] - began_ns >= to_ns(after_s):
            return stage
        time.sleep(POLL_S)
    return None


def bench_ns(call: Call) -> int:
    """Return the time of the system clock of running fakes and their bench, ns."""
    now = call("world")
    return now["start_ns"] + now["now_ns"]


def let_pass(call: Call, duration_s: float) -> None:
    end_ns = bench_ns(call) + to_ns(duration_s)
    while bench_ns(call) < end_ns:
        time.sleep(POLL_S)


def retry(do: Callable[[], Result], before_again: Callable[[], str]) -> Result:
    """Return what `do` returns; repeat it if it raises `DeviceError`, as real-time runs do on a loaded host.

    before_again: puts the bench in order; it returns the reason if that is impossible, and nothing is
    repeated then. Raises the `DeviceError` of the last of three tries.
    """
    for _ in range(TRIES - 1):
        try:
            return do()
        except DeviceError:
            if before_again():
                raise
    return do()


def strike(event: Event, call: Call, program: "subprocess.Popen[str] | None" = None) -> int:
    """Let an event happen to devices and program; return the time of its last part, ns, see `bench_ns`."""
    for number in event.signals[:-1]:
        if program:
            program.send_signal(number)
            let_pass(call, TWICE_S)
    event_ns = bench_ns(call)
    for device, kind, arguments in event.faults:
        call("fault", device=device, kind=kind, **arguments)
    if program:
        for number in event.signals[-1:]:
            program.send_signal(number)
        if event.disk_full:
            _, hard = resource.prlimit(program.pid, resource.RLIMIT_FSIZE)
            resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (0, hard))
    return event_ns


def read_track(call: Call, since_ns: int) -> list[TrueState]:
    return [
        TrueState(time_ns, (x, y, z), counts, held)
        for time_ns, x, y, z, counts, held in call("track", since_ns=since_ns)["samples"]
    ]


def state_at(track: Sequence[TrueState], time_ns: int) -> TrueState:
    return next((state for state in reversed(track) if state.time_ns <= time_ns), track[0])


def standstill(track: Sequence[TrueState], event_ns: int) -> Standstill:
    there = stood = state_at(track, event_ns)
    for before, after in pairwise(track):
        if after.time_ns <= event_ns:
            continue
        lasts_s = max(after.time_ns - before.time_ns, 1) / NS_PER_S
        if math.dist(before.tool_m, after.tool_m) / lasts_s > STILL_M_S:
            stood = after
        elif after.time_ns - max(stood.time_ns, event_ns) >= to_ns(REST_S):
            break
    after_s = max(0, stood.time_ns - event_ns) / NS_PER_S
    return Standstill(max(stood.time_ns, event_ns), after_s, math.dist(there.tool_m, stood.tool_m))


def was_dropped(track: Sequence[TrueState], grasp_m: float) -> bool:
    """Whether the object was released above its place, where the tool grasps it at a height of `grasp_m`."""
    return any(
        before.held and not after.held and before.tool_m[2] > grasp_m + ABOVE_M
        for before, after in pairwise(track)
    )


def was_carried(track: Sequence[TrueState], grasp_m: float, set_down: bool = False) -> bool:
    """Whether the tool rose with the object after it had set it down. set_down: whether that was before."""
    was_up = was_down = set_down
    for state in track:
        above_m = state.tool_m[2] - grasp_m
        if not state.held:
            was_up = was_down = False
        elif above_m > ABOVE_M:
            if was_down:
                return True
            was_up = True
        elif above_m < ABOVE_M / 2:
            was_down = was_up
    return False


def find_unasked_motion(
    event: Event, stage: Stage, track: Sequence[TrueState], event_ns: int, grasp_m: float
) -> str:
    """Return a motion after the standstill that was not allowed, in words; "" without one.

    stage: of the lift at the event. grasp_m: height of the tool that grasps. Below the approach height the
    tool may only move on one vertical line, and not below the grasp.
    """
    stop_ns = standstill(track, event_ns).time_ns
    there, later = state_at(track, stop_ns), [s for s in track if s.time_ns > stop_ns]
    way_m = max((math.dist(state.tool_m, there.tool_m) for state in later), default=0.0)
    arm_moved = f"the arm moved by {1e3 * way_m:.1f} mm" if way_m > MOVED_M else ""
    high = not there.held and there.tool_m[2] - grasp_m - REACH_M > BOUNDARY_M
    if arm_moved and (event.after is After.STAYS or (event.after is After.SAFE_END and high)):
        return arm_moved
    if event.after is After.STAYS and (fingers_moved := _finger_motion(event, track, stop_ns)):
        return fingers_moved
    if event.after is After.SAFE_END and any(state.counts > there.counts + COUNTS for state in later):
        return "fingers closed"
    if event.after is not After.STAYS:
        low = [state for state in later if state.tool_m[2] < grasp_m + CLEARANCE_M - BOUNDARY_M]
        if any(math.dist(state.tool_m[:2], low[0].tool_m[:2]) > LINE_M for state in low):
            return "the arm moved sideways beside the object"
        if any(state.tool_m[2] < grasp_m - MOVED_M for state in low):
            return "the arm moved below the grasp"
    return "the object was carried" if was_carried(track, grasp_m, set_down=stage is Stage.RELEASE) else ""


def _finger_motion(event: Event, track: Sequence[TrueState], stop_ns: int) -> str:
    """Return how far the fingers moved after they had first rested for `FINGERS_REST_S`, in words.

    Fingers on their way at the event go on to where they were sent. Those around something that they do not
    hold may open after a fault of the arm.
    """
    rests = state_at(track, stop_ns)
    for state in track:
        if state.time_ns - max(rests.time_ns, stop_ns) > FINGERS_REST_S * NS_PER_S:
            break
        if state.time_ns > stop_ns and abs(state.counts - rests.counts) > 1e-6:
            rests = state
    way = [state.counts - rests.counts for state in track if state.time_ns > rests.time_ns]
    opened = event.faults and not rests.held
    if max(way, default=0.0) > COUNTS or (min(way, default=0.0) < -COUNTS and not opened):
        return f"the fingers moved by {max(way, key=abs):+.0f} counts"
    return ""


def start_trial(bench: Path, session: Path, object_id: str) -> "subprocess.Popen[str]":
    """Start a trial that continues with its second lift. bench: file of a bench that counts as real."""
    command = python_command("-m", "rig", "trial", "--lifts", 2, "--object", object_id)
    command += ["--bench", str(bench), "--out", str(session), "--resume", "--yes", "--no-report"]

    def reset_signals() -> None:
        # The program receives every signal, also if this benchmark was started to outlive its terminal.
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
            with suppress(OSError):
                signal.signal(number, signal.SIG_DFL)

    return subprocess.Popen(  # noqa: S603 - our own program, no shell
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,  # no file: messages must arrive although the disk is full
        text=True,
        errors="replace",
        start_new_session=True,  # a Ctrl-C at the benchmark's terminal is the benchmark's
        preexec_fn=reset_signals,
    )


def wait_for_end(program: "subprocess.Popen[str]", limit_s: float) -> str:
    """Return a program's last line on stderr, or all from a traceback on; kill it after the time limit."""
    try:
        lines = program.communicate(timeout=limit_s)[1].splitlines()
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        lines = [*program.communicate()[1].splitlines(), f"did not end within {limit_s:.0f} s"]
    lines = [line.rstrip() for line in lines if line.strip()]
    first = next((i for i, line in enumerate(lines) if "Traceback" in line), -1)
    return "\n".join(lines[first:])


def switch_on(host: str) -> None:
    """Switch an arm on and release its brakes at the pendant, if an emergency stop took its power."""
    asked, deadline = False, time.monotonic() + POWER_S
    while not _dashboard(host, "robotmode").endswith("RUNNING"):
        if not asked:
            _dashboard(host, "brake release")
        if time.monotonic() > deadline:
            raise DeviceError("safety: the simulated arm cannot be switched on again")
        asked = True
        time.sleep(0.1)


def _dashboard(host: str, request: str) -> str:
    with socket.create_connection((host, DASHBOARD_PORT), timeout=2.0) as connection:
        lines = connection.makefile("rb")
        lines.readline()  # its greeting
        connection.sendall(f"{request}\n".encode())
        return lines.readline().decode().strip()
