"""What can happen to a lift at any moment, and what may move after it: the rows of `rig benchmark safety`."""

import math
import random
import signal
from dataclasses import dataclass
from enum import StrEnum

from rig.benchmark.wire.moments import Moment, Stage, random_moment


class After(StrEnum):
    """What may move once the arm has come to a standstill.

    STAYS: nothing. SAFE_END: what `protocols.safe_end` says of a hand that is free, around something or
    holding. NOTICED: the lift goes on as agreed until it is noticed; then the safe end. FINGERS: the same,
    but it can only be noticed when the fingers move next, so no time is required.
    """

    STAYS = "stays"
    SAFE_END = "safe end"
    NOTICED = "noticed"
    FINGERS = "at the next finger motion"


@dataclass(frozen=True, slots=True)
class Event:
    """What happens. signals: to the program, in order. fault: device and kind. disk_full: so it is."""

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
    """One run: its number, what happens in it, and when."""

    number: int
    event: Event
    moment: Moment


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
