"""Streams and tables that a calibration must not take at face value."""

from collections.abc import Callable
from functools import partial

import numpy as np

from calibration.fingers.opening import Direction, OpeningSample, calibrate_opening
from calibration.time_offset import TimedSignal, make_stream, time_offset, unwrapped
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
        ("32-bit counter that wraps", lambda a, b, r: (a, _wrapped(b)), ()),
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
        Case(group, "one way only", partial(_looked, at=100.0, keep=Direction.CLOSING)),
        Case(group, "counts outside 0 to 255", partial(_one_bad, counts=300.0, opening_m=0.05)),
        Case(group, "opening in mm", partial(_one_bad, counts=100.0, opening_m=50.0)),
        Case(group, "NaN opening", partial(_one_bad, counts=100.0, opening_m=float("nan"))),
        Case(group, "asked beyond what was measured", partial(_looked, at=2.0), ("beyond",)),
        Case(group, "asked for NaN", partial(_looked, at=float("nan")), ("nan",)),
        Case(group, "two counts only", partial(_few, count=2), ("usable measurements",)),
        Case(group, "empty", partial(_few, count=0), ("usable measurements",)),
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


def _wrapped(camera: TimedSignal) -> TimedSignal:
    """Stamps as a 32-bit counter of ns, undone."""
    counter = camera.time_ns.astype(np.uint64) % (1 << 32)
    lost = int(camera.time_ns[0]) - int(counter[0])
    return _stream(unwrapped(counter) + lost, camera.values)


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


def _looked(_: Rng, at: float, keep: Direction | None = None) -> CaseAnswer:
    samples = [s for s in _openings() if keep is None or s.direction is keep]
    found = calibrate_opening(samples).tables[Direction.CLOSING].opening_at(at)
    return answered(abs(found - (0.12 - 0.0005 * at)), 1e-6)


def _one_bad(_: Rng, counts: float, opening_m: float) -> CaseAnswer:
    found = calibrate_opening([*_openings(), OpeningSample("bad", counts, opening_m, Direction.CLOSING)])
    named = [r.id for r in found.rejected] == ["bad"]
    return answered(abs(found.tables[Direction.CLOSING].opening_at(100.0) - 0.07) + (not named), 1e-6)


def _few(_: Rng, count: int) -> CaseAnswer:
    return refused(*calibrate_opening(_openings()[:count]).assessment.reasons)
