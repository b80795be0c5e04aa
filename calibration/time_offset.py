"""Offset and drift between two clocks, from one motion that both streams recorded.

Convention: `offset_s` is added to the times of the second stream to get those of the first; with a drift
`d` (ppm) the offset holds at the middle of the overlap and grows by d microseconds per second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.verdict import Assessment, limit
from drivers.errors import CalibrationError, counted

Array = NDArray[np.floating]

FEWEST = 20
_LEAST_EXPLAINED = 0.5
_WELL_EXPLAINED = 0.85
_NOT_NOISE = 0.6
"""Lag-1 autocorrelation of the residual above which it is not noise, whose own is near zero. Below that
share explained it tells of a wrong valley; above, of sensors that smooth differently, and widens sigma."""
_GRID_S = 0.002
_HILL = 1.05
_ROUNDS = 30
_DRIFT_FROM_S = 60.0
"""A drift is fitted to streams that overlap for a minute and more."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedSignal:
    """A signal on one clock: time_ns (N,) int64 increasing, values (N,) float64; dropped samples."""

    time_ns: NDArray[np.int64]
    values: Array
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """The answer. sigma_s, drift_sigma_ppm: one sigma. gain: second's values over first's, signed.

    explained: share of the second signal's variance that the first explains. noise: one sigma of
    the residual. offset_s is None where refused.
    """

    assessment: Assessment
    offset_s: float | None = None
    sigma_s: float | None = None
    drift_ppm: float | None = None
    drift_sigma_ppm: float | None = None
    gain: float | None = None
    explained: float | None = None
    noise: float | None = None
    used: int = 0
    overlap_s: float = 0.0


def make_stream(time_ns: NDArray[np.int64], values: Array, name: str) -> TimedSignal:
    """Sort samples by time and leave out repeated times and values that are not finite.

    Raises `CalibrationError` for times that are no integers, shapes that differ, a clock that jumps
    by more than an hour, or fewer than 20 samples.
    """
    times, signal = np.asarray(time_ns), np.asarray(values, np.float64)
    if times.dtype.kind not in "iu" or times.ndim != 1 or times.shape != signal.shape:
        raise CalibrationError(f"sync: {name}: times in integer ns and as many values are needed")
    finite = np.isfinite(signal)
    order = np.argsort(times[finite], kind="stable")
    times, signal = times[finite][order].astype(np.int64), signal[finite][order]
    fresh = np.append(True, np.diff(times) > 0) if len(times) else np.zeros(0, bool)
    times, signal = times[fresh], signal[fresh]
    if len(times) < FEWEST:
        raise CalibrationError(
            f"sync: {name}: {counted(len(times), 'usable sample')}, {FEWEST} are the least"
        )
    longest_s = float(np.diff(times).max()) / 1e9
    if longest_s > 3600.0:
        raise CalibrationError(f"sync: {name}: its clock jumps by {longest_s / 3600:.1f} h; record again")
    return TimedSignal(times, signal, len(finite) - len(times))


def unwrapped(counter: NDArray[np.integer], bits: int = 32) -> NDArray[np.int64]:
    """Unwrap a free-running counter that advances by less than half its range per step."""
    steps = np.diff(np.asarray(counter).astype(np.int64))
    turn = 1 << bits
    steps = (steps + turn // 2) % turn - turn // 2
    return int(counter[0]) + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def time_offset(first: TimedSignal, second: TimedSignal, search_s: float = 0.5) -> TimeOffset:
    """Find the offset within +- `search_s`, or say why these streams do not determine it.

    Least squares on the second signal against the first, interpolated, with free gain and level;
    a grid search finds the minimum, Gauss-Newton refines it.
    """
    zero = first.time_ns[0]
    t1, t2 = ((s.time_ns - zero).astype(np.float64) / 1e9 for s in (first, second))
    inside = (t2 > t1[0] + search_s) & (t2 < t1[-1] - search_s) & _measured(t1, t2, search_s)
    t2, wanted = t2[inside], second.values[inside]
    if len(t2) < FEWEST:
        text = f"the streams overlap by {counted(len(t2), 'sample')} (search ±{search_s:g} s): record longer"
        return TimeOffset(Assessment((text,)), used=len(t2))
    if min(np.ptp(first.values), np.ptp(wanted)) <= 0.0:
        return TimeOffset(Assessment(("nothing moved while this was recorded: wiggle by several degrees",)))
    grid = np.arange(-search_s, search_s + _GRID_S / 2, _GRID_S)
    costs = np.array([_explained(t1, first.values, t2 + g, wanted)[0] for g in grid])
    best = int(np.argmin(costs))
    return _refined(t1, first.values, t2, wanted, (grid, costs, best), search_s)


def _refined(
    t1: Array, signal: Array, t2: Array, wanted: Array, valley: tuple[Array, Array, int], search_s: float
) -> TimeOffset:
    grid, costs, best = valley
    middle, overlap = float(t2.mean()), float(np.ptp(t2))
    with_drift = overlap >= _DRIFT_FROM_S
    offset, drift = float(grid[best]), 0.0
    for _ in range(_ROUNDS):
        at = t2 + offset + drift * (t2 - middle)
        system, rest = _linearised(t1, signal, at, wanted, t2 - middle, with_drift)
        scale = np.maximum(np.linalg.norm(system, axis=0), 1e-12)
        step, *_ = np.linalg.lstsq(system / scale, rest, rcond=None)
        step = step / scale
        offset, drift = offset + float(step[0]), drift + (float(step[3]) if with_drift else 0.0)
        if abs(step[0]) < 1e-9:
            break
    at = t2 + offset + drift * (t2 - middle)
    cost, gain, noise = _explained(t1, signal, at, wanted)
    system, rest = _linearised(t1, signal, at, wanted, t2 - middle, with_drift)
    alike = _autocorrelation(rest)
    fewer = np.sqrt((1.0 + alike) / (1.0 - alike)) if 0.0 < alike < 0.999 else 1.0
    sigma = noise * _unit_sigmas(system) * fewer
    explained = 1.0 - cost / float(((wanted - wanted.mean()) ** 2).sum())
    distinct = _rival(grid, costs, best) >= _told_apart(len(t2) / fewer**2)
    assessment = _assess(explained, alike, float(sigma[0]), offset, search_s, distinct)
    if assessment.refusals:
        return TimeOffset(assessment, explained=explained, noise=noise, used=len(t2), overlap_s=overlap)
    return TimeOffset(
        assessment, offset, float(sigma[0]), 1e6 * drift if with_drift else None,
        1e6 * float(sigma[3]) if with_drift else None, gain, explained, noise, len(t2), overlap,
    )  # fmt: skip


def _assess(
    explained: float, autocorrelation: float, sigma_s: float, offset_s: float, search_s: float, distinct: bool
) -> Assessment:
    if not explained >= _LEAST_EXPLAINED or not np.isfinite(sigma_s):
        share = f"the signals share {max(explained, 0.0):.0%} of their motion only"
        return Assessment((f"{share}: wiggle by several degrees",))
    if explained < _WELL_EXPLAINED and autocorrelation > _NOT_NOISE:
        return Assessment(
            ("what the best offset leaves is no noise: the offset may lie beyond the end of the search",)
        )
    if abs(offset_s) > search_s - 2 * _GRID_S:
        return Assessment((f"the offset lies at the end of the search (+-{search_s:g} s): search wider",))
    if not distinct:
        return Assessment(
            ("another offset fits almost as well, because the motion repeats: wiggle at a changing rate",)
        )
    return limit(
        1e3 * sigma_s, 1.0, 5.0, "the offset is known to {value:.2f} ms only: wiggle faster or longer"
    )


def _autocorrelation(rest: Array) -> float:
    """Lag-1 autocorrelation of a series; 0 for a series of zeros."""
    power = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / power if power > 0.0 else 0.0


def _explained(t1: Array, signal: Array, at: Array, wanted: Array) -> tuple[float, float, float]:
    """Residual sum of squares, gain, and one sigma of the residual, at the best gain and level."""
    seen = np.interp(at, t1, signal)
    centred, goal = seen - seen.mean(), wanted - wanted.mean()
    power = float(centred @ centred)
    gain = float(centred @ goal) / power if power > 1e-12 else 0.0
    rest = goal - gain * centred
    cost = float(rest @ rest)
    return cost, gain, float(np.sqrt(cost / max(len(at) - 3, 1)))


def _linearised(
    t1: Array, signal: Array, at: Array, wanted: Array, from_middle: Array, with_drift: bool
) -> tuple[Array, Array]:
    """Derivatives by offset, gain, level (and drift), and the (N,) residual at the best gain and level."""
    _, gain, _ = _explained(t1, signal, at, wanted)
    seen = np.interp(at, t1, signal)
    half = max(float(np.median(np.diff(t1))), 2e-3)
    speed = (np.interp(at + half, t1, signal) - np.interp(at - half, t1, signal)) / (2 * half)
    columns = [gain * speed, seen - seen.mean(), np.ones_like(at)]
    if with_drift:
        columns.append(gain * speed * from_middle)
    return np.column_stack(columns), wanted - wanted.mean() - gain * (seen - seen.mean())


def _unit_sigmas(system: Array) -> Array:
    """One sigma of each parameter for noise of one, by SVD; infinite where nothing determines it."""
    scale = np.linalg.norm(system, axis=0)
    if (scale < 1e-12).any():
        return np.full(system.shape[1], np.inf)
    _, strengths, directions = np.linalg.svd(system / scale, full_matrices=False)
    return np.linalg.norm(directions / np.maximum(strengths, 1e-15)[:, None], axis=0) / scale


def _rival(grid: Array, costs: Array, best: int) -> float:
    """Cost of the second-best valley over that of the best one; 1 means equally good.

    Between valleys is a hill; noise makes many small minima in one.
    """
    inner = (costs[1:-1] < costs[:-2]) & (costs[1:-1] <= costs[2:])
    others = [
        costs[i]
        for i in np.flatnonzero(inner) + 1
        if abs(i - best) > 2 and costs[min(i, best) : max(i, best) + 1].max() > _HILL * costs[i]
    ]
    return float(min(others) / max(costs[best], 1e-300)) if others else np.inf


def _told_apart(samples: float) -> float:
    """By how much the second-best minimum has to be worse: of many samples, less than of few."""
    return float(np.clip(1.0 + 25.0 / max(samples, 1.0), 1.15, 1.5))


def _measured(t1: Array, t2: Array, search_s: float) -> NDArray[np.bool_]:
    """Samples of the second stream around which the first one has no gap."""
    gap = np.diff(t1)
    allowed = max(10.0 * float(np.median(gap)), 0.02)
    starts = t1[:-1][gap > allowed] - search_s
    ends = t1[1:][gap > allowed] + search_s
    outside = np.ones(len(t2), bool)
    for start, end in zip(starts, ends, strict=True):
        outside &= (t2 < start) | (t2 > end)
    return outside
