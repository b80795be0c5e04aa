"""Random moments of every phase of a lift, found by what the simulated world shows."""

import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

POLL_S = 0.004
LEVEL_M = 0.0015
"""A tool this near the grasp's height is at the grasp."""


class Stage(StrEnum):
    """What the arm and the hand are about, as somebody sees it who looks at them."""

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
"""About how long each takes at least."""


@dataclass(frozen=True, slots=True)
class Moment:
    """So long after a stage has begun, s."""

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
        """Take how the world is now; return the stage, None before the first motion."""
        self.stage = self._next(world["tool_m"][2] - self._grasp_m, world["tool_moving"], world["held"])
        return self.stage

    def _next(self, above_m: float, moving: bool, held: bool) -> Stage | None:
        low = above_m < LEVEL_M
        match self.stage:
            case None:
                return Stage.APPROACH if moving else None
            case Stage.APPROACH if low and not moving:
                return Stage.GRASP
            case Stage.GRASP if held and moving and not low:
                return Stage.LIFT
            case Stage.LIFT if not moving:
                return Stage.HOLD
            case Stage.HOLD if moving:
                return Stage.LOWER
            case Stage.LOWER if low:
                return Stage.RELEASE
        return self.stage


def wait_for(
    moment: Moment,
    grasp_m: float,
    world: Callable[[], Mapping[str, Any]],
    over: Callable[[], bool],
) -> Stage | None:
    """Wait for a moment of the next lift; return the stage that it then is, None where the lift was over.

    world: asks how the world is. over: whether nothing more will come.
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
