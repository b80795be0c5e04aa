"""Streams, tables and gels that a calibration must not take at face value."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from calibration.gel.balls import BallPress, calibrate_gel
from calibration.gel.presses import find_press
from calibration.gel.reference import compare, judge_reference, make_reference
from calibration.gel.scale import fit_scale
from calibration.opening_table import Direction, OpeningSample, calibrate_opening
from calibration.time_offset import Stream, make_stream, time_offset, unwrapped
from drivers.types import Image
from rig.benchmark.degenerate import Case, Finding, answered, refused
from rig.benchmark.gel_scenes import MM_PER_PX, SimulatedGel
from rig.benchmark.motion_scenes import wiggle_scene

Rng = np.random.Generator
_GEL = SimulatedGel(seed=7)
_ALLOWED_S = 2e-3
_BEYOND = ("share", "end of the search", "repeats")


def cases() -> list[Case]:
    """All cases of time, gripper tables and tactile sensors."""
    return [*_time(), *_gripper(), *_gel()]


def _time() -> list[Case]:
    group = "time"
    changes: list[tuple[str, Callable[[Stream, Stream, Rng], tuple[Stream, Stream]], tuple[str, ...]]] = [
        ("unsorted log", lambda a, b, r: (a, _permuted(b, r)), ()),
        ("equal stamps", lambda a, b, r: (a, _stream(np.repeat(b.time_ns, 2), np.repeat(b.values, 2))), ()),
        ("32-bit counter that wraps", lambda a, b, r: (a, _wrapped(b)), ()),
        ("clock jumps by hours", lambda a, b, r: (a, _jumped(b)), ("jumps",)),
        ("gap of two seconds", lambda a, b, r: (_gap(a), b), ()),
        ("half the frames dropped", lambda a, b, r: (a, _thinned(b, r, 0.5)), ()),
        ("NaN values", lambda a, b, r: (a, _nans(b)), ()),
        ("streams with no overlap", lambda a, b, r: (a, Stream(b.time_ns + 10**12, b.values)), ("overlap",)),
        ("float32 seconds since the epoch", lambda a, b, r: (a, _float32(b)), ("integer ns",)),
        ("five samples", lambda a, b, r: (a, _stream(b.time_ns[:5], b.values[:5])), ("20 are the least",)),
        ("empty", lambda a, b, r: (a, _stream(b.time_ns[:0], b.values[:0])), ("20 are the least",)),
        ("sign turned", lambda a, b, r: (a, Stream(b.time_ns, -b.values)), ()),
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


def _gel() -> list[Case]:
    group = "tactile sensor"
    changes: list[tuple[str, Callable[[Image, Rng], Any], tuple[str, ...]]] = [
        ("nothing touches", lambda p, r: _GEL.frame(r), ("no contact",)),
        ("one hot pixel", lambda p, r: _spot(_GEL.frame(r), 1), ("no contact",)),
        ("a line", _line, ("not round", "no contact")),
        ("touched all over", lambda p, r: _brighter(_GEL.frame(r)), ("not round", "no contact")),
        ("constant picture", lambda p, r: np.full_like(p, 90), ("alike",)),
        ("another size", lambda p, r: p[:100], ("differ in size",)),
        ("grey picture", lambda p, r: p[..., 0], ("RGB is needed",)),
        ("float picture", lambda p, r: p.astype(np.float32), ("RGB is needed",)),
    ]  # fmt: skip
    listed = [Case(group, name, partial(_pressed, change=change), why) for name, change, why in changes]
    return [
        *listed,
        Case(group, "an LED out", partial(_reference, gain=(0.05, 1.0, 1.0)), ("LED went out",)),
        Case(group, "LEDs dimmed by a fifth", partial(_reference, gain=(0.8, 0.8, 0.8)), ("light changed",)),
        Case(group, "LEDs saturated", partial(_reference, gain=(6.0, 6.0, 6.0)), ("saturated",)),
        Case(group, "reference with contact in it", _touched_reference, ("changed shape",)),
        Case(group, "reference of another unit", _other_unit, ("changed shape",)),
        Case(group, "reference taken while touching", _touched_midway, ("changed while",)),
        Case(group, "ball radius below its print", partial(_balls, radius_mm=0.4), ("wider than a ball",)),
        Case(group, "three presses", partial(_balls, count=3), ("8 are the least",)),
        Case(group, "scale from moves along one line", _line_scale, ("span both axes",)),
        Case(group, "scales of x and y apart", _two_scales, ()),
    ]


def _changed(rng: Rng, change: Callable[[Stream, Stream, Rng], tuple[Stream, Stream]]) -> Finding:
    robot, camera = wiggle_scene(rng)
    return _offset(*change(robot, camera, rng), 0.0473)


def _wiggled(
    rng: Rng, motion: str = "chirp", offset_s: float = 0.0473, drift_ppm: float = 0.0, seconds: float = 20.0
) -> Finding:
    return _offset(*wiggle_scene(rng, motion, offset_s, seconds, drift_ppm=drift_ppm), offset_s)


def _offset(robot: Stream, camera: Stream, truth_s: float) -> Finding:
    found = time_offset(robot, camera)
    if found.offset_s is None:
        return refused(*found.judgement.reasons)
    return answered(abs(found.offset_s - truth_s), _ALLOWED_S)


def _stream(times: np.ndarray, values: np.ndarray) -> Stream:
    return make_stream(times, values, "camera")


def _permuted(camera: Stream, rng: Rng) -> Stream:
    order = rng.permutation(len(camera.time_ns))
    return _stream(camera.time_ns[order], camera.values[order])


def _wrapped(camera: Stream) -> Stream:
    """Stamps as a 32-bit counter of ns, undone."""
    counter = camera.time_ns.astype(np.uint64) % (1 << 32)
    lost = int(camera.time_ns[0]) - int(counter[0])
    return _stream(unwrapped(counter) + lost, camera.values)


def _jumped(camera: Stream) -> Stream:
    times = camera.time_ns.copy()
    times[len(times) // 2 :] += 3 * 3600 * 10**9
    return _stream(times, camera.values)


def _gap(robot: Stream) -> Stream:
    from_start = (robot.time_ns - robot.time_ns[0]) / 1e9
    kept = (from_start < 8.0) | (from_start > 10.0)
    return _stream(robot.time_ns[kept], robot.values[kept])


def _thinned(camera: Stream, rng: Rng, share: float) -> Stream:
    kept = rng.uniform(size=len(camera.time_ns)) < share
    return _stream(camera.time_ns[kept], camera.values[kept])


def _nans(camera: Stream) -> Stream:
    values = camera.values.copy()
    values[::7] = np.nan
    return _stream(camera.time_ns, values)


def _float32(camera: Stream) -> Stream:
    return _stream((camera.time_ns / 1e9).astype(np.float32), camera.values)


def _openings() -> list[OpeningSample]:
    return [
        OpeningSample(f"{way} {counts}", counts, 0.12 - 0.0005 * counts, way)
        for way in Direction
        for counts in range(10, 210, 20)
    ]


def _shuffled(rng: Rng) -> Finding:
    samples = [OpeningSample(s.id, s.counts, rng.uniform(0, 0.12), s.direction) for s in _openings()]
    return refused(*calibrate_opening(samples).judgement.reasons)


def _looked(_: Rng, at: float, keep: Direction | None = None) -> Finding:
    samples = [s for s in _openings() if keep is None or s.direction is keep]
    found = calibrate_opening(samples).tables[Direction.CLOSING].opening_at(at)
    return answered(abs(found.value - (0.12 - 0.0005 * at)), 1e-6)


def _one_bad(_: Rng, counts: float, opening_m: float) -> Finding:
    found = calibrate_opening([*_openings(), OpeningSample("bad", counts, opening_m, Direction.CLOSING)])
    named = [r.id for r in found.rejected] == ["bad"]
    return answered(abs(found.tables[Direction.CLOSING].opening_at(100.0).value - 0.07) + (not named), 1e-6)


def _few(_: Rng, count: int) -> Finding:
    return refused(*calibrate_opening(_openings()[:count]).judgement.reasons)


def _pressed(rng: Rng, change: Callable[[Image, Rng], Any]) -> Finding:
    found = find_press(change(_GEL.presses(1)[0].image, rng), _GEL.reference, "press")
    return refused(found) if isinstance(found, str) else answered(found.reach_px, 0.0)


def _spot(picture: Image, count: int) -> Image:
    picture[100, 100 : 100 + count] = 255
    return picture


def _brighter(picture: Image) -> Image:
    return np.clip(picture.astype(int) + 60, 0, 255).astype(np.uint8)


def _line(_: Image, rng: Rng) -> Image:
    picture = _GEL.frame(rng).astype(int)
    picture[20:300, 118:124] += 80
    return np.clip(picture, 0, 255).astype(np.uint8)


def _still(rng: Rng, gel: SimulatedGel = _GEL) -> list[Image]:
    return [gel.frame(rng) for _ in range(10)]


def _reference(rng: Rng, gain: tuple[float, float, float]) -> Finding:
    frames = [np.clip(f * np.asarray(gain), 0, 255).astype(np.uint8) for f in _still(rng)]
    return _judged(frames)


def _judged(frames: list[Image]) -> Finding:
    reference = make_reference(frames)
    judged = judge_reference(reference, compare(reference, _GEL.reference))
    return refused(*judged.reasons) if judged.reasons else answered(1.0, 0.0)


def _touched_reference(_: Rng) -> Finding:
    return _judged([_GEL.presses(1)[0].image] * 10)


def _touched_midway(rng: Rng) -> Finding:
    return _judged([*_still(rng)[:6], *[_GEL.presses(1)[0].image] * 6])


def _other_unit(rng: Rng) -> Finding:
    return _judged(_still(rng, SimulatedGel(seed=8)))


def _balls(_: Rng, count: int = 10, radius_mm: float | None = None) -> Finding:
    presses = []
    for made in _GEL.presses(count):
        found = find_press(made.image, _GEL.reference, made.name)
        if not isinstance(found, str):
            presses.append(BallPress(found, radius_mm or made.radius_mm))
    return answered(calibrate_gel(presses, MM_PER_PX).normal_rms, 0.0)


def _line_scale(rng: Rng) -> Finding:
    moves = np.column_stack([np.linspace(-4, 4, 8), np.zeros(8)])
    return answered(float(fit_scale(moves, rng.normal(moves / 0.06, 0.3)).mm_per_px[0]), 0.0)


def _two_scales(rng: Rng) -> Finding:
    moves = rng.uniform(-5, 5, (12, 2))
    scale = fit_scale(moves, rng.normal(moves / (0.058, 0.064), 0.3))
    return answered(float(np.abs(scale.mm_per_px / (0.058, 0.064) - 1.0).max()), 0.02)
