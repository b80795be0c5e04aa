"""Durations, line by line, separate from the results, which are the same for the same seed."""

from dataclasses import dataclass

from rig.sessions.codec import Codec, strict


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Percentiles of a stage's computing time per frame, ms."""

    p50_ms: float
    p95_ms: float
    p99_ms: float


@dataclass(frozen=True, slots=True)
class LatencyTimes(StageTimes):
    """Percentiles and maximum of the time from a frame's capture to its logged angle, ms."""

    max_ms: float


@strict
@dataclass(frozen=True, kw_only=True)
class LiftTiming:
    """A trial's line of `timing.jsonl`. capture_to_angle: by serial, only on benches in real time."""

    number: int
    attempt: int
    wall_s: float
    stages: dict[str, StageTimes]
    capture_to_angle: dict[str, LatencyTimes] | None = None


@strict
@dataclass(frozen=True, kw_only=True)
class PoseTiming:
    """A recording's line of `timing.jsonl`."""

    pose: int
    attempt: int
    wall_s: float


@strict
@dataclass(frozen=True, kw_only=True)
class ReplayTiming:
    """A replay's line of `timing.jsonl`, in the order in which lifts finished."""

    session: str
    number: int | None


TimingLine = LiftTiming | PoseTiming | ReplayTiming
LIFT_TIMINGS: Codec[LiftTiming] = Codec(LiftTiming)
