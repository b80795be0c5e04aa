"""Estimate offset and drift between two clocks from one motion that both streams recorded.

Streams are made from values or from orientations. Convention: `offset_s` is added to the times of the second
stream to get those of the first. With a drift `d` (ppm) the offset holds at the middle of the overlap and
grows by d microseconds per second.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

from calibration.bursts import SAME_NS, spread_bursts
from calibration.order import Change, assess_order, find_change
from calibration.verdict import Assessment, limits
from drivers.errors import CalibrationError, plural
from drivers.progress import steps

Array = NDArray[np.floating]

FEWEST = 20
"""Fewest samples of a stream, and of the overlap."""
SHORTEST_S, LONGEST_S = 0.2, 1.0
"""Shortest stream, and longest usual interval of its samples; beyond them, times have another unit."""
_SPAN_NS = 100_000_000
"""Interval over which an angular speed is measured: shorter is noisy, longer smooths the motion away."""
_AROUND = 15
"""Samples of the running median: more than twice the spikes that one flip of a detector causes."""
WORST_MS = 5.0
"""Largest standard deviation of an offset that is used, ms."""
_LEAST_EXPLAINED = 0.5
_WELL_EXPLAINED = 0.85
"""Fractions of explained variance: below the first the result is refused; see `_NOT_NOISE` for the second."""
_NOT_NOISE = 0.6
"""Lag-1 autocorrelation above which the residual is not noise, whose own is near zero. If less than
`_WELL_EXPLAINED` is explained, it indicates a wrong minimum; otherwise sensors with different smoothing, and
it increases sigma."""
_SPEED_S = 0.01
"""Half of the time over which the signal's speed is computed. Over less, noise counts as speed and sigma is
too small; the speed of a hand or an arm changes more slowly."""
_GRID_S = 0.002
"""Step of the grid search."""
_HILL = 1.05
"""Two minima are distinct if the cost between them exceeds the higher one by this factor."""
_ROUNDS = 30
"""Most iterations of the refinement."""
_MOST_VALLEYS = 12
"""Most minima of the grid search that are refined; the lowest ones are."""
_CLEARLY_WORSE = 25.0
"""A rival offset is excluded by the noise if twice the difference of log likelihoods exceeds this: its sum of
squares is larger by this fraction of the effective number of samples, and at least by 15 %."""
_BLOCK_S, _MOST_BLOCKS = 0.5, 24
"""Least length, s, and most blocks of time that are compared: a block holds a swing of the hand."""
_CLOCK_SET = "a clock was set or paused there: record again without it"
_DRIFT_FROM_S = 60.0
"""Shortest overlap for which a drift is fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedSignal:
    """A signal on one clock: time_ns (N,) int64 increasing, values (N,) float64.

    resolution_s: interval of the recorded times if several samples shared each, or of their digits, else 0.
    """

    time_ns: NDArray[np.int64]
    values: Array
    resolution_s: float = 0.0


def make_stream(time_ns: NDArray[np.int64], values: Array, name: str) -> TimedSignal:
    """Sort samples by time; remove repeated samples (within 0.1 ms), and values that are NaN or infinite.

    Regular bursts of different values with one time are spread over the time since the burst before. name: of
    the stream, for errors. Raises `CalibrationError` for times that are not integers, shapes that differ, a
    clock that jumps by more than an hour, irregular bursts, or fewer than 20 samples.
    """
    times, signal = np.asarray(time_ns), np.asarray(values, np.float64)
    if times.dtype.kind not in "iu" or times.ndim != 1 or times.shape != signal.shape:
        raise CalibrationError(f"sync: {name}: times in integer ns and as many values are needed")
    times, resolution_s = _without_bursts(times.astype(np.int64), signal[:, None], name)
    finite = np.isfinite(signal)
    usable = _in_order(times, finite)
    count, lasts_s = int(finite.sum()), float(np.ptp(times[finite])) / 1e9 if finite.any() else 0.0
    interval_s = float(np.median(np.diff(times[usable]))) / 1e9 if len(usable) > 1 else 0.0
    if count >= FEWEST and (0.0 < lasts_s < SHORTEST_S or interval_s > LONGEST_S):
        unit = "ms" if interval_s > LONGEST_S else "microseconds or ms"
        raise CalibrationError(
            f"sync: {name}: {count} samples in {lasts_s:.4g} s: time_ns is in ns and t_s in s; are the times "
            f"in {unit}?"
        )
    if len(usable) < FEWEST:
        raise CalibrationError(
            f"sync: {name}: {plural(len(usable), 'usable sample')}; at least {FEWEST} are needed"
        )
    longest_s = float(np.diff(times[usable]).max()) / 1e9
    if longest_s > 3600.0:
        raise CalibrationError(f"sync: {name}: its clock jumps by {longest_s / 3600:.1f} h; record again")
    return TimedSignal(times[usable], signal[usable], resolution_s)


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
    times, resolution_s = _without_bursts(times, values, name)
    # the comparison is False for NaN
    usable = _in_order(times, np.abs(np.linalg.norm(values, axis=1) - 1.0) < 0.01)
    times, values = times[usable], values[usable]
    middle = times
    if len(times):  # samples up to half a span on each side, without a large gap
        half = _SPAN_NS // 2
        first = np.searchsorted(times, times - half, "right") - 1
        last = np.searchsorted(times, times + half)
        whole = (first >= 0) & (last < len(times))
        wide = np.zeros(len(times), bool)
        wide[whole] = times[last[whole]] - times[first[whole]] < 3 * _SPAN_NS
        middle = times[wide]
    if not len(middle):
        raise CalibrationError(
            f"sync: {name}: no orientations over 0.1 s without a gap; is the stream too slow?"
        )
    turn = Slerp(times - times[0], Rotation.from_quat(values))
    before, after = (turn(middle - times[0] + step) for step in (-_SPAN_NS // 2, _SPAN_NS // 2))
    rates = (before.inv() * after).magnitude() / (_SPAN_NS / 1e9)
    # Hampel filter: a detector that mirrors the target gives rates more than five robust standard deviations
    # from the running median
    away = np.abs(rates - median_filter(rates, _AROUND, mode="nearest"))
    usual = median_filter(away, 8 * _AROUND + 1, mode="nearest")
    stream = make_stream(middle, np.where(away > 5.0 * 1.4826 * usual + 0.05, np.nan, rates), name)
    return replace(stream, resolution_s=resolution_s)


def _without_bursts(times: NDArray[np.int64], values: Array, name: str) -> tuple[NDArray[np.int64], float]:
    """Return times (N,) in which bursts of different values are spread, and the interval of the bursts, s.

    values: (N, K). See `spread_bursts`. Raises `CalibrationError` for irregular bursts.
    """
    order, spread = np.argsort(times, kind="stable"), np.empty_like(times)
    copied = np.all(np.diff(values[order], axis=0, prepend=np.nan) == 0.0, axis=1)
    found = spread_bursts(times[order], copied)
    if found is None:
        raise CalibrationError(
            f"sync: {name}: {plural(len(times), 'sample')} share their times irregularly: record the time of "
            "each sample"
        )
    spread[order] = found[0]
    return spread, found[1]


def _in_order(times: NDArray[np.int64], usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices of usable samples, sorted by time; of samples within `SAME_NS` the first."""
    found = np.flatnonzero(usable)
    found = found[np.argsort(times[found], kind="stable")]
    _, first = np.unique(times[found] // SAME_NS, return_index=True)
    return found[first]


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


def time_offset(
    first: TimedSignal, second: TimedSignal, search_s: float = 0.5, worst_ms: float = WORST_MS
) -> TimeOffset:
    """Find the offset within +- `search_s`, or report why these streams do not determine it.

    Least squares of the second signal against the interpolated first one, with free gain and level. A grid
    search finds the minima, Gauss-Newton refines each of them, and the lowest one is the result. The result
    is refused if another minimum is equally likely, or its standard deviation exceeds `worst_ms`.
    """
    zero = first.time_ns[0]
    t1, t2 = ((s.time_ns - zero).astype(np.float64) / 1e9 for s in (first, second))
    inside = (t2 > t1[0] + search_s) & (t2 < t1[-1] - search_s)
    gap = np.diff(t1)
    wide = gap > max(10.0 * float(np.median(gap)), 0.02)
    for start, end in zip(t1[:-1][wide] - search_s, t1[1:][wide] + search_s, strict=True):
        inside &= (t2 < start) | (t2 > end)
    t2, wanted = t2[inside], second.values[inside]
    if len(t2) < FEWEST:
        text = f"the streams overlap by {plural(len(t2), 'sample')} (search ±{search_s:g} s): record longer"
        return TimeOffset(Assessment((text,)), used=len(t2))
    if min(np.ptp(first.values), np.ptp(wanted)) <= 0.0:
        return TimeOffset(Assessment(("nothing moved while this was recorded: wiggle by several degrees",)))
    streams = _Streams(t1, first.values, t2, wanted)
    grid = np.arange(-search_s, search_s + _GRID_S / 2, _GRID_S)
    costs = np.array([streams.fit(float(g)).cost for g in steps(grid)])
    minima = sorted((streams.refine(float(grid[i])) for i in _valleys(costs)), key=lambda m: m.cost)
    # Whether times are rounded up, down or to the nearest is unknown.
    rounding_s = math.hypot(first.resolution_s, second.resolution_s) / math.sqrt(12.0)
    return _result(streams, minima, search_s, worst_ms, rounding_s)


@dataclass(frozen=True, slots=True)
class _Minimum:
    """A fit at an offset: cost is the residual sum of squares, noise one sigma of a residual."""

    offset_s: float
    drift: float
    cost: float
    gain: float
    noise: float


@dataclass(frozen=True, slots=True, eq=False)
class _Streams:
    """Both streams, times in s on their own clocks; t2 only where all searched offsets fall inside t1."""

    t1: Array
    signal: Array
    t2: Array
    wanted: Array

    @property
    def with_drift(self) -> bool:
        return float(np.ptp(self.t2)) >= _DRIFT_FROM_S

    def at(self, offset_s: float, drift: float) -> Array:
        return self.t2 + offset_s + drift * (self.t2 - float(self.t2.mean()))

    def fit(self, offset_s: float, drift: float = 0.0) -> _Minimum:
        """Fit gain and level at an offset."""
        seen = np.interp(self.at(offset_s, drift), self.t1, self.signal)
        centred, goal = seen - seen.mean(), self.wanted - self.wanted.mean()
        power = float(centred @ centred)
        gain = float(centred @ goal) / power if power > 1e-12 else 0.0
        rest = goal - gain * centred
        cost = float(rest @ rest)
        return _Minimum(offset_s, drift, cost, gain, float(np.sqrt(cost / max(len(self.t2) - 3, 1))))

    def refine(self, offset_s: float) -> _Minimum:
        """Refine a minimum of the grid by Gauss-Newton; return the grid's if that does not lower the cost."""
        offset, drift = offset_s, 0.0
        for _ in range(_ROUNDS):
            system, rest = self.linearise(offset, drift)
            scale = np.maximum(np.linalg.norm(system, axis=0), 1e-12)
            step = np.linalg.lstsq(system / scale, rest, rcond=None)[0] / scale
            offset, drift = offset + float(step[0]), drift + (float(step[3]) if self.with_drift else 0.0)
            if abs(step[0]) < 1e-9:
                break
        found, start = self.fit(offset, drift), self.fit(offset_s)
        return found if found.cost <= start.cost else start

    def linearise(self, offset_s: float, drift: float) -> tuple[Array, Array]:
        """Return derivatives by offset, gain, level (and drift), and the (N,) residual at the best fit."""
        at, gain = self.at(offset_s, drift), self.fit(offset_s, drift).gain
        seen = np.interp(at, self.t1, self.signal)
        half = max(float(np.median(np.diff(self.t1))), _SPEED_S)
        ends = np.interp(at + half, self.t1, self.signal), np.interp(at - half, self.t1, self.signal)
        speed = gain * (ends[0] - ends[1]) / (2 * half)
        columns = [speed, seen - seen.mean(), np.ones_like(at)]
        if self.with_drift:
            columns.append(speed * (self.t2 - float(self.t2.mean())))
        return np.column_stack(columns), self.wanted - self.wanted.mean() - gain * columns[1]


def _result(
    streams: _Streams, minima: list[_Minimum], search_s: float, worst_ms: float, rounding_s: float
) -> TimeOffset:
    """Return the lowest minimum with its sigma and verdict. rounding_s: sigma of the recorded times."""
    best, count = minima[0], len(streams.t2)
    system, rest = streams.linearise(best.offset_s, best.drift)
    power = float(rest @ rest)
    alike = float(rest[1:] @ rest[:-1]) / power if power > 0.0 else 0.0  # lag-1 autocorrelation
    fewer = np.sqrt((1.0 + alike) / (1.0 - alike)) if 0.0 < alike < 0.999 else 1.0
    scale, unit = np.linalg.norm(system, axis=0), np.full(system.shape[1], np.inf)
    if not (scale < 1e-12).any():  # otherwise a parameter is undetermined
        _, strengths, directions = np.linalg.svd(system / scale, full_matrices=False)
        unit = np.linalg.norm(directions / np.maximum(strengths, 1e-15)[:, None], axis=0) / scale
    sigma = best.noise * unit * fewer
    change, blocks = _find_change(streams, system, rest)
    if change is not None:
        sigma = np.hypot(sigma, np.sqrt(np.diag(change.spread)))
    explained = 1.0 - best.cost / float(((streams.wanted - streams.wanted.mean()) ** 2).sum())
    period_s = _period_s(streams, minima, count / fewer**2)
    sigma_s, assessment = math.hypot(float(sigma[0]), rounding_s), None
    if not explained >= _LEAST_EXPLAINED or not np.isfinite(sigma_s):
        share = f"the signals share only {max(explained, 0.0):.0%} of their motion"
        reason = f"{share}: wiggle by several degrees"
    elif explained < _WELL_EXPLAINED and alike > _NOT_NOISE:
        reason = "the residual at the best offset is not noise: the offset may lie outside the search range"
    elif period_s is not None:
        reason = f"the motion repeats every {1e3 * period_s:.0f} ms, so several offsets fit: move irregularly"
    elif abs(best.offset_s) > search_s - 2 * _GRID_S:
        reason = f"the offset lies at the end of the search (+-{search_s:g} s): search wider"
    else:
        cure = "wiggle faster or longer" if change is None else _CLOCK_SET
        if rounding_s > float(sigma[0]):
            cure = "the times are too coarse: record the time of each sample, with more digits"
        reason = f"the offset is known to {{value:.2f}} ms only: {cure}"
        order = assess_order(change, blocks, [("the offset", 1e3, "ms", min(1.0, worst_ms))], _CLOCK_SET)
        assessment = order + limits((1e3 * sigma_s, min(1.0, worst_ms), worst_ms, reason))
    assessment = assessment or Assessment((reason,))
    if assessment.refusals:
        return TimeOffset(assessment, explained=explained, used=count)
    drifts = (1e6 * best.drift, 1e6 * float(sigma[3])) if streams.with_drift else (None, None)
    return TimeOffset(assessment, best.offset_s, sigma_s, *drifts, best.gain, explained, count)


def _find_change(streams: _Streams, system: Array, rest: Array) -> tuple[Change | None, int]:
    """Compare blocks of time of at least `_BLOCK_S`, and return their number too."""
    times = streams.t2 - streams.t2[0]
    count = int(min(_MOST_BLOCKS, times[-1] // _BLOCK_S))
    edges = np.linspace(0.0, times[-1], count + 1)[1:-1]
    cuts = np.searchsorted(times, edges)
    ids = [f"{end:.1f} s" for end in (*edges, times[-1])]
    return find_change(ids, np.split(system, cuts), np.split(rest, cuts)), count


def _period_s(streams: _Streams, minima: list[_Minimum], independent: float) -> float | None:
    """Return the period of a motion that repeats, s, or None if no other minimum is as likely as the best.

    independent: effective number of samples. A rival with the opposite gain is half a period away. Linear
    interpolation of the first signal adds up to an eighth of its second difference to the residuals, more at
    one minimum than at another. Twice that is allowed, which also covers most of the signal's noise.
    """
    best = minima[0]
    interpolated = best.gain * np.diff(streams.signal, 2) / 4
    least = best.cost * np.clip(1.0 + _CLEARLY_WORSE / max(independent, 1.0), 1.15, 1.5)
    least += len(streams.t2) * float((interpolated**2).mean())
    periods = [
        abs(other.offset_s - best.offset_s) * (1.0 if other.gain * best.gain > 0.0 else 2.0)
        for other in minima[1:]
        if other.cost < least and abs(other.offset_s - best.offset_s) > 2 * _GRID_S
    ]
    return min(periods, default=None)


def _valleys(costs: Array) -> list[int]:
    """Return the indices of distinct minima of the grid's costs, the lowest first; at most `_MOST_VALLEYS`.

    Minima count as distinct only if there is a hill between them, because noise creates many small ones.
    """
    padded = np.pad(costs, 1, constant_values=np.inf)
    inner = np.flatnonzero((costs < padded[:-2]) & (costs <= padded[2:]))
    found: list[int] = []
    for i in inner[np.argsort(costs[inner], kind="stable")].tolist():
        if all(costs[min(i, j) : max(i, j) + 1].max() > _HILL * costs[i] for j in found):
            found.append(i)
    return found[:_MOST_VALLEYS]
