"""Random moments of every stage of a lift, found in what the simulated world reports, in real time."""

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar

from drivers.errors import DeviceError

POLL_S = 0.004
LEVEL_M = 0.0015
"""A tool this near the grasp's height is at the grasp."""
TRIES = 3

Result = TypeVar("Result")


class Stage(StrEnum):
    """Stages of a lift, as an observer sees them in the motions of arm and hand."""

    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    HOLD = "hold"
    LOWER = "lower"
    RELEASE = "release"


LASTS_S = {
    Stage.APPROACH: 1.4,
    Stage.GRASP: 3.2,
    Stage.LIFT: 1.3,
    Stage.HOLD: 1.1,
    Stage.LOWER: 0.35,
    Stage.RELEASE: 0.6,
}
"""Shortest duration of each stage, approximately."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time after the beginning of a stage, s."""

    stage: Stage
    after_s: float


def random_moment(stage: Stage, rng: random.Random) -> Moment:
    """Draw a moment of a stage."""
    return Moment(stage, rng.uniform(0.0, LASTS_S[stage]))


class StageWatch:
    """Follows a lift by the simulated world. grasp_m: height of the tool that grasps."""

    def __init__(self, grasp_m: float) -> None:
        self._grasp_m = grasp_m
        self.stage: Stage | None = None

    def see(self, world: Mapping[str, Any]) -> Stage | None:
        """Return the stage of the lift in the world's current state, None before the first motion."""
        low, moving = world["tool_m"][2] - self._grasp_m < LEVEL_M, world["tool_moving"]
        match self.stage:
            case None if moving:
                self.stage = Stage.APPROACH
            case Stage.APPROACH if low and not moving:
                self.stage = Stage.GRASP
            case Stage.GRASP if world["held"] and moving and not low:
                self.stage = Stage.LIFT
            case Stage.LIFT if not moving:
                self.stage = Stage.HOLD
            case Stage.HOLD if moving:
                self.stage = Stage.LOWER
            case Stage.LOWER if low:
                self.stage = Stage.RELEASE
        return self.stage


def wait_for(
    moment: Moment,
    grasp_m: float,
    world: Callable[[], Mapping[str, Any]],
    over: Callable[[], bool],
) -> Stage | None:
    """Wait for a moment of the next lift; return the stage at that time, None if the lift ended before it.

    world: returns the state of the simulated world. over: whether the lift has ended.
    """
    watch, began = StageWatch(grasp_m), 0.0
    while not over():
        stage = watch.see(world())
        if stage is moment.stage and not began:
            began = time.monotonic()
        if began and time.monotonic() - began >= moment.after_s:
            return stage
        time.sleep(POLL_S)
    return None


def tried(do: Callable[[], Result], before_again: Callable[[], str] = lambda: "") -> Result:
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
