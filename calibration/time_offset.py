"""Estimate offset and drift between two clocks from one motion that both streams recorded.

Convention: `offset_s` is added to the times of the second stream to get those of the first. With a drift
`d` (ppm) the offset holds at the middle of the overlap and grows by d microseconds per second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

from calibration.verdict import Assessment, limit
from drivers.errors import CalibrationError, counted
from drivers.progress import steps

Array = NDArray[np.floating]

FEWEST = 20
"""Fewest samples of a stream, and of the overlap."""
_LEAST_EXPLAINED = 0.5
_WELL_EXPLAINED = 0.85
"""Fractions of explained variance: below the first the result is refused; see `_NOT_NOISE` for the second."""
_NOT_NOISE = 0.6
"""Lag-1 autocorrelation above which the residual is not noise, whose own is near zero. If less than
`_WELL_EXPLAINED` is explained, it indicates a wrong minimum; otherwise sensors with different smoothing, and
it increases sigma."""
_GRID_S = 0.002
"""Step of the grid search."""
_HILL = 1.05
"""Two minima are distinct if the cost between them exceeds the higher one by this factor."""
_ROUNDS = 30
"""Most iterations of the refinement."""
_DRIFT_FROM_S = 60.0
"""Shortest overlap for which a drift is fitted."""
_SPAN_NS = 100_000_000
"""Interval over which an angular speed is measured: shorter is noisy, longer smooths the motion away."""
_AROUND = 15
"""Samples of the running median: more than twice the spikes that one flip of a detector causes."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedSignal:
    """A signal on one clock: time_ns (N,) int64 increasing, values (N,) float64."""

    time_ns: NDArray[np.int64]
    values: Array


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """The result. sigma_s, drift_sigma_ppm: one sigma. gain: second signal over first, signed.

    explained: fraction of the second signal's variance that the first explains. offset_s is None if refused;
    drift_ppm is None for a short overlap.
    """

    assessment: Assessment
    offset_s: float | None = None
    sigma_s: float | None = None
    drift_ppm: float | None = None
    drift_sigma_ppm: float | None = None
    gain: float | None = None
    explained: float | None = None
    used: int = 0


def make_stream(time_ns: NDArray[np.int64], values: Array, name: str) -> TimedSignal:
    """Sort samples by time; remove repeated times, and values that are NaN or infinite.

    name: of the stream, for errors. Raises `CalibrationError` for times that are not integers, shapes that
    differ, a clock that jumps by more than an hour, or fewer than 20 samples.
    """
    times, signal = np.asarray(time_ns), np.asarray(values, np.float64)
    if times.dtype.kind not in "iu" or times.ndim != 1 or times.shape != signal.shape:
        raise CalibrationError(f"sync: {name}: times in integer ns and as many values are needed")
    times = times.astype(np.int64)
    usable = _in_order(times, np.isfinite(signal))
    if len(usable) < FEWEST:
        raise CalibrationError(
            f"sync: {name}: {counted(len(usable), 'usable sample')}; at least {FEWEST} are needed"
        )
    longest_s = float(np.diff(times[usable]).max()) / 1e9
    if longest_s > 3600.0:
        raise CalibrationError(f"sync: {name}: its clock jumps by {longest_s / 3600:.1f} h; record again")
    return TimedSignal(times[usable], signal[usable])


def turning_rate(
    time_ns: NDArray[np.int64], quaternions_xyzw: NDArray[np.floating], name: str
) -> TimedSignal:
    """Return the angular speed in rad/s over 0.1 s around each time; orientations are interpolated by slerp.

    A robot and a camera on it have the same speed in any frame, so no hand-eye transform is needed (Furrer et
    al. 2017 correlate speeds). time_ns: (N,) int64; quaternions_xyzw: (N, 4), invalid ones are skipped.
    Raises `CalibrationError` if too few valid orientations remain, and as `make_stream` does.
    """
    times, values = np.asarray(time_ns), np.asarray(quaternions_xyzw, np.float64)
    if values.shape != (len(times), 4):
        raise CalibrationError(f"sync: {name}: (N, 4) quaternions for N times are needed, got {values.shape}")
    # the comparison is False for NaN
    usable = _in_order(times, np.abs(np.linalg.norm(values, axis=1) - 1.0) < 0.01)
    times, values = times[usable], values[usable]
    middle = times[_inside(times)] if len(times) else times
    if not len(middle):
        raise CalibrationError(
            f"sync: {name}: no orientations over 0.1 s without a gap; is the stream too slow?"
        )
    turn = Slerp(times - times[0], Rotation.from_quat(values))
    before, after = (turn(middle - times[0] + step) for step in (-_SPAN_NS // 2, _SPAN_NS // 2))
    rates = (before.inv() * after).magnitude() / (_SPAN_NS / 1e9)
    return make_stream(middle, np.where(_spikes(rates), np.nan, rates), name)


def _in_order(times: NDArray[np.int64], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices of usable samples, sorted by time, without repeated times."""
    found = np.flatnonzero(usable)
    found = found[np.argsort(times[found], kind="stable")]
    return found[np.diff(times[found], prepend=times[found[:1]] - 1) > 0]


def _inside(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether there are samples up to half a span on each side, without a large gap."""
    half = _SPAN_NS // 2
    first, last = np.searchsorted(times, times - half, "right") - 1, np.searchsorted(times, times + half)
    whole = (first >= 0) & (last < len(times))
    wide = np.zeros(len(times), bool)
    wide[whole] = times[last[whole]] - times[first[whole]] < 3 * _SPAN_NS
    return wide


def _spikes(rates: NDArray[np.floating]) -> NDArray[np.bool_]:
    """(N,) whether a rate is an outlier among its neighbours, as when a detector mirrors the target.

    Hampel filter: more than five robust standard deviations from the running median.
    """
    middle = median_filter(rates, _AROUND, mode="nearest")
    away = np.abs(rates - middle)
    usual = median_filter(away, 8 * _AROUND + 1, mode="nearest")
    return away > 5.0 * 1.4826 * usual + 0.05


def time_offset(first: TimedSignal, second: TimedSignal, search_s: float = 0.5) -> TimeOffset:
    """Find the offset within +- `search_s`, or report why these streams do not determine it.

    Least squares of the second signal against the interpolated first one, with free gain and level. A grid
    search finds the minimum, Gauss-Newton refines it.
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
    costs = np.array([_explained(t1, first.values, t2 + g, wanted)[0] for g in steps(grid)])
    best = int(np.argmin(costs))
    return _refined(t1, first.values, t2, wanted, (grid, costs, best), search_s)


def _refined(
    t1: Array, signal: Array, t2: Array, wanted: Array, valley: tuple[Array, Array, int], search_s: float
) -> TimeOffset:
    grid, costs, best = valley
    from_middle, with_drift = t2 - float(t2.mean()), float(np.ptp(t2)) >= _DRIFT_FROM_S
    offset, drift = float(grid[best]), 0.0
    for _ in range(_ROUNDS):
        at = t2 + offset + drift * from_middle
        system, rest = _linearised(t1, signal, at, wanted, from_middle, with_drift)
        scale = np.maximum(np.linalg.norm(system, axis=0), 1e-12)
        step, *_ = np.linalg.lstsq(system / scale, rest, rcond=None)
        step = step / scale
        offset, drift = offset + float(step[0]), drift + (float(step[3]) if with_drift else 0.0)
        if abs(step[0]) < 1e-9:
            break
    at = t2 + offset + drift * from_middle
    cost, gain, noise = _explained(t1, signal, at, wanted)
    system, rest = _linearised(t1, signal, at, wanted, from_middle, with_drift)
    alike = _autocorrelation(rest)
    fewer = np.sqrt((1.0 + alike) / (1.0 - alike)) if 0.0 < alike < 0.999 else 1.0
    sigma = noise * _unit_sigmas(system) * fewer
    explained = 1.0 - cost / float(((wanted - wanted.mean()) ** 2).sum())
    # with many samples, a smaller difference to the second-best minimum is significant
    distinct = _rival(grid, costs, best) >= np.clip(1.0 + 25.0 / max(len(t2) / fewer**2, 1.0), 1.15, 1.5)
    assessment = _assess(explained, alike, float(sigma[0]), offset, search_s, bool(distinct))
    if assessment.refusals:
        return TimeOffset(assessment, explained=explained, used=len(t2))
    drifts = (1e6 * drift, 1e6 * float(sigma[3])) if with_drift else (None, None)
    return TimeOffset(assessment, offset, float(sigma[0]), *drifts, gain, explained, len(t2))


def _assess(
    explained: float, autocorrelation: float, sigma_s: float, offset_s: float, search_s: float, distinct: bool
) -> Assessment:
    if not explained >= _LEAST_EXPLAINED or not np.isfinite(sigma_s):
        share = f"the signals share only {max(explained, 0.0):.0%} of their motion"
        reason = f"{share}: wiggle by several degrees"
    elif explained < _WELL_EXPLAINED and autocorrelation > _NOT_NOISE:
        reason = "the residual at the best offset is not noise: the offset may lie outside the search range"
    elif abs(offset_s) > search_s - 2 * _GRID_S:
        reason = f"the offset lies at the end of the search (+-{search_s:g} s): search wider"
    elif not distinct:
        reason = "another offset fits almost as well, because the motion repeats: wiggle at a changing rate"
    else:
        return limit(
            1e3 * sigma_s, 1.0, 5.0, "the offset is known to {value:.2f} ms only: wiggle faster or longer"
        )
    return Assessment((reason,))


def _autocorrelation(rest: Array) -> float:
    """Return the lag-1 autocorrelation of a series; 0 for a series of zeros."""
    power = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / power if power > 0.0 else 0.0


def _explained(t1: Array, signal: Array, at: Array, wanted: Array) -> tuple[float, float, float]:
    """Return the residual sum of squares, the gain, and one sigma of the residual, at the best fit."""
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
    """Return derivatives by offset, gain, level (and drift), and the (N,) residual at the best fit."""
    _, gain, _ = _explained(t1, signal, at, wanted)
    seen = np.interp(at, t1, signal)
    half = max(float(np.median(np.diff(t1))), 2e-3)
    speed = (np.interp(at + half, t1, signal) - np.interp(at - half, t1, signal)) / (2 * half)
    columns = [gain * speed, seen - seen.mean(), np.ones_like(at)]
    if with_drift:
        columns.append(gain * speed * from_middle)
    return np.column_stack(columns), wanted - wanted.mean() - gain * (seen - seen.mean())


def _unit_sigmas(system: Array) -> Array:
    """Return one sigma of each parameter for unit noise, by SVD; infinite if undetermined."""
    scale = np.linalg.norm(system, axis=0)
    if (scale < 1e-12).any():
        return np.full(system.shape[1], np.inf)
    _, strengths, directions = np.linalg.svd(system / scale, full_matrices=False)
    return np.linalg.norm(directions / np.maximum(strengths, 1e-15)[:, None], axis=0) / scale


def _rival(grid: Array, costs: Array, best: int) -> float:
    """Return the ratio of the costs of the second-best and the best minimum; 1 means equally good.

    Two minima count as different only if there is a hill between them, because noise creates many small
    minima.
    """
    inner = (costs[1:-1] < costs[:-2]) & (costs[1:-1] <= costs[2:])
    others = [
        costs[i]
        for i in np.flatnonzero(inner) + 1
        if abs(i - best) > 2 and costs[min(i, best) : max(i, best) + 1].max() > _HILL * costs[i]
    ]
    return float(min(others) / max(costs[best], 1e-300)) if others else np.inf


def _measured(t1: Array, t2: Array, search_s: float) -> NDArray[np.bool_]:
    """(N,) whether the first stream has no gap around each sample of the second."""
    gap = np.diff(t1)
    allowed = max(10.0 * float(np.median(gap)), 0.02)
    starts = t1[:-1][gap > allowed] - search_s
    ends = t1[1:][gap > allowed] + search_s
    outside = np.ones(len(t2), bool)
    for start, end in zip(starts, ends, strict=True):
        outside &= (t2 < start) | (t2 > end)
    return outside
