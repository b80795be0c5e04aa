"""Clock offsets between two streams of one motion: correct within their sigma, or refused with the reason."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.time_offset import TimedSignal, TimeOffset, make_stream, time_offset, turning_rate
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from rig.calibrate.clocks import solve_pair
from support.marks import heavy
from support.motions import wiggle_scene

Array = np.ndarray
Scene = tuple[TimedSignal, TimedSignal]
OFFSET_S = 0.0473


@pytest.mark.heavy
def test_offset_from_a_wiggle_is_within_its_sigma() -> None:
    found = [time_offset(*wiggle_scene(np.random.default_rng(seed), offset_s=OFFSET_S)) for seed in range(20)]
    errors = [each.offset_s - OFFSET_S for each in found]  # type: ignore[operator]
    assert np.percentile(np.abs(errors), 95) < 1e-3
    assert 0.5 < np.std(errors) / np.mean([each.sigma_s for each in found]) < 2.0


def test_correlated_noise_increases_sigma() -> None:
    first, second = wiggle_scene(np.random.default_rng(0), offset_s=OFFSET_S)
    white = np.random.default_rng(1).normal(0.0, 1.0, len(second.values))
    smooth = np.convolve(white, np.ones(8) / np.sqrt(8.0), "same")
    size = 0.05 * second.values.std()
    sigmas = [
        time_offset(first, replace(second, values=second.values + size * noise / noise.std())).sigma_s
        for noise in (white, smooth)
    ]
    assert sigmas[1] > 1.5 * sigmas[0]


def test_offset_of_two_pose_streams_follows_from_their_turning_rates() -> None:
    """The second sees the motion from another pose, 80 ms late, at 30 Hz with noise and half its frames."""
    rng = np.random.default_rng(2)

    def turn(t: Array) -> Rotation:
        return Rotation.from_rotvec(
            np.stack([0.4 * np.sin(1.7 * t), 0.5 * np.sin(2.9 * t + 1), 0.3 * np.sin(4.1 * t)], axis=1)
        )

    robot_s, camera_s = np.arange(0, 12, 0.002), np.sort(rng.choice(np.arange(0, 12, 1 / 30), 200, False))
    noise = Rotation.from_rotvec(rng.normal(0, 2e-3, (len(camera_s), 3)))
    mounted, placed = Rotation.random(2, rng=3)
    robot = turning_rate((robot_s * 1e9).astype(np.int64), turn(robot_s).as_quat(), "robot")
    late = ((camera_s + 0.08) * 1e9).astype(np.int64)
    camera = turning_rate(late, (placed * turn(camera_s) * mounted * noise).as_quat(), "camera")
    assert time_offset(robot, camera).offset_s == pytest.approx(-0.08, abs=5e-3)


def test_invalid_orientations_are_discarded_or_rejected() -> None:
    times = np.arange(60) * 10_000_000
    turns = Rotation.from_rotvec(np.outer(np.arange(60) * 0.01, [0, 0, 1.0])).as_quat()
    turns[5] = np.nan
    turns[7] = 0.0
    mirrored = Rotation.from_quat(turns[30]) * Rotation.from_euler("x", 40, degrees=True)
    turns[30] = mirrored.as_quat()
    assert turning_rate(times, turns, "camera").values == pytest.approx(1.0, rel=1e-6)
    for wrong, reason in ((np.zeros((60, 4)), "no orientations over"), (turns[:, :3], "quaternions")):
        with pytest.raises(CalibrationError, match=reason):
            turning_rate(times, wrong, "camera")


@pytest.mark.heavy
def test_clock_drift_is_estimated_over_minutes() -> None:
    found = time_offset(*wiggle_scene(np.random.default_rng(1), seconds=240.0, drift_ppm=80.0))
    assert found.drift_ppm == pytest.approx(80.0, abs=4 * (found.drift_sigma_ppm or 0) + 1)


def test_streams_are_sorted_and_cleaned() -> None:
    rng = np.random.default_rng(2)
    robot, camera = wiggle_scene(rng)
    order = rng.permutation(len(camera.time_ns))
    times = np.append(camera.time_ns[order], camera.time_ns[:5])
    values = np.append(camera.values[order], np.zeros(5))
    values[3] = np.nan
    mixed = make_stream(times, values, "camera")
    assert len(mixed.time_ns) == len(times) - 6
    assert abs(time_offset(robot, mixed).offset_s - time_offset(robot, camera).offset_s) < 2e-4  # type: ignore[operator]


def some(signal: TimedSignal, kept: Array) -> TimedSignal:
    return TimedSignal(signal.time_ns[kept], signal.values[kept])


def with_a_gap(rng: np.random.Generator) -> Scene:
    robot, camera = wiggle_scene(rng)
    since_s = (robot.time_ns - robot.time_ns[0]) / 1e9
    return some(robot, (since_s < 8.0) | (since_s > 10.0)), camera


def with_half_of_the_frames(rng: np.random.Generator) -> Scene:
    robot, camera = wiggle_scene(rng)
    return robot, some(camera, rng.uniform(size=len(camera.time_ns)) < 0.5)


def negated(rng: np.random.Generator) -> Scene:
    robot, camera = wiggle_scene(rng)
    return robot, TimedSignal(camera.time_ns, -camera.values)


def without_overlap(rng: np.random.Generator) -> Scene:
    robot, camera = wiggle_scene(rng)
    return robot, TimedSignal(camera.time_ns + 10**12, camera.values)


MOTIONS: dict[str, tuple[Callable[[np.random.Generator], Scene], tuple[str, ...]]] = {
    "gap of two seconds": (with_a_gap, ()),
    "half the frames dropped": (with_half_of_the_frames, ()),
    "sign turned": (negated, ()),
    "no overlap": (without_overlap, ("overlap",)),
    "static": (partial(wiggle_scene, motion="static"), ("share",)),
    "constant": (partial(wiggle_scene, motion="constant"), ("nothing moved",)),
    "offset beyond the search": (
        partial(wiggle_scene, offset_s=0.8),
        ("share", "end of the search", "search range", "repeats"),
    ),
}
"""By name: a function that draws both streams; words of a refusal, if it must be refused."""


@pytest.mark.parametrize("draw", [0, *heavy(1, 2, 3, 4)])
@pytest.mark.parametrize("name", MOTIONS)
def test_bad_motion_is_refused_or_gives_the_offset(name: str, draw: int) -> None:
    make, reasons = MOTIONS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = time_offset(*make(np.random.default_rng((20 + list(MOTIONS).index(name), draw))))
    if reasons:
        assert found.offset_s is None
        assert any(reason in str(found.assessment) for reason in reasons), found.assessment
    else:
        assert found.offset_s == pytest.approx(OFFSET_S, abs=2e-3)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t, v: (t + 3 * 3600 * 10**9 * (np.arange(len(t)) > len(t) // 2), v), "jumps"),
        (lambda t, v: ((t / 1e9).astype(np.float32), v), "integer ns"),
        (lambda t, v: (t[:5], v[:5]), "at least 20 are needed"),
        (lambda t, v: (t[:0], v[:0]), "at least 20 are needed"),
    ],
    ids=["clock jumps by hours", "float32 seconds", "five samples", "empty"],
)
def test_unusable_stream_is_refused(change: Callable[..., tuple[Any, Any]], reason: str) -> None:
    _, camera = wiggle_scene(np.random.default_rng(1))
    with pytest.raises(CalibrationError, match=reason):
        make_stream(*change(camera.time_ns, camera.values), "camera")


@pytest.mark.parametrize(
    ("factor", "rates_hz", "said"),
    [
        (1e-3, (30, 60, 500), "microseconds or ms"),
        (1e-6, (30, 60, 500), "microseconds or ms"),
        (1e3, (30, 60, 500), r"in ms\?"),
        (60.0, (30,), r"in ms\?"),  # at a higher rate it could be a stream of 1 to 8 Hz
    ],
    ids=["us as ns", "ms as ns", "ms as s", "seconds as minutes"],
)
def test_times_of_another_unit_are_refused(factor: float, rates_hz: tuple[int, ...], said: str) -> None:
    for rate_hz in rates_hz:
        times = (np.arange(20 * rate_hz) * 1e9 / rate_hz * factor).astype(np.int64)
        with pytest.raises(CalibrationError, match=said):
            make_stream(times, np.sin(np.arange(len(times))), "camera")


@pytest.mark.parametrize(("repeats", "apart_ns"), [(2, 50_000), (5, 1_000), (20, 0), (20, 50_000)])
def test_repeated_samples_of_a_stream_do_not_lower_sigma(repeats: int, apart_ns: int) -> None:
    def again(stream: TimedSignal) -> TimedSignal:
        shifts = np.arange(repeats) * apart_ns // repeats
        times = (stream.time_ns[:, None] // 100_000 * 100_000 + shifts).ravel()
        return make_stream(times, np.repeat(stream.values, repeats), "stream")

    streams = wiggle_scene(np.random.default_rng(0))
    once, found = time_offset(*streams), time_offset(*map(again, streams))
    assert found.sigma_s == pytest.approx(once.sigma_s, rel=0.05)
    assert found.used == once.used


WAVES: dict[str, Callable[[Array], Array]] = {
    "sine": lambda cycles: np.sin(2 * np.pi * cycles),
    "triangle": lambda cycles: 2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles)),
    "pauses at both ends": lambda cycles: np.clip(1.8 * np.sin(2 * np.pi * cycles), -1, 1),
    "uneven": lambda cycles: np.sin(2 * np.pi * cycles) + 0.4 * np.sin(4 * np.pi * cycles + 1),
    "short presses": lambda cycles: np.exp(-(((cycles % 1 - 0.5) / 0.12) ** 2)),
}
OFFSETS_S = st.floats(-0.3, 0.3)
NOISE = st.sampled_from((0.0, 1e-4, 1e-3, 1e-2))
RATES_HZ = st.sampled_from((50, 125, 500))
CAMERAS_HZ = st.sampled_from((25, 30, 60))


def offset_of(
    motion: Callable[[Array], Array], offset_s: float, noise: float, rate_hz: int, camera_hz: float = 30.0
) -> TimeOffset:
    rng = np.random.default_rng(0)
    robot_s, camera_s = np.arange(0, 20, 1 / rate_hz), np.arange(0, 20, 1 / camera_hz) + 0.003
    camera_s = camera_s[rng.random(len(camera_s)) > 0.03]
    robot = motion(robot_s) + noise * rng.standard_normal(len(robot_s))
    camera = 3 * motion(camera_s) + 3 * noise * rng.standard_normal(len(camera_s))
    stamps = (np.rint(1e9 * t).astype(np.int64) for t in (robot_s, camera_s - offset_s))
    return time_offset(make_stream(next(stamps), robot, "robot"), make_stream(next(stamps), camera, "camera"))


@pytest.mark.heavy
@given(
    st.sampled_from(list(WAVES)), st.floats(0.1, 0.48), OFFSETS_S, NOISE | st.just(0.1), RATES_HZ, CAMERAS_HZ
)
def test_steady_motion_is_refused_with_its_period(
    wave: str, period_s: float, offset_s: float, noise: float, rate_hz: int, camera_hz: float
) -> None:
    found = offset_of(lambda t: WAVES[wave](t / period_s), offset_s, noise, rate_hz, camera_hz)
    assert found.assessment.verdict is Verdict.REFUSED
    assert found.offset_s is None


@pytest.mark.heavy
@pytest.mark.parametrize(("period_ms", "noise"), [(147, 0.0), (200, 1e-3), (300, 1e-2), (463, 0.0)])
def test_refusal_states_the_period(noise: float, period_ms: float) -> None:
    for wave in WAVES.values():
        found = offset_of(lambda t, wave=wave: wave(1e3 * t / period_ms), 0.037, noise, 50)
        reason = found.assessment.reasons[0]
        assert "move irregularly" in reason
        stated_ms = float(reason.split("every ")[1].split(" ms")[0])
        assert stated_ms == pytest.approx(max(round(stated_ms / period_ms), 1) * period_ms, abs=6)


@pytest.mark.heavy
@given(st.integers(0, 1000), st.floats(0.15, 0.7), OFFSETS_S, NOISE, RATES_HZ)
def test_to_and_fro_motion_with_uneven_periods_is_right_or_refused(
    seed: int, period_s: float, offset_s: float, noise: float, rate_hz: int
) -> None:
    """Periods that vary by 0.3 to 10 %, as by hand; the more they vary, the better the offset is known."""
    rng = np.random.default_rng(seed)
    wave = WAVES[str(rng.choice(list(WAVES)))]
    lengths = period_s * (1 + 10 ** rng.uniform(-2.5, -1) * rng.standard_normal(round(25 / period_s)))
    starts = np.concatenate([[-1.0], -1.0 + np.cumsum(np.abs(lengths))])
    found = offset_of(lambda t: wave(np.interp(t, starts, np.arange(len(starts)))), offset_s, noise, rate_hz)
    if found.offset_s is not None:
        assert found.offset_s == pytest.approx(offset_s, abs=max(5 * (found.sigma_s or 0.0), 1.5e-3))


@pytest.mark.heavy
@given(st.integers(0, 1000), OFFSETS_S, NOISE, RATES_HZ)
def test_irregular_motion_is_accepted(seed: int, offset_s: float, noise: float, rate_hz: int) -> None:
    rng = np.random.default_rng(seed)
    tops_s = np.concatenate([[-1.0], -1.0 + np.cumsum(rng.uniform(0.3, 1.2, 80))])
    heights = rng.uniform(0.3, 1.0, len(tops_s)) * np.tile([1, -1], 41)[: len(tops_s)]
    found = offset_of(lambda t: np.interp(t, tops_s, heights), offset_s, noise, rate_hz)
    assert found.assessment.verdict is Verdict.GOOD
    assert found.offset_s == pytest.approx(offset_s, abs=max(5 * (found.sigma_s or 0.0), 1e-3))


@pytest.mark.parametrize("size", [2, 5])
def test_offset_of_bursts_with_one_time_is_correct(size: int) -> None:
    first, second = wiggle_scene(np.random.default_rng(4), offset_s=OFFSET_S)
    count = len(first.values) // size * size
    times = np.repeat(first.time_ns[size - 1 : count : size], size)
    read = make_stream(times, first.values[:count], "robot")
    found = time_offset(read, second)
    assert read.resolution_s == pytest.approx(size * np.median(np.diff(first.time_ns)) / 1e9)
    assert found.sigma_s > read.resolution_s / 4.0
    assert found.offset_s == pytest.approx(OFFSET_S, abs=2e-3)


def test_offset_from_coarse_times_is_refused_with_the_reason() -> None:
    first, second = wiggle_scene(np.random.default_rng(4), offset_s=OFFSET_S)
    tenths = make_stream(second.time_ns // 10**8 * 10**8, second.values, "camera")
    found = time_offset(first, tenths)
    assert found.offset_s is None
    assert "the times are too coarse" in found.assessment.refusals[0]


def test_irregular_bursts_are_refused() -> None:
    rng = np.random.default_rng(5)
    sizes = rng.choice([1, 12], 60)
    times = np.repeat(np.arange(60) * 10**8, sizes)
    with pytest.raises(CalibrationError, match="share their times irregularly: record the time"):
        make_stream(times, rng.normal(size=len(times)), "camera")


def test_sigma_is_at_least_that_of_the_digits_and_the_unit_of_two_fast_streams_is_asked(
    tmp_path: Path,
) -> None:
    robot, camera = wiggle_scene(np.random.default_rng(4), offset_s=OFFSET_S)
    for factor, digits in ((1.0, 6), (1.0, 2), (60.0, 9)):
        for name, stream in (("robot", robot), ("camera", camera)):
            times = [f"{time_ns / 1e9 / factor:.{digits}f}" for time_ns in stream.time_ns]
            rows = [f"{time},{value}" for time, value in zip(times, stream.values, strict=True)]
            (tmp_path / f"{name}.csv").write_text("\n".join(["t_s,value", *rows]))
        found = solve_pair(tmp_path, "robot", "camera", 0.5 / factor)
        offset = next(figure for figure in found.figures if figure.name == "add_to_stream_s")
        asked = [doubt for doubt in found.assessment.doubts if "are the times in minutes?" in doubt]
        assert len(asked) == (factor > 1.0)
        if factor == 1.0:
            assert offset.value is None or offset.sigma >= 10.0**-digits / np.sqrt(12.0)
