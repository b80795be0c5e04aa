"""What took how long, line by line: apart from the results, which are the same for the same seed."""

from dataclasses import dataclass
from typing import ClassVar

from pydantic import ConfigDict

from rig.sessions.codec import STRICT, Codec


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Percentiles of a stage's wall time per frame, ms."""

    p50_ms: float
    p95_ms: float
    p99_ms: float


@dataclass(frozen=True, slots=True)
class LatencyTimes:
    """Percentiles, and the largest, of the time from a frame's capture to its logged angle, ms."""

    p50_ms: float
    p95_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True, kw_only=True)
class LiftTiming:
    """A trial's line of `timing.jsonl`. capture_to_angle: by serial, on benches in real time alone."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    number: int
    attempt: int
    wall_s: float
    stages: dict[str, StageTimes]
    capture_to_angle: dict[str, LatencyTimes] | None = None


@dataclass(frozen=True, kw_only=True)
class PoseTiming:
    """A recording's line of `timing.jsonl`."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    pose: int
    attempt: int
    wall_s: float


@dataclass(frozen=True, kw_only=True)
class ReplayTiming:
    """A replay's line of `timing.jsonl`: the order in which the lifts came."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    session: str
    number: int | None


TimingLine = LiftTiming | PoseTiming | ReplayTiming
LIFT_TIMINGS: Codec[LiftTiming] = Codec(LiftTiming)
