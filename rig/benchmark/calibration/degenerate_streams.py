"""Streams and tables that a calibration must not take at face value."""

from collections.abc import Callable
from functools import partial

import numpy as np

from calibration.opening import Direction, GripperResult, OpeningSample, calibrate_opening
from calibration.time_offset import TimedSignal, make_stream, time_offset
from rig.benchmark.calibration.degenerate import Case, CaseAnswer, answered, refused
from rig.benchmark.calibration.motion_scenes import wiggle_scene

Rng = np.random.Generator
_ALLOWED_S = 2e-3
_BEYOND = ("share", "end of the search", "repeats")


def cases() -> list[Case]:
    """All cases of time and gripper tables."""
    return [*_time(), *_gripper()]


def _time() -> list[Case]:
    group = "time"
    changes: list[
        tuple[
            str, Callable[[TimedSignal, TimedSignal, Rng], tuple[TimedSignal, TimedSignal]], tuple[str, ...]
        ]
    ] = [
        ("unsorted log", lambda a, b, r: (a, _permuted(b, r)), ()),
        ("equal stamps", lambda a, b, r: (a, _stream(np.repeat(b.time_ns, 2), np.repeat(b.values, 2))), ()),
        ("clock jumps by hours", lambda a, b, r: (a, _jumped(b)), ("jumps",)),
        ("gap of two seconds", lambda a, b, r: (_gap(a), b), ()),
        ("half the frames dropped", lambda a, b, r: (a, _thinned(b, r, 0.5)), ()),
        ("NaN values", lambda a, b, r: (a, _nans(b)), ()),
        (
            "streams with no overlap",
            lambda a, b, r: (a, TimedSignal(b.time_ns + 10**12, b.values)),
            ("overlap",),
        ),
        ("float32 seconds since the epoch", lambda a, b, r: (a, _float32(b)), ("integer ns",)),
        ("five samples", lambda a, b, r: (a, _stream(b.time_ns[:5], b.values[:5])), ("20 are the least",)),
        ("empty", lambda a, b, r: (a, _stream(b.time_ns[:0], b.values[:0])), ("20 are the least",)),
        ("sign turned", lambda a, b, r: (a, TimedSignal(b.time_ns, -b.values)), ()),
    ]
    listed = [
        Case(group, name, partial(_changed, change=change), why, draws=3) for name, change, why in changes
    ]
    return [
        *listed,
        Case(group, "static", partial(_wiggled, motion="static"), ("share",), draws=10),
        Case(group, "constant", partial(_wiggled, motion="constant"), ("nothing moved",)),
        Case(group, "motion that repeats", partial(_wiggled, motion="sine"), ("repeats",), draws=5),
        Case(group, "offset beyond the search", partial(_wiggled, offset_s=0.8), _BEYOND, draws=5),
        Case(group, "drift of 100 ppm, four minutes", partial(_wiggled, drift_ppm=100.0, seconds=240.0)),
    ]  # fmt: skip


def _gripper() -> list[Case]:
    group = "gripper table"
    return [
        Case(group, "not monotone at all", _shuffled, ("monotone",), draws=3),
        Case(group, "closing only", partial(_one_way, way=Direction.CLOSING)),
        Case(group, "opening only", partial(_one_way, way=Direction.OPENING), ("while closing",)),
        Case(group, "counts outside 0 to 255", partial(_one_bad, counts=300.0, opening_m=0.05)),
        Case(group, "opening in mm", partial(_one_bad, counts=100.0, opening_m=50.0)),
        Case(group, "NaN opening", partial(_one_bad, counts=100.0, opening_m=float("nan"))),
        Case(group, "two counts only", partial(_few, count=2), ("while closing",)),
        Case(group, "empty", partial(_few, count=0), ("while closing",)),
    ]


def _changed(
    rng: Rng, change: Callable[[TimedSignal, TimedSignal, Rng], tuple[TimedSignal, TimedSignal]]
) -> CaseAnswer:
    robot, camera = wiggle_scene(rng)
    return _offset(*change(robot, camera, rng), 0.0473)


def _wiggled(
    rng: Rng, motion: str = "chirp", offset_s: float = 0.0473, drift_ppm: float = 0.0, seconds: float = 20.0
) -> CaseAnswer:
    return _offset(*wiggle_scene(rng, motion, offset_s, seconds, drift_ppm=drift_ppm), offset_s)


def _offset(robot: TimedSignal, camera: TimedSignal, truth_s: float) -> CaseAnswer:
    found = time_offset(robot, camera)
    if found.offset_s is None:
        return refused(*found.assessment.reasons)
    return answered(abs(found.offset_s - truth_s), _ALLOWED_S)


def _stream(times: np.ndarray, values: np.ndarray) -> TimedSignal:
    return make_stream(times, values, "camera")


def _permuted(camera: TimedSignal, rng: Rng) -> TimedSignal:
    order = rng.permutation(len(camera.time_ns))
    return _stream(camera.time_ns[order], camera.values[order])


def _jumped(camera: TimedSignal) -> TimedSignal:
    times = camera.time_ns.copy()
    times[len(times) // 2 :] += 3 * 3600 * 10**9
    return _stream(times, camera.values)


def _gap(robot: TimedSignal) -> TimedSignal:
    from_start = (robot.time_ns - robot.time_ns[0]) / 1e9
    kept = (from_start < 8.0) | (from_start > 10.0)
    return _stream(robot.time_ns[kept], robot.values[kept])


def _thinned(camera: TimedSignal, rng: Rng, share: float) -> TimedSignal:
    kept = rng.uniform(size=len(camera.time_ns)) < share
    return _stream(camera.time_ns[kept], camera.values[kept])


def _nans(camera: TimedSignal) -> TimedSignal:
    values = camera.values.copy()
    values[::7] = np.nan
    return _stream(camera.time_ns, values)


def _float32(camera: TimedSignal) -> TimedSignal:
    return _stream((camera.time_ns / 1e9).astype(np.float32), camera.values)


def _openings() -> list[OpeningSample]:
    return [
        OpeningSample(f"{way} {counts}", counts, 0.12 - 0.0005 * counts, way)
        for way in Direction
        for counts in range(10, 210, 20)
    ]


def _shuffled(rng: Rng) -> CaseAnswer:
    samples = [OpeningSample(s.id, s.counts, rng.uniform(0, 0.12), s.direction) for s in _openings()]
    return refused(*calibrate_opening(samples).assessment.reasons)


def _one_way(_: Rng, way: Direction) -> CaseAnswer:
    return _answer(calibrate_opening([s for s in _openings() if s.direction is way]))


def _one_bad(_: Rng, counts: float, opening_m: float) -> CaseAnswer:
    found = calibrate_opening([*_openings(), OpeningSample("bad", counts, opening_m, Direction.CLOSING)])
    named = [r.id for r in found.rejected] == ["bad"]
    return _answer(found) if named else answered(1.0, 1e-6)


def _answer(found: GripperResult) -> CaseAnswer:
    """Compare the table of closing fingers at 100 counts with the truth."""
    if not found.tables:
        return refused(*found.assessment.reasons)
    table = found.tables[Direction.CLOSING]
    return answered(abs(np.interp(100.0, table.counts, table.opening_m) - 0.07), 1e-6)


def _few(_: Rng, count: int) -> CaseAnswer:
    return refused(*calibrate_opening(_openings()[:count]).assessment.reasons)
